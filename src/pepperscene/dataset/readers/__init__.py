"""Readers of rendered, published and COCO data sets and of folders of images with masks, as one type."""

from pepperscene.dataset.readers.coco import CocoSet
from pepperscene.dataset.readers.folder import FolderSet
from pepperscene.dataset.readers.labels import KNOWN_LABELS, LabelMap
from pepperscene.dataset.readers.open import PublishedSet, RenderedSet, open_images

__all__ = ["KNOWN_LABELS", "CocoSet", "FolderSet", "LabelMap", "PublishedSet", "RenderedSet", "open_images"]
