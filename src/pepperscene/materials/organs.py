"""Surfaces of all organs of a plant, from the pigments and sizes of its cultivar."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.cultivar import Blade, Cultivar, OrganForm
from pepperscene.materials.leaf import leaf_surface
from pepperscene.materials.leaf_textures import leaf_textures
from pepperscene.materials.measured import measured_surface
from pepperscene.materials.patterns import named_generator, noise_mm
from pepperscene.materials.rind import cut_surface, fruit_surface, green_surface
from pepperscene.materials.rind_textures import FruitSkin
from pepperscene.materials.skin import Skin, skin_tile
from pepperscene.materials.surface import Surface
from pepperscene.materials.venation import BladeGrid
from pepperscene.spectra.spectrum import FloatArray

PATTERN_SEED: Final = 112_135
"""Seed of all patterns: chosen; patterns belong to the cultivar, not to a frame."""
SIZES_MM: Final = (5.0, 1000.0)
"""Extents for which textures are drawn; those of smaller and larger organs are scaled, relief included.
Chosen: the finest grain is lost on smaller ones, and the time to draw larger ones grows with their area."""


def organ_surfaces(
    cultivar: Cultivar, wavelength_nm: ArrayLike, skin: Skin | None = None
) -> dict[str, Surface]:
    """Surfaces that a plant's meshes name; a pepper's: leaf, petiole, stem, fruit, calyx, cut, peduncle.

    Only those of kinds that the plants have: a cultivar without flowers needs no petals. The first kind with
    a surface determines its model and the scale of its pattern.

    Args:
        cultivar: its `pigments` give the paths through pigment space, its sizes the patterns' scale.
        wavelength_nm: `(n,)` increasing, up to 2500 nm; flesh and scars are made for 300 to 1100 nm.
        skin: fine textures of all organs but flowers and scars, or None.

    Raises:
        ValueError: a wavelength is outside the range of the pigments' coefficients.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    first_kind: dict[str, str] = {}
    for kind in cultivar.present_kinds:
        first_kind.setdefault(cultivar.kinds[kind].surface, kind)
    # In parallel, with one generator per surface: the leaf's textures take longer than all others together.
    with ThreadPoolExecutor(2) as pool:
        surfaces = pool.map(lambda name: _organ_surface(cultivar, first_kind[name], name, nm), first_kind)
        made = dict(zip(first_kind, surfaces, strict=True))
    for name, kind in first_kind.items():
        if isinstance(blade := cultivar.organs.get(kind), Blade):
            made[name] = replace(
                made[name],
                residue_reflectance=blade.residue_reflectance,
                residue_behind=blade.residue_behind,
            )
    if skin is None:
        return made
    return {name: _with_skin(made[name], cultivar, kind, skin) for name, kind in first_kind.items()}


def _with_skin(surface: Surface, cultivar: Cultivar, kind: str, skin: Skin) -> Surface:
    """A surface with the fine texture of the organs of a kind."""
    form = cultivar.kinds[kind].form
    if form == "flower" or surface.name == "cut":
        return surface
    table = skin.leaf if surface.is_blade else skin.fruit if form == "fruit" else skin.stem
    return replace(surface, skin=skin_tile(table, surface.name, min(surface.roughness)))


def _organ_surface(cultivar: Cultivar, kind: str, name: str, nm: FloatArray) -> Surface:
    """Surface of the organs of one kind."""
    size_mm = _size_mm(cultivar, kind, cultivar.kinds[kind].form)
    drawn_mm = float(np.clip(size_mm[0], *SIZES_MM)), float(np.clip(size_mm[1], *SIZES_MM))
    surface = _drawn_surface(cultivar, kind, name, nm, drawn_mm)
    if name in cultivar.spectra:
        surface = measured_surface(surface, cultivar.spectra[name], cultivar.pigments[name])
    scale = min(size / drawn for size, drawn in zip(size_mm, drawn_mm, strict=True))
    if scale == 1.0 or surface.relief_mm is None:
        return surface
    return replace(surface, relief_mm=np.float32(scale) * surface.relief_mm)


def _drawn_surface(
    cultivar: Cultivar, kind: str, name: str, nm: FloatArray, size_mm: tuple[float, float]
) -> Surface:
    """Surface of the organs of one kind, with textures of this size."""
    form = cultivar.kinds[kind].form
    # A pattern depends on the name alone, so that adding a surface does not change the others.
    rng = named_generator(PATTERN_SEED, name)
    if name == "cut":
        stem = cultivar.kinds[cultivar.stem.node].surface
        return cut_surface(cultivar.pigments[stem], nm, rng)
    path = cultivar.pigments[name]
    blade = cultivar.organs.get(kind)
    if isinstance(blade, Blade):
        outline = blade.distributions
        grid = BladeGrid.build(size_mm, outline["widest"].mean, outline["base"].mean, palmate=blade.palmate)
        textures = leaf_textures(grid, rng, residue_shares=blade.residue_shares.values)
        return replace(
            leaf_surface(name, path, nm),
            pattern=textures.pattern,
            relief_mm=np.float32(blade.relief) * textures.relief_mm,
            residue_pattern=textures.residue_pattern,
            ageing_order=textures.ageing_order,
            is_blade=True,
        )
    if form == "flower":
        # A petal is a leaf with a petal's pigments and no veins: faint streaks along it, 1 mm wide (chosen).
        streaks = 0.05 * noise_mm(rng, (64, 64), size_mm, (0.5, 6.0))
        return replace(leaf_surface(name, path, nm), pattern=streaks[None].astype(np.float32))
    if form == "fruit":
        fruit = cultivar.organs[kind]
        mean = {key: value.mean for key, value in fruit.distributions.items()}
        # Over the girth that textures are drawn for.
        calyx_mm = (
            1e3 * mean["calyx_radius"] * mean["diameter"] * (size_mm[0] / (1e3 * np.pi * mean["diameter"]))
        )
        skin = FruitSkin(**{field.name: getattr(fruit, field.name) for field in fields(FruitSkin)})
        return fruit_surface(name, path, nm, size_mm, calyx_mm, skin, rng)
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
