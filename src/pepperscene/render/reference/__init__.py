"""Mitsuba's own path tracer on the same scene, as a reference."""
