"""Fruit: the pericarp, the shoulders that the calyx rests on, the calyx, and scanned meshes."""
