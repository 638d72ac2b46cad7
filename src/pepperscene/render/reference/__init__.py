"""Mitsuba's own path tracer over the same scene, to compare with."""
