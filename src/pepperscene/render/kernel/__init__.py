"""The scene on the device: mesh, camera rays, spectral response, arrays."""
