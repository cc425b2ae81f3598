"""What a log holds of how its service was made, so that another one like it can be made."""
