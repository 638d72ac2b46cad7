"""Leaf blades: outline, triangle grid, relief and bending."""
