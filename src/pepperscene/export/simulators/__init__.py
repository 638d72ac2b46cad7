"""Export of scenes to simulators and other programs for three-dimensional scenes."""
