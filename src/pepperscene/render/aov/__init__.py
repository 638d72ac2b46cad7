"""Arbitrary output variables: labels, geometry, coverage, flow, albedo, traits, amodal masks, harvest."""
