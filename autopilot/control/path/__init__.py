"""The way to a goal: routes round obstacles, and the reference along them."""
