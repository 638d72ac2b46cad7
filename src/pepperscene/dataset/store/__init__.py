"""A data set on disk: images, metadata, journal and tables."""
