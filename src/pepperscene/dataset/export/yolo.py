"""YOLO segmentation, as Ultralytics reads it: a text file for each picture, a polygon a line.

Format: https://docs.ultralytics.com/datasets/segment/.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pepperscene.classes import OrganClass
from pepperscene.dataset.export.formats import Exported
from pepperscene.dataset.export.libraries import library
from pepperscene.dataset.export.polygons import Points, polygons
from pepperscene.dataset.export.segments import REST, segment_ids
from pepperscene.dataset.export.source import OnFrame, Source, sources, wanted_frames
from pepperscene.dataset.export.splits import EVERYTHING, Splits
from pepperscene.dataset.export.target import new_folder
from pepperscene.dataset.store import Dataset

_VALIDATION: Final = ("val", "valid", "validation", "dev")
_DECIMALS: Final = 6  # a two-hundredth of a pixel in pictures of 5,000


def export_yolo(
    dataset: Dataset,
    out: Path,
    splits: Splits,
    *,
    indices: Sequence[int] | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int = 12,
) -> Exported:
    """Write `images/train/000110.png`, `labels/train/000110.txt` and `data.yaml`.

    A line is an organ of a plant: its class id less 1, as ids start at 0 and the background has none, and
    its polygon over the width and height of the picture, through the centres of pixels. What belongs to no
    plant is left out, for the format knows no crowd.

    Args:
        dataset: with the outputs colour and instance.
        out: a new or an empty folder.
        splits: frames in none are left out.
        indices: of the frames wanted; None for all.
        on_frame: called after every frame.
        smallest_px: organs of which fewer pixels are seen are left out, and pieces of fewer. Chosen: three by
            four pixels, less than one pixel of a network's masks, a quarter as wide as its input.

    Raises:
        InputError: an output is missing, or a file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: OpenCV is not installed.
    """
    library("cv2")
    wanted = wanted_frames(dataset, splits, indices, ("colour", "instance"))
    names = list(splits.members(wanted))
    with new_folder(out, dataset.folder) as folder:
        for name in names:
            (folder / "images" / name).mkdir(parents=True)
            (folder / "labels" / name).mkdir(parents=True)
        (folder / "data.yaml").write_text(_description(names), encoding="utf-8")
        for source in sources(dataset, wanted, on_frame):
            split = splits.named(source.index)
            (folder / "images" / split / f"{source.name}.png").write_bytes(source.content("colour"))
            lines = label_lines(source, smallest_px)
            (folder / "labels" / split / f"{source.name}.txt").write_text(
                "".join(f"{line}\n" for line in lines), encoding="ascii"
            )
    return Exported(out, len(wanted), 2 * len(wanted) + 1)


def label_lines(source: Source, smallest_px: int) -> list[str]:
    """The lines of a frame's label file, by ascending instance."""
    from scipy import ndimage

    ids = segment_ids(source, smallest_px)
    height, width = ids.shape
    across, down = _centres(width), _centres(height)
    known = source.facts["instances"]
    lines = []
    for value, window in enumerate(ndimage.find_objects(ids.astype("int32"), max_label=REST - 1), start=1):
        if window is None:
            continue
        rows, columns = window
        for polygon in polygons(ids[window] == value, smallest_px):
            xy = " ".join(
                f"{across[columns.start + x]} {down[rows.start + y]}" for x, y in _three(polygon).tolist()
            )
            lines.append(f"{known[str(value)]['class'] - 1} {xy}")
    return lines


def _three(polygon: Points) -> Points:
    """At least three points: readers take two for a box."""
    return polygon if len(polygon) > 2 else polygon[[0, 0, -1]]


def _centres(count: int) -> list[str]:
    """Where the centres of a row of pixels lie in [0, 1]."""
    return [f"{(place + 0.5) / count:.{_DECIMALS}f}" for place in range(count)]


def _description(names: Sequence[str]) -> str:
    """`data.yaml`; paths are seen from its own folder. Readers want both `train` and `val`."""
    lines = [f"{name}: images/{name}" for name in names]
    if EVERYTHING not in names:
        lines.append(f"train: images/{names[0]}  # there is no split of this name")
    if "val" not in names:
        other = next((name for name in _VALIDATION if name in names), names[0])
        lines.append(f"val: images/{other}  # there is no split of this name")
    lines.append("names:")
    lines += [f"  {one - 1}: {one.name.lower()}" for one in OrganClass if one != OrganClass.BACKGROUND]
    return "\n".join(lines) + "\n"
