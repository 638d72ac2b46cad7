"""Patches of measured colour: pixels of one kind of organ, and measured reflectances."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.statistics import ColourStatistics, hue_histogram, mean_hue_fractions
from pepperscene.spectra import Spectrum

KIND_RULE: Final = 'must be a class in lower case, optionally with a stage ("leaf", "pepper.ripe")'

_STAGE: Final = re.compile(r"[a-z][a-z0-9_]*")


def is_organ_kind(text: str) -> bool:
    """Whether a text is a kind: a class in lower case, optionally with a stage ("pepper.ripe")."""
    organ, dot, stage = text.partition(".")
    names = {organ_class.name.lower() for organ_class in OrganClass}
    return organ in names and (not dot or bool(_STAGE.fullmatch(stage)))


def matches_kind(kind: str, wanted: str) -> bool:
    """Whether patches of `kind` count as `wanted`: "pepper" includes all its stages."""
    return kind == wanted or kind.startswith(f"{wanted}.")


def even_indices(count: int, limit: int | None) -> NDArray[np.intp]:
    """At most `limit` of the indices 0 to `count` - 1, evenly spaced and ascending; all of them for None."""
    if limit is None or count <= limit:
        return np.arange(count)
    # The centres of `limit` equal intervals, so that neither the first nor the last index is always taken.
    return ((2 * np.arange(limit) + 1) * count // (2 * limit)).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Patch:
    """Pixels of one kind of organ in one picture.

    Attributes:
        name: unique in its set.
        kind: a class in lower case, optionally with a stage: "leaf", "pepper.unripe", "pepper.ripe".
        picture: name of the picture; fits hold data out picture by picture.
        linear: `(n, 3)` linear sRGB, 0 to 1, calibrated if there is a chart.
        codes: `(n, 3)` 8-bit sRGB of the same pixels.
        hues: `(181,)` hue histogram of all pixels of the patch, before pixels were left out or thinned; the
            last bin counts grey pixels. None counts `codes`.
        pixels: number of pixels before any was left out or thinned; None means n.
        clipped: number of these pixels with a channel at 0 or 255, whose true colour is unknown.
        border: further pixels that were left out because they are close to another region.
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
        _check_kind(self.name, self.kind)
        if self.linear.ndim != 2 or self.linear.shape[1] != 3 or self.codes.shape != self.linear.shape:
            raise ValueError(
                f"{self.name}: linear and codes must be (n, 3), not {self.linear.shape}, {self.codes.shape}"
            )
        if self.hues is None:
            object.__setattr__(self, "hues", hue_histogram(self.codes))
        if self.pixels is None:
            object.__setattr__(self, "pixels", len(self.linear))


@dataclass(frozen=True, eq=False)
class MeasuredSpectrum:
    """A measured diffuse reflectance, without specular reflection.

    Attributes:
        name: unique in its set.
        kind: as in `Patch`.
        spectrum: values `(n,)` in [0, 1].
    """

    name: str
    kind: str
    spectrum: Spectrum

    def __post_init__(self) -> None:
        _check_kind(self.name, self.kind)


def _check_kind(name: str, kind: str) -> None:
    if not is_organ_kind(kind):
        raise ValueError(f"{name}: kind {kind!r} {KIND_RULE}")


@dataclass(frozen=True, eq=False)
class PatchSet:
    """A set of patches and measured spectra.

    Attributes:
        name: shown in messages and tables.
        patches: in the natural order of their pictures.
        spectra: measured reflectances.
    """

    name: str
    patches: tuple[Patch, ...]
    spectra: tuple[MeasuredSpectrum, ...] = ()

    def __post_init__(self) -> None:
        if (name := duplicate_name((*self.patches, *self.spectra))) is not None:
            raise ValueError(f"{self.name}: two patches are called {name!r}")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the patches and spectra, sorted."""
        return tuple(
            sorted({*(patch.kind for patch in self.patches), *(spectrum.kind for spectrum in self.spectra)})
        )

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of the pictures of the patches, in their order."""
        return tuple(dict.fromkeys(patch.picture for patch in self.patches))

    def of_kind(self, kind: str) -> tuple[Patch, ...]:
        """Patches of a kind; "pepper" returns those of all stages."""
        return tuple(patch for patch in self.patches if matches_kind(patch.kind, kind))

    def pixels(self, kind: str, limit: int | None = None) -> NDArray[np.float64]:
        """`(n, 3)` linear sRGB of all patches of a kind, evenly thinned to at most `limit` pixels."""
        pooled = np.concatenate([np.empty((0, 3)), *(patch.linear for patch in self.of_kind(kind))])
        return pooled[even_indices(len(pooled), limit)]

    def statistics(self, kind: str) -> ColourStatistics:
        """Colour statistics of the pixels of a kind.

        CIELAB is that of all pixels pooled; the hue spectrum is the mean over pictures, as in the paper.
        """
        counts: dict[str, list[NDArray[np.int64]]] = {}
        for patch in self.of_kind(kind):
            counts.setdefault(patch.picture, []).append(patch.hues)
        return ColourStatistics.from_pixels(self.pixels(kind), hues=mean_hue_fractions(counts))

    def select(self, pictures: Iterable[str]) -> Self:
        """The set with the patches of these pictures only; spectra stay."""
        selected = self._check_pictures(pictures)
        return replace(self, patches=tuple(patch for patch in self.patches if patch.picture in selected))

    def without(self, pictures: Iterable[str]) -> Self:
        """The set without the patches of these pictures; spectra stay."""
        held_out = self._check_pictures(pictures)
        return replace(self, patches=tuple(patch for patch in self.patches if patch.picture not in held_out))

    def _check_pictures(self, pictures: Iterable[str]) -> set[str]:
        names = {pictures} if isinstance(pictures, str) else set(pictures)
        if unknown := names - set(self.pictures):
            raise ValueError(f"{self.name} has no patches of the pictures {', '.join(sorted(unknown))}")
        return names


def duplicate_name(patches: Iterable[Patch | MeasuredSpectrum]) -> str | None:
    """The first name that two patches or spectra share, or None."""
    names = [patch.name for patch in patches]
    return next((name for name in names if names.count(name) > 1), None)
