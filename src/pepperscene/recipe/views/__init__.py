"""The views of a data set: where its cameras are and what they look at."""
