"""Arbitrary output variables: labels, geometry, coverage, flow, albedo, amodal masks and harvest truth."""
