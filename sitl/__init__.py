"""Software in the loop: the 6-DoF plant, currents, sensor models, the tank renderer, scenarios."""
