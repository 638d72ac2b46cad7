"""Least-squares fit, its result, and diagnostics."""
