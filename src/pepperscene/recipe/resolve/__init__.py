"""A recipe with the files that it names: reading, merging and checking it, and the setup of each frame."""
