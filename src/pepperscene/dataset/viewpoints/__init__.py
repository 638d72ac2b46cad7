"""Viewpoint planning: where cameras can be, tables of what they see, and planners to compare with."""
