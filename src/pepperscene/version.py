"""The package version; every frame records it, because a frame depends on recipe, version and index only."""

__version__ = "0.2.0"
