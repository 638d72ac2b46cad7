"""The version, which every frame records: a frame depends on recipe, version and index alone."""

__version__ = "0.1.0"
