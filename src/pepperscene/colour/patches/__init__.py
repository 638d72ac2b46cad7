"""Patches of measured colour: pixels of labelled pictures, charts and reflectances."""
