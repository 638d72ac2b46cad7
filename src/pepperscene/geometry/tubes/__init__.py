"""Tubes along a spine: stems, stalks and twine; and flowers."""
