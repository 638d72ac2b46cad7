"""Dry runs: what a build of a recipe would make, what it costs, and where its cameras are."""
