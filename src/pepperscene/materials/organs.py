"""Surfaces of all organs of a plant, from the pigments and sizes of its cultivar."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from hashlib import sha256
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.cultivar import Blade, Cultivar, OrganForm, PigmentPath
from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.patterns import grow_veins, noise_mm, vein_pattern, vein_relief
from pepperscene.materials.rind import cut_surface, fruit_surface, green_surface
from pepperscene.materials.surface import Surface, refine_states
from pepperscene.spectra import leaf_spectra
from pepperscene.spectra.spectrum import FloatArray

ABAXIAL_FRACTION: Final = 0.5
"""Fraction of the pigments that light from below meets before it turns back: chosen.

PROSPECT's leaf is the same on both sides; a real one has most of its chlorophyll in the palisade below its
upper side, so that the lower side reflects more in the visible and as much in the near infrared (Woolley
1971, Plant Physiology 47:656). The lower side's reflectance is that of a leaf with this fraction of the
pigments and the same structure, water and dry matter; the transmittance is that of the complete leaf both
ways, as reciprocity requires. Since transmittance falls with pigment, the sum never exceeds 1.
"""

PIGMENTS: Final = (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown"
)  # fmt: skip

PATTERN_SEED: Final = 112_135
"""Seed of all patterns: chosen; patterns belong to the cultivar, not to a frame."""


def leaf_body(
    path: PigmentPath, wavelength_nm: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reflectance of the upper and of the lower side and transmittance, each `(s, n)`, under the cuticle."""
    contents = path.at(states)
    thinned = {
        name: amount * ABAXIAL_FRACTION if name in PIGMENTS else amount for name, amount in contents.items()
    }
    upper_gloss, lower_gloss = (cone_gloss(path.ior, alpha) for alpha in path.roughness)
    upper, transmittance = leaf_spectra(wavelength_nm, **contents).under_gloss(upper_gloss)
    lower, _ = leaf_spectra(wavelength_nm, **thinned).under_gloss(lower_gloss)
    return upper, lower, np.minimum(transmittance, 1.0 - lower)


def leaf_surface(name: str, path: PigmentPath, wavelength_nm: FloatArray) -> Surface:
    """Leaf or petal of these pigments, without a pattern."""
    states = refine_states(lambda nm, states: np.stack(leaf_body(path, nm, states), axis=1))
    upper, lower, transmittance = leaf_body(path, wavelength_nm, states)
    both = np.stack([upper, lower], axis=1)
    return Surface(name, wavelength_nm, both, transmittance, ior=path.ior, roughness=path.roughness)


def organ_surfaces(cultivar: Cultivar, wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """Surfaces that a plant's meshes name; a pepper's: leaf, petiole, stem, fruit, calyx, cut, peduncle.

    Only those of kinds that the plants have: a cultivar without flowers needs no petals. The first kind with
    a surface determines its model and the scale of its pattern.

    Args:
        cultivar: its `pigments` give the paths through pigment space, its sizes the patterns' scale.
        wavelength_nm: `(n,)` increasing, up to 2500 nm; flesh and scars are made for 300 to 1100 nm.

    Raises:
        ValueError: a wavelength is outside the range of the pigments' coefficients.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    first_kind: dict[str, str] = {}
    for kind in cultivar.present_kinds:
        first_kind.setdefault(cultivar.kinds[kind].surface, kind)
    # In parallel, with one generator per surface: the leaf's veins take about as long as all others together.
    with ThreadPoolExecutor(2) as pool:
        surfaces = pool.map(lambda name: _organ_surface(cultivar, first_kind[name], name, nm), first_kind)
        made = dict(zip(first_kind, surfaces, strict=True))
    for name, kind in first_kind.items():
        if isinstance(blade := cultivar.organs.get(kind), Blade):
            made[name] = replace(made[name], residue_reflectance=blade.residue_reflectance)
    return made


def _organ_surface(cultivar: Cultivar, kind: str, name: str, nm: FloatArray) -> Surface:
    """Surface of the organs of one kind."""
    form = cultivar.kinds[kind].form
    # A pattern depends on the name alone, so that adding a surface does not change the others.
    words = np.frombuffer(sha256(name.encode()).digest(), dtype="<u4").tolist()
    rng = np.random.default_rng([PATTERN_SEED, *words])
    if name == "cut":
        stem = cultivar.kinds[cultivar.stem.node].surface
        return cut_surface(cultivar.pigments[stem], nm, rng)
    path, size_mm = cultivar.pigments[name], _size_mm(cultivar, kind, form)
    if form == "blade":
        veins = grow_veins(size_mm, rng)
        pattern, relief_mm = vein_pattern(veins, rng), vein_relief(veins, rng)
        return replace(leaf_surface(name, path, nm), pattern=pattern, relief_mm=relief_mm)
    if form == "flower":
        # A petal is a leaf with a petal's pigments and no veins: faint streaks along it, 1 mm wide (chosen).
        streaks = 0.05 * noise_mm(rng, (64, 64), size_mm, (0.5, 6.0))
        return replace(leaf_surface(name, path, nm), pattern=streaks.astype(np.float32))
    if form == "fruit":
        return fruit_surface(name, path, nm, size_mm, rng)
    return green_surface(name, form, path, nm, size_mm, rng)


def _size_mm(cultivar: Cultivar, kind: str, form: OrganForm) -> tuple[float, float]:
    """Mean extents of u and v: width and length of a blade or petal, otherwise girth and length."""
    name = kind
    if form == "calyx":
        name = next(name for name, organ in cultivar.organs.items() if organ.form == "fruit")
    mean = {key: value.mean for key, value in cultivar.organs[name].distributions.items()}
    match form:
        case "calyx":
            radius = mean["calyx_radius"] * mean["diameter"]
            # A star: the girth at half its radius; from the stalk over the rim and back along the lower side.
            return 1e3 * np.pi * radius, 2e3 * radius
        case "blade":
            return 1e3 * mean["width"], 1e3 * mean["length"]
        case "flower":
            radius = 0.5 * mean["diameter"]
            return 1e3 * radius, 1e3 * radius
        case "fruit":
            return 1e3 * np.pi * mean["diameter"], 1e3 * mean["diameter"] * mean["slenderness"]
        case "internode" | "node":
            return 1e3 * np.pi * cultivar.stem.diameter.mean, 1e3 * mean["length"]
    return 1e3 * np.pi * mean["diameter"], 1e3 * mean["length"]
