"""Scenes, cameras and rendered frames of a recipe."""
