"""Scattering of light by surfaces, and the tables that describe them on the device."""
