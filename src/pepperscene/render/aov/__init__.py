"""Arbitrary output variables: labels, geometry, coverage, flow and harvest truth."""
