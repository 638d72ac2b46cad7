"""Derivatives of a picture with respect to pigments, cuticles, flash and exposure."""
