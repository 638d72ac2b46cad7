"""Files of poses."""
