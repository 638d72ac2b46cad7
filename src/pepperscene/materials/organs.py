"""The surfaces of all of a plant's organs, from the pigments and sizes of its cultivar."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from hashlib import sha256
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.patterns import grow_veins, noise_mm, vein_pattern, vein_relief
from pepperscene.materials.rind import cut_surface, fruit_surface, green_surface
from pepperscene.materials.surface import Surface, enough_states
from pepperscene.spectra import leaf_spectra

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, OrganForm, OrganModel, PigmentPath


Array = NDArray[np.float64]

ABAXIAL_SHARE: Final = 0.5
"""Share of the pigments that light from below meets before it turns back: chosen.

PROSPECT's leaf is the same on both sides; a real one keeps most of its chlorophyll in the palisade below its
upper side, so that the lower side reflects more in the visible and as much in the near infrared (Woolley
1971, Plant Physiology 47:656). The lower side's reflectance is that of a leaf with this share of the pigments
and the same structure, water and dry matter; the transmittance is that of the whole leaf both ways, as
reciprocity asks. Since transmittance falls with pigment, the sum can never exceed 1.
"""

PIGMENTS: Final = (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown"
)  # fmt: skip


def leaf_surface(
    path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A leaf's blade: PROSPECT on both sides, its gloss left to the cuticle, with veins.

    Args:
        path: pigments from a vein's (state 0) over a pale blade's to a dark blade's (state 1).
        wavelength_nm: `(n,)`.
        size_mm: width and length of the flat blade.
        rng: draws veins and mottling.
    """
    veins = grow_veins(size_mm, rng)
    pattern, relief = vein_pattern(veins, rng), vein_relief(veins, rng)
    return replace(thin_surface("leaf", path, wavelength_nm), pattern=pattern, relief_mm=relief)


def thin_surface(name: str, path: PigmentPath, wavelength_nm: Array) -> Surface:
    """An even leaf of these pigments, without veins."""
    states = enough_states(lambda nm, asked: np.stack(leaf_body(path, nm, asked), axis=1))
    above, below, through = leaf_body(path, wavelength_nm, states)
    both = np.stack([above, below], axis=1)
    return Surface(name, wavelength_nm, both, through, ior=path.ior, roughness=path.roughness)


def leaf_body(path: PigmentPath, wavelength_nm: Array, states: Array) -> tuple[Array, Array, Array]:
    """Reflectance of the upper and of the lower side and transmittance, each `(s, n)`, under the cuticle."""
    contents = path.at(states)
    upper, lower = (cone_gloss(path.ior, alpha) for alpha in path.roughness)
    above, through = leaf_spectra(wavelength_nm, **contents).under_gloss(upper)
    below, _ = leaf_spectra(wavelength_nm, **_thinned(contents, ABAXIAL_SHARE)).under_gloss(lower)
    return above, below, np.minimum(through, 1.0 - below)


def _thinned(contents: dict[str, Array], share: float) -> dict[str, Array]:
    return {name: amount * share if name in PIGMENTS else amount for name, amount in contents.items()}


PIXELS: Final = 64


def petal_surface(
    path: PigmentPath,
    wavelength_nm: NDArray[np.float64],
    size_mm: tuple[float, float],
    rng: np.random.Generator,
) -> Surface:
    """A petal: the model of a leaf's blade with a petal's pigments, without a leaf's veins.

    Args:
        path: pigments from the greenish bud (state 0) to the open flower (state 1).
        wavelength_nm: `(n,)`.
        size_mm: width and length of a petal.
        rng: draws faint streaks from base to tip.
    """
    # Streaks a millimetre wide along the petal: amount chosen by eye.
    streaks = 0.05 * noise_mm(rng, (PIXELS, PIXELS), size_mm, (0.5, 6.0))
    return replace(thin_surface("petal", path, wavelength_nm), pattern=streaks.astype(np.float32))


PATTERN_SEED: Final = 112_135
"""Of the generators that draw all patterns: chosen; patterns belong to the cultivar, not to a frame."""

_GRAIN: Final = {
    "internode": "stem",
    "node": "stem",
    "stalk": "petiole",
    "peduncle": "peduncle",
    "calyx": "calyx",
}


def organ_surfaces(cultivar: Cultivar, wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """The surfaces that a plant's meshes name; a pepper's: leaf, petiole, stem, fruit, calyx, cut, peduncle.

    Only those of kinds that the plants do have: a cultivar without flowers costs no petals. What a surface is
    made like follows from the first of the kinds that have it, as does the scale of its pattern.

    Args:
        cultivar: whose `pigments` give the paths through pigment space, and whose sizes the patterns' scale.
        wavelength_nm: `(n,)` increasing, up to 2500 nm; the flesh and the scars are made for 300 to 1100 nm.

    Raises:
        ValueError: a wavelength lies beyond the pigments' coefficients.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    first_kind: dict[str, str] = {}
    for kind in cultivar.grown:
        first_kind.setdefault(cultivar.kinds[kind].surface, kind)
    # Each has a generator of its own, so that they can be made side by side: the blade's veins take about as
    # long as all others together.
    with ThreadPoolExecutor(2) as makers:
        made = makers.map(lambda name: _surface(cultivar, first_kind[name], name, nm), first_kind)
        return dict(zip(first_kind, made, strict=True))


def _surface(cultivar: Cultivar, kind: str, name: str, nm: NDArray[np.float64]) -> Surface:
    """One surface, made like the bodies of a kind are."""
    form = cultivar.kinds[kind].form
    # A pattern depends on the name alone, so that another surface more or less leaves it as it is.
    words = np.frombuffer(sha256(name.encode()).digest(), dtype="<u4").tolist()
    rng = np.random.default_rng([PATTERN_SEED, *words])
    if name == "cut":
        stem = cultivar.kinds[cultivar.stem.node].surface
        return cut_surface(cultivar.pigments[stem], nm, rng)
    path, size_mm = cultivar.pigments[name], _size_mm(cultivar, kind, form)
    if form == "blade":
        made = leaf_surface(path, nm, size_mm, rng)
    elif form == "flower":
        made = petal_surface(path, nm, size_mm, rng)
    elif form == "fruit":
        made = fruit_surface(path, nm, size_mm, rng)
    else:
        made = green_surface(_GRAIN.get(form, "stem"), path, nm, size_mm, rng)
    return replace(made, name=name)


def _size_mm(cultivar: Cultivar, kind: str, form: OrganForm) -> tuple[float, float]:
    """Mean extents of u and v: width and length of a blade, else girth and length."""
    if form == "calyx":
        fruit = next(organ for organ in cultivar.organs.values() if organ.form == "fruit")
        radius = _mean(fruit, "calyx_radius") * _mean(fruit, "diameter")
        # A star: round as at half its radius, from the stalk over the rim and back along the lower side.
        return 1e3 * np.pi * radius, 2e3 * radius
    organ = cultivar.organs[kind]
    if form == "blade":
        return 1e3 * _mean(organ, "width"), 1e3 * _mean(organ, "length")
    if form == "flower":
        radius = 0.5 * _mean(organ, "diameter")
        return 1e3 * radius, 1e3 * radius
    if form == "fruit":
        diameter = _mean(organ, "diameter")
        return 1e3 * np.pi * diameter, 1e3 * diameter * _mean(organ, "slenderness")
    if form in ("internode", "node"):
        return 1e3 * np.pi * cultivar.stem.diameter.mean, 1e3 * _mean(organ, "length")
    return 1e3 * np.pi * _mean(organ, "diameter"), 1e3 * _mean(organ, "length")


def _mean(organ: OrganModel, law: str) -> float:
    return organ.distributions[law].mean
