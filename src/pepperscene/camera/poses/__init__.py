"""Poses of cameras and lists of them, paths and motion."""
