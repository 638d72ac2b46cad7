"""From a recipe to scenes, cameras and rendered frames."""
