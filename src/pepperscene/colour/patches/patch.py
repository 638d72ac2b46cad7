"""Patches of measured colour: pixels of one kind of organ, and measured reflectances."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.statistics.colours import ColourStatistics, hue_counts_of, mean_hue_shares
from pepperscene.spectra import Spectrum

_STAGE: Final = re.compile(r"[a-z][a-z0-9_]*")


def is_organ_kind(text: str) -> bool:
    """Whether this names a kind: a class in lower case, and maybe a stage after a dot ("pepper.ripe")."""
    organ, dot, stage = text.partition(".")
    return organ in {one.name.lower() for one in OrganClass} and (not dot or bool(_STAGE.fullmatch(stage)))


def belongs(kind: str, wanted: str) -> bool:
    """Whether patches of `kind` count as `wanted`: "pepper" holds all its stages."""
    return kind == wanted or kind.startswith(f"{wanted}.")


def evenly(count: int, most: int | None) -> NDArray[np.intp]:
    """Up to `most` of the indices 0 to `count` - 1, evenly spread, ascending; all of them for None."""
    if most is None or count <= most:
        return np.arange(count)
    # The middles of `most` even pieces: no picture's first or last row is favoured.
    return ((2 * np.arange(most) + 1) * count // (2 * most)).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Patch:
    """Pixels of one kind of organ in one picture.

    Attributes:
        name: unique in its set.
        kind: a class in lower case, and maybe a stage after a dot: "leaf", "pepper.unripe", "pepper.ripe".
        picture: which picture it is from; what is held out of a fit is held out by picture.
        linear: `(n, 3)` linear sRGB, 0 to 1, decoded, and calibrated where there is a chart.
        codes: `(n, 3)` 8-bit sRGB of the same pixels, as the picture has them.
        hues: `(181,)` how many pixels have which hue, the grey ones last, counted in all pixels of the patch
            before any was left out or thinned; None counts `codes`.
        pixels: of the patch, before any was left out or thinned; None is n.
        clipped: pixels among these with a channel at 0 or 255, whose true colour nobody knows.
        border: pixels besides, left out because they lie next to something else.
    """

    name: str
    kind: str
    picture: str
    linear: NDArray[np.float64]
    codes: NDArray[np.uint8]
    hues: NDArray[np.int64] = field(default=None)  # type: ignore[arg-type]
    pixels: int = field(default=None)  # type: ignore[assignment]
    clipped: int = 0
    border: int = 0

    def __post_init__(self) -> None:
        if not is_organ_kind(self.kind):
            raise ValueError(f"{self.name}: {self.kind!r} is no kind of organ")
        if self.linear.ndim != 2 or self.linear.shape[1] != 3 or self.codes.shape != self.linear.shape:
            raise ValueError(f"{self.name}: pixels {self.linear.shape}, codes {self.codes.shape}")
        if self.hues is None:
            object.__setattr__(self, "hues", hue_counts_of(self.codes))
        if self.pixels is None:
            object.__setattr__(self, "pixels", len(self.linear))


@dataclass(frozen=True, eq=False)
class MeasuredSpectrum:
    """A measured reflectance, without the mirror-like part.

    Attributes:
        name: unique in its set.
        kind: as a patch has it.
        spectrum: values `(n,)` in [0, 1].
    """

    name: str
    kind: str
    spectrum: Spectrum

    def __post_init__(self) -> None:
        if not is_organ_kind(self.kind):
            raise ValueError(f"{self.name}: {self.kind!r} is no kind of organ")


@dataclass(frozen=True, eq=False)
class PatchSet:
    """Patches and spectra that belong together.

    Attributes:
        name: for people.
        patches: in the natural order of their pictures.
        spectra: measured reflectances.
    """

    name: str
    patches: tuple[Patch, ...]
    spectra: tuple[MeasuredSpectrum, ...] = ()

    def __post_init__(self) -> None:
        names = [*(one.name for one in self.patches), *(one.name for one in self.spectra)]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"{self.name}: two patches are called {twice!r}")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of its patches and spectra, each once, in the order of the alphabet."""
        return tuple(sorted({one.kind for one in self.patches} | {one.kind for one in self.spectra}))

    @property
    def pictures(self) -> tuple[str, ...]:
        """The pictures that its patches are from, each once, in their order."""
        return tuple(dict.fromkeys(patch.picture for patch in self.patches))

    def of_kind(self, kind: str) -> tuple[Patch, ...]:
        """Its patches of a kind; "pepper" has those of all stages."""
        return tuple(patch for patch in self.patches if belongs(patch.kind, kind))

    def pixels(self, kind: str, most: int | None = None) -> NDArray[np.float64]:
        """`(n, 3)` linear sRGB of all patches of a kind, pooled; evenly thinned to `most`."""
        pooled = np.concatenate([np.empty((0, 3)), *(patch.linear for patch in self.of_kind(kind))])
        return pooled[evenly(len(pooled), most)]

    def codes(self, kind: str, most: int | None = None) -> NDArray[np.uint8]:
        """`(n, 3)` 8-bit sRGB of the same pixels as `pixels`."""
        pooled = np.concatenate([np.empty((0, 3), np.uint8), *(patch.codes for patch in self.of_kind(kind))])
        return pooled[evenly(len(pooled), most)]

    def statistics(self, kind: str) -> ColourStatistics:
        """What the pixels of a kind have in common.

        CIELAB of all its pixels pooled; the hue spectrum is the mean over the pictures, as in the paper.
        """
        counts: dict[str, list[NDArray[np.int64]]] = {}
        for patch in self.of_kind(kind):
            counts.setdefault(patch.picture, []).append(patch.hues)
        return ColourStatistics.of(self.pixels(kind), hues=mean_hue_shares(counts))

    def select(self, pictures: Iterable[str]) -> Self:
        """The patches of these pictures alone; spectra stay."""
        wanted = self._known(pictures)
        return replace(self, patches=tuple(one for one in self.patches if one.picture in wanted))

    def without(self, pictures: Iterable[str]) -> Self:
        """All but the patches of these pictures; spectra stay."""
        held_out = self._known(pictures)
        return replace(self, patches=tuple(one for one in self.patches if one.picture not in held_out))

    def _known(self, pictures: Iterable[str]) -> set[str]:
        wanted = {pictures} if isinstance(pictures, str) else set(pictures)
        if unknown := wanted - set(self.pictures):
            raise ValueError(f"{self.name} has no patches of the pictures {', '.join(sorted(unknown))}")
        return wanted
