"""Readers: rendered and published data sets, and folders of images with masks, as one in-memory type."""

from pepperscene.dataset.readers.folder import FolderSet
from pepperscene.dataset.readers.labels import KNOWN_LABELS, Labels
from pepperscene.dataset.readers.opening import open_images
from pepperscene.dataset.readers.published import PublishedSet
from pepperscene.dataset.readers.rendered import RenderedSet

__all__ = ["KNOWN_LABELS", "FolderSet", "Labels", "PublishedSet", "RenderedSet", "open_images"]
