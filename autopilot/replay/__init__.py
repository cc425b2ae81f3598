"""A recorded run once more, on the desk."""
