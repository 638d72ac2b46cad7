"""Measures the program: against itself, against the reference and against its peers."""
