"""Lenses, flash, projector, stray light inside a lens, calibration."""
