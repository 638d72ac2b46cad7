"""Lamps: their shapes, beams and strengths, and the files that describe them."""
