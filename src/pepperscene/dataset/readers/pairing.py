"""Which mask belongs to which image: by name, never by the order in which a disk lists its files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pepperscene.errors import InputError

IMAGE_WORDS: Final = frozenset(
    {"img", "imgs", "image", "images", "rgb", "color", "colour", "photo", "photos", "jpegimages"}
)
MASK_WORDS: Final = frozenset(
    {
        "mask", "masks", "label", "labels", "lbl", "class", "classes", "annotation", "annotations", "ann",
        "seg", "segmentation", "segmentationclass", "semantic", "gt", "groundtruth",
    }
)  # fmt: skip
OTHER_WORDS: Final = frozenset(
    {"instance", "instances", "depth", "distance", "normal", "normals", "raw", "electrons"}
)
"""Words of file and folder names that tell images, class masks, and what is neither."""

SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})

_PIECES: Final = re.compile(r"\d+|[^\W\d_]+")


@dataclass(frozen=True)
class Pair:
    """An image and its mask.

    Attributes:
        name: path of the image below its folder, without suffix.
        image: its file.
        mask: its mask's, or None when it has none.
    """

    name: str
    image: Path
    mask: Path | None


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts "img2" before "img10": numbers by value, all else as text."""
    pieces = re.findall(r"\d+|\D+", text)
    found = ((0, int(piece), piece) if piece.isdecimal() else (1, 0, piece) for piece in pieces)
    return tuple(found)


def pairs(folder: Path) -> tuple[Pair, ...]:
    """The images of a folder with their masks, in natural order.

    Either a folder of images beside one of masks (`images/` and `masks/`), where a file's path below them
    tells the pair; or all in one, where the names do once words such as "img" and "mask" are taken out.
    Numbers count by value: `img001` and `mask1` belong together.

    Raises:
        InputError: there is no image, two files claim the same place, or a mask has no image.
    """
    images, masks = _sorted_out(folder)
    if not images:
        raise InputError(folder, "", None, f"holds no images ({', '.join(sorted(SUFFIXES))})")
    found_images, found_masks = _by_key(images), _by_key(masks)
    for key, (_, mask) in found_masks.items():
        if key not in found_images:
            raise InputError(mask, "", None, f"is a mask without an image of the same name in {folder}")
    made = [
        Pair(name, image, found_masks[key][1] if key in found_masks else None)
        for key, (name, image) in found_images.items()
    ]
    return tuple(sorted(made, key=lambda pair: natural(pair.name)))


def _sorted_out(folder: Path) -> tuple[list[tuple[Path, Path]], list[tuple[Path, Path]]]:
    """Images and masks, each as the folder its name starts from and the file."""
    below = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    image_roots = [path for path in below if path.name.lower() in IMAGE_WORDS]
    mask_roots = [path for path in below if path.name.lower() in MASK_WORDS]
    if len(image_roots) > 1 or len(mask_roots) > 1:
        names = ", ".join(path.name for path in (image_roots if len(image_roots) > 1 else mask_roots))
        raise InputError(folder, "", None, f"has several folders for the same: {names}; keep one of them")
    if image_roots:
        images = [(image_roots[0], path) for path in _pictures(image_roots[0].rglob("*"))]
        return images, [(root, path) for root in mask_roots for path in _pictures(root.rglob("*"))]
    files = [(folder, path) for path in _pictures(folder.iterdir()) if not _words(path) & OTHER_WORDS]
    if mask_roots:
        return files, [(mask_roots[0], path) for path in _pictures(mask_roots[0].rglob("*"))]
    masks = [file for file in files if _words(file[1]) & MASK_WORDS]
    return [file for file in files if file not in masks], masks


def _pictures(paths: Iterable[Path]) -> Iterator[Path]:
    """Files by their suffix, without hidden ones."""
    for path in paths:
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file():
            yield path


def _words(path: Path) -> set[str]:
    return set(_PIECES.findall(path.stem.lower()))


def _by_key(files: Iterable[tuple[Path, Path]]) -> dict[tuple[str, ...], tuple[str, Path]]:
    """Name and file by what is left of the name."""
    found: dict[tuple[str, ...], tuple[str, Path]] = {}
    for root, path in files:
        name = path.relative_to(root).with_suffix("").as_posix()
        key = _key(name)
        if key in found:
            other = found[key][1].name
            raise InputError(path, "", None, f"cannot be told from {other} by name: rename one of them")
        found[key] = (name, path)
    return found


def _key(name: str) -> tuple[str, ...]:
    """What is left of a name without the words that tell images from masks, numbers by their value."""
    *parents, stem = name.lower().split("/")
    pieces = [piece for piece in _PIECES.findall(stem) if piece not in IMAGE_WORDS | MASK_WORDS]
    return (*parents, "", *(str(int(piece)) if piece.isdecimal() else piece for piece in pieces))
