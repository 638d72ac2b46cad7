"""An export from words to files, as the command line asks for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pepperscene.dataset.export.formats import FORMATS, Exported
from pepperscene.dataset.export.source import OnFrame
from pepperscene.dataset.export.splits import read_splits
from pepperscene.dataset.plan import Plan
from pepperscene.dataset.store import open_dataset
from pepperscene.errors import InputError


def export(
    folder: str | Path,
    form: str,
    out: str | Path,
    split: str | None = None,
    frames: str | None = None,
    on_frame: OnFrame | None = None,
    smallest_px: int | None = None,
) -> Exported:
    """Write a data set in another format.

    Args:
        folder: of the data set.
        form: a name out of `FORMATS`.
        out: a new or an empty folder.
        split: shares, "train=.8,val=.1,test=.1", or ranges, "train=0:8750,val=8750:8800"; None for all frames
            as "train". Shares keep the plants of a set together, as far as the number of sets allows.
        frames: "A:B", indices A to B - 1; None for all that are there.
        on_frame: called after every frame with its index, how many are done, and how many there are.
        smallest_px: organs of which fewer pixels are seen are no objects of their own; None for the format's
            own number.

    Raises:
        InputError: there is no data set or no frame in it, an argument is wrong, an output is missing, or a
            file is damaged.
        OutputError: the folder holds something, or cannot be written to.
        SetupError: a library that the format needs is not installed.
    """
    if form not in FORMATS:
        raise InputError("--format", "", None, f"unknown format {form!r}; allowed are {', '.join(FORMATS)}")
    own = FORMATS[form].smallest_px
    if smallest_px is not None and (own is None or smallest_px < 1):
        allowed = "must be at least 1" if own is not None else f"is for objects, which {form} does not tell"
        raise InputError("--smallest", "", None, f"{smallest_px} {allowed}")
    dataset = open_dataset(folder)
    there = dataset.indices()
    if not there:
        raise InputError(folder, "", None, "holds no frames yet; build some first")
    plan = dataset.about["recipe"]["plan"]
    if frames is not None:
        wanted = set(Plan.model_validate(plan).chosen(frames))
        there = tuple(index for index in there if index in wanted)
        if not there:
            raise InputError("--frames", "", None, f"{frames!r} holds none of the data set's frames")
    splits = read_splits(split, plan, there)
    indices = tuple(index for index in there if splits.named(index))
    options = {} if own is None else {"smallest_px": smallest_px or own}
    done = FORMATS[form](dataset, Path(out), splits, indices=indices, on_frame=on_frame, **options)
    return replace(done, splits={name: len(of) for name, of in splits.members(indices).items()})
