"""What can be tuned, its bounds, and a recipe with given parameter values."""
