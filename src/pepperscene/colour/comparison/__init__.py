"""Similarity of two image sets: measures, confidence intervals, tables and figure."""
