"""Simulated patches: patches as a camera would deliver them, of a recipe with known parameter values.

A fit to simulated patches can be compared with the truth. They share nothing with the model of the fit: the
renderer is the one for images, light is sampled anew and four times as finely, photons and amplifier add
noise, the converter quantises, and the image has 8-bit codes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.camera import Camera, add_pedestal, camera_rgb, correct_colours, decode_tone, encode_tone
from pepperscene.colour import Patch, PatchSet
from pepperscene.colour.patches.patch import is_organ_kind
from pepperscene.errors import ArgumentError
from pepperscene.materials import organ_surfaces
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.render.quality import Quality
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.tuned import tuned_camera
from pepperscene.tuning.views import ORGANS, PIXELS, OrganView, with_surfaces

if TYPE_CHECKING:
    from pepperscene.recipe.recipe import Recipe

QUALITY: Final = Quality(64, 64, 64, 1, target=None, denoise=False)
"""Chosen: the noise of the light simulation is then far below that of photons."""


def simulate_patches(
    recipe: Recipe,
    values: Mapping[str, ArrayLike],
    kinds: Sequence[str],
    *,
    organs: int = ORGANS,
    pixels: int = PIXELS,
    seed: int = 0,
    noise: int = 1,
) -> PatchSet:
    """Render patches of single organs at given values of a recipe's parameters.

    They are named after the views that `TuningTarget` has of the same recipe, kinds, `organs`, `pixels` and
    `seed`. With `registered=True` it compares each patch with the same organ. With another
    seed, and without `registered`, they are a sample of other organs, like photographs.

    Args:
        recipe: Plants, light and camera.
        values: Parameter values by the names of `known_parameters`; others are the recipe's.
        kinds: Kinds of organs as for patches: "leaf", "pepper.unripe".
        organs: Maximum number of organs of each kind.
        pixels: Width and height of a view.
        seed: Seed of the organs.
        noise: Seed of light and noise.

    Raises:
        InputError: A name or a kind is unknown, or a value has the wrong number of entries.
    """
    target = _make_target(recipe, kinds, organs, pixels, seed)
    known = target.parameters(list(values)) if values else ()
    given = {parameter.name: np.atleast_1d(np.asarray(values[parameter.name], float)) for parameter in known}
    for parameter in known:
        if given[parameter.name].shape != parameter.default.shape:
            problem = f"must be {parameter.default.size} number(s)"
            raise ArgumentError("values", problem, key=parameter.name, value=values[parameter.name])
    parts = target.tuned_parts(given)
    pigments = {**target.cultivar.pigments, **parts.pigments}
    cultivar = target.cultivar.model_copy(update={"pigments": pigments})
    surfaces = organ_surfaces(cultivar, surface_wavelengths(target.camera.sensor))
    patches = [
        photograph(with_surfaces(view, surfaces), tuned_camera(view.camera, parts), (noise, i))
        for i, view in enumerate(target.views)
    ]
    return PatchSet(f"{recipe.name}, simulated", tuple(patches))


def photograph(view: OrganView, camera: Camera, seed: tuple[int, int]) -> Patch:
    """Return the organ's pixels in an image of a view: light, electrons, noise, digital numbers, codes."""
    from pepperscene.render import Renderer

    tone = camera.developing.tone
    render_seed = int(np.random.default_rng(seed).integers(2**31))
    electrons = Renderer(view.scene).render(camera, ["electrons"], QUALITY, render_seed)["electrons"]
    rgb = camera_rgb(electrons, camera, np.random.default_rng((*seed, 1)))
    codes = encode_tone(add_pedestal(correct_colours(rgb, camera), camera), tone)[view.mask]
    return Patch(view.name, view.kind, view.name, decode_tone(codes, tone), codes)


def _make_target(recipe: Recipe, kinds: Sequence[str], organs: int, pixels: int, seed: int) -> TuningTarget:
    """A target with views of these kinds; its patches are grey pixels that nothing is compared with."""
    grey = np.full((1, 3), 188, np.uint8)
    linear = decode_tone(grey)
    blank = tuple(Patch(kind, kind, "none", linear, grey) for kind in kinds if is_organ_kind(kind))
    patches = PatchSet("none", blank)
    target = TuningTarget(recipe, patches, registered=True, organs=organs, pixels=pixels, seed=seed)
    for kind in kinds:
        if kind not in target.kinds:
            raise ArgumentError("kinds", f'{kind!r} is not a kind of organ such as "leaf" or "pepper.unripe"')
    return target
