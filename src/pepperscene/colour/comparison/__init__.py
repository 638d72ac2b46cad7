"""Comparison of two sets of images or patches."""
