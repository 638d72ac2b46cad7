"""From a recipe to frames: scenes, executors and viewpoints."""
