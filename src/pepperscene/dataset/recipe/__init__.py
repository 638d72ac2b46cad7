"""Recipes: the tables of the file, loading, the plan of frames, and the files that a recipe names."""
