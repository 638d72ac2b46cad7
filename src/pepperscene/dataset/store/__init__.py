"""A data set on disk: image files, metadata, journal and tables."""
