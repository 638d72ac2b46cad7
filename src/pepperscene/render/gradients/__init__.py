"""Derivatives of an image with respect to pigments, cuticles, flash and exposure."""
