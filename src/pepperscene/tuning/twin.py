"""Twins: patches as a camera would have handed them on, of a recipe whose values are known.

A fit to a twin can be held against the truth. So nothing of the fit's own model makes it: the renderer is the
one of pictures, light is drawn anew and four times as finely, photons and amplifier add their noise, the
converter its steps, and the picture is told in 8-bit codes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.camera import Camera, camera_rgb, correct_colours, decode_tone, encode_tone
from pepperscene.colour import Patch, PatchSet
from pepperscene.colour.patches.patch import is_organ_kind
from pepperscene.dataset.recipe.resolved import surface_wavelengths
from pepperscene.errors import InputError
from pepperscene.materials import organ_surfaces
from pepperscene.render.quality import Quality
from pepperscene.spectra import illuminance
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.model.views import ORGANS, PIXELS, OrganView, with_surfaces
from pepperscene.tuning.output.flash import tuned_spectrum

if TYPE_CHECKING:
    from pepperscene.camera import Flash
    from pepperscene.dataset import Recipe
    from pepperscene.tuning.parameters.tuned import TunedParts


LIGHT: Final = Quality(64, 64, 64, 1, target=None, denoise=False)
"""Chosen: the noise of light is then far below that of photons."""


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
    """Patches of single organs, rendered at told values of a recipe's parameters.

    They are named after the views that `Subject` has of the same recipe, kinds, `organs`, `pixels` and
    `seed`: with `registered=True` it compares each with the very organ that it shows. With another seed, and
    without `registered`, they are a sample of other organs, as photographs are.

    Args:
        recipe: whose plants, light and camera.
        values: of parameters by name, as `known_parameters` lists them; others are the recipe's own.
        kinds: of organs, as patches call them: "leaf", "pepper.unripe".
        organs: of each kind, at most.
        pixels: along the sides of a view.
        seed: of the organs.
        noise: seed of light and noise.

    Raises:
        InputError: a name or a kind is unknown, or a value has another number of entries.
    """
    subject = _seen(recipe, kinds, organs, pixels, seed)
    known = subject.parameters(list(values)) if values else ()
    own = {one.name: np.atleast_1d(np.asarray(values[one.name], float)) for one in known}
    for one in known:
        if own[one.name].shape != one.default.shape:
            entries = one.default.size
            raise InputError("twin", f"must be {entries} number(s)", key=one.name, value=values[one.name])
    made = subject.tuned(own)
    pigments = {**subject.cultivar.pigments, **made.pigments}
    plants = subject.cultivar.model_copy(update={"pigments": pigments})
    surfaces = organ_surfaces(plants, surface_wavelengths(subject.camera.sensor))
    patches = []
    for place, view in enumerate(subject.views):
        camera = tuned_camera(view.camera, made)
        patches.append(photographed(with_surfaces(view, surfaces), camera, (noise, place)))
    return PatchSet(f"{recipe.name} twin", tuple(patches))


def tuned_camera(camera: Camera, made: TunedParts) -> Camera:
    """The camera with flash, exposure, white balance and matrix as they were tuned."""
    red, green, blue = made.gains.tolist()
    of_red, of_green, of_blue = (tuple(row) for row in made.matrix.tolist())
    developing = replace(
        camera.developing, white_balance=(red, green, blue), colour_matrix=(of_red, of_green, of_blue)
    )
    developed = replace(camera, developing=developing)
    if camera.flash is None:
        return replace(developed, exposure_s=camera.exposure_s * made.exposure)
    sensor = camera.sensor.with_settings(gain=camera.sensor.gain * made.exposure)
    return replace(developed, flash=tuned_light(camera.flash, made), sensor=sensor)


def tuned_light(flash: Flash, made: TunedParts) -> Flash:
    """The flash with factors on its spectrum and its power; its lux or watts follow."""
    spectrum = tuned_spectrum(flash.spectrum, made.flash_nodes_nm, made.flash_spectrum)
    if flash.illuminance_lx is not None:
        share = made.flash_power * illuminance(spectrum) / illuminance(flash.spectrum)
        return replace(flash, spectrum=spectrum, illuminance_lx=flash.illuminance_lx * share)
    assert flash.irradiance_W_m2 is not None  # exactly one is given
    share = made.flash_power * float(spectrum.integral()) / float(flash.spectrum.integral())
    return replace(flash, spectrum=spectrum, irradiance_W_m2=flash.irradiance_W_m2 * share)


def photographed(view: OrganView, camera: Camera, seed: tuple[int, int]) -> Patch:
    """The organ's pixels in a picture of a view: light, electrons, noise, digital numbers, codes."""
    from pepperscene.render import Renderer

    tone = camera.developing.tone
    drawn = int(np.random.default_rng(seed).integers(2**31))
    electrons = Renderer(view.scene).render(camera, ["electrons"], LIGHT, drawn)["electrons"]
    rgb = camera_rgb(electrons, camera, np.random.default_rng((*seed, 1)))
    codes = encode_tone(correct_colours(rgb, camera), tone)[view.mask]
    return Patch(view.name, view.kind, view.name, decode_tone(codes, tone), codes)


def _seen(recipe: Recipe, kinds: Sequence[str], organs: int, pixels: int, seed: int) -> TuningTarget:
    """A subject with views of these kinds: of each a grey pixel, which nothing is compared with."""
    organ_kinds = [kind for kind in kinds if is_organ_kind(kind)]
    grey = np.full((1, 3), 188, np.uint8)
    blank = PatchSet(
        "none", tuple(Patch(kind, kind, "none", decode_tone(grey), grey) for kind in organ_kinds)
    )
    subject = TuningTarget(recipe, blank, registered=True, organs=organs, pixels=pixels, seed=seed)
    for kind in kinds:
        if kind not in subject.kinds:
            raise InputError(
                "twin", 'must be an organ\'s, such as "leaf" or "pepper.unripe"', key="kind", value=kind
            )
    return subject
