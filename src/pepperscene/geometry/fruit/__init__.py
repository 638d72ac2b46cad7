"""Fruit: the wall, the crown that the calyx lies on, the calyx, and scanned meshes."""
