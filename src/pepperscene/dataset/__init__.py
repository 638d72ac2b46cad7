"""The files of a data set: store and readers."""
