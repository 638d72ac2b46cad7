"""Image signal processing: what a camera makes of its linear colours before it stores a photograph."""
