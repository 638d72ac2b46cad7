"""Leaf blades: outline, grid of triangles, relief and bending."""
