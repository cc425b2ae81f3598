"""Path planning and guidance: routes round obstacles, and the reference along them."""
