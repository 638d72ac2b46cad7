"""The surfaces of all of a plant's organs, from the pigments and sizes of its cultivar."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.materials.fruit import fruit_surface
from pepperscene.materials.green import cut_surface, green_surface
from pepperscene.materials.leaf import leaf_surface
from pepperscene.materials.surface import Surface

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar

ORGANS: Final = ("leaf", "petiole", "stem", "fruit", "calyx", "cut", "peduncle")
PATTERN_SEED: Final = 112_135
"""Of the generator that draws all patterns: chosen; the patterns belong to the cultivar, not to a frame."""


def organ_surfaces(cultivar: Cultivar, wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """The surfaces that the meshes of a plant name: leaf, petiole, stem, fruit, calyx, cut and peduncle.

    Args:
        cultivar: whose `pigments` give the paths through pigment space, and whose sizes the patterns' scale.
        wavelength_nm: `(n,)` increasing, up to 2500 nm; the flesh and the scars are made for 300 to 1100 nm.

    Raises:
        ValueError: a wavelength lies beyond the pigments' coefficients.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    pigments = cultivar.pigments
    rngs = dict(zip(ORGANS, np.random.default_rng(PATTERN_SEED).spawn(len(ORGANS)), strict=True))
    sizes_mm = _sizes_mm(cultivar)
    surfaces = (
        leaf_surface(pigments["leaf"], nm, sizes_mm["leaf"], rngs["leaf"]),
        fruit_surface(pigments["fruit"], nm, sizes_mm["fruit"], rngs["fruit"]),
        *(
            green_surface(name, pigments[name], nm, sizes_mm[name], rngs[name])
            for name in ("petiole", "stem", "peduncle", "calyx")
        ),
        cut_surface(pigments["stem"], nm, rngs["cut"]),
    )
    return {surface.name: surface for surface in surfaces}


def _sizes_mm(cultivar: Cultivar) -> dict[str, tuple[float, float]]:
    """Mean extents of u and v: width and length of a blade, else girth and length."""
    leaf, fruit, peduncle = cultivar.leaf, cultivar.fruit, cultivar.peduncle
    calyx_radius = peduncle.calyx_radius.mean * fruit.diameter.mean
    metres = {
        "leaf": (leaf.width.mean, leaf.length.mean),
        "fruit": (np.pi * fruit.diameter.mean, fruit.diameter.mean * fruit.slenderness.mean),
        "petiole": (np.pi * leaf.petiole_diameter.mean, leaf.petiole_length.mean),
        "stem": (np.pi * cultivar.plant.stem_diameter.mean, cultivar.node.internode_length.mean),
        "peduncle": (np.pi * peduncle.diameter.mean, peduncle.length.mean),
        # A star: round as at half its radius, from the stalk over the rim and back along the lower side.
        "calyx": (np.pi * calyx_radius, 2.0 * calyx_radius),
    }
    return {name: (1e3 * u, 1e3 * v) for name, (u, v) in metres.items()}
