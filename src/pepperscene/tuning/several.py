"""Several sets of patches as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet


def together(sets: Sequence[PatchSet]) -> PatchSet:
    """All patches and spectra of several sets; names of pictures that two sets share get their set's before.

    Raises:
        ValueError: no set at all.
    """
    if not sets:
        raise ValueError("at least one set of patches is needed")
    if len(sets) == 1:
        return sets[0]
    names = [f"{one.name} {i + 1}" if _twice(one.name, sets) else one.name for i, one in enumerate(sets)]
    pictures = Counter(picture for one in sets for picture in one.pictures)
    called = Counter(part.name for one in sets for part in _parts(one))

    def told(name: str, of: str, counts: Counter[str]) -> str:
        return f"{of}: {name}" if counts[name] > 1 else name

    return PatchSet(
        " and ".join(names),
        tuple(
            replace(patch, name=told(patch.name, of, called), picture=told(patch.picture, of, pictures))
            for one, of in zip(sets, names, strict=True)
            for patch in one.patches
        ),
        tuple(
            replace(spectrum, name=told(spectrum.name, of, called))
            for one, of in zip(sets, names, strict=True)
            for spectrum in one.spectra
        ),
    )


def _parts(one: PatchSet) -> tuple[Patch | MeasuredSpectrum, ...]:
    return (*one.patches, *one.spectra)


def _twice(name: str, sets: Sequence[PatchSet]) -> bool:
    return sum(one.name == name for one in sets) > 1
