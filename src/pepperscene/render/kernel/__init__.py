"""Mesh, camera, spectral response and arrays on the device."""
