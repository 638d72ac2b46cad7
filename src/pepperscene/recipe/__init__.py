"""Recipes: their tables, loading, the plan of frames, and the files that a recipe names."""
