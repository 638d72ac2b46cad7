"""Patches of measured colour, and how they are read."""
