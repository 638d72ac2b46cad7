"""Visibility of fruit from many camera poses: sampled surfaces and batched shadow rays."""

from pepperscene.render.viewpoints.fruit_parts import FruitPart
from pepperscene.render.viewpoints.observer import FruitObserver, fruit_visibility

__all__ = ["FruitObserver", "FruitPart", "fruit_visibility"]
