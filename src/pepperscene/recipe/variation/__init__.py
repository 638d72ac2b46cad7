"""Variation: recipe values that are drawn for each set, scene or frame."""
