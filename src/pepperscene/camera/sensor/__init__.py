"""Sensors: bands, readout, shutter, mosaic."""
