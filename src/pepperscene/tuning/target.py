"""A recipe and the patches that it is tuned to: parameters, views, targets, and the least-squares problem.

Simulated patches are those that a camera would deliver of a recipe with known parameter values, so that a fit
to them can be compared with the truth. They share nothing with the model of the fit: the renderer is the one
for images, light is sampled anew and four times as finely, photons and amplifier add noise, the converter
quantises, and the image has 8-bit codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, add_pedestal, camera_rgb, correct_colours, decode_tone, encode_tone
from pepperscene.colour import Patch, PatchSet
from pepperscene.colour.patches.patch import is_organ_kind
from pepperscene.errors import ArgumentError, InputError
from pepperscene.materials import organ_surfaces
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.render import Renderer
from pepperscene.render.quality import Quality
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.observables import observables
from pepperscene.tuning.parameters import known_parameters, select_parameters
from pepperscene.tuning.problem import NO_NEIGHBOURS, FitProblem, NeighbourEffect, Observation
from pepperscene.tuning.reflectance import DirectModel
from pepperscene.tuning.tuned import TunedParts, densify_cultivar, tuned_camera, tuned_parts
from pepperscene.tuning.view_model import VIEW_QUALITY, Values, ViewModel
from pepperscene.tuning.views import ORGANS, PIXELS, OrganView, organ_views, with_surfaces

Array = NDArray[np.float64]
LAB_ERROR: Final = 0.5
HUE_ERROR: Final = 0.05
"""Chosen: CIELAB units by which mean and spread of a colour may always differ (half of a visible difference),
and radians by which mean hue vectors may (three degrees, more than half a bin of hue spectra)."""
REGISTERED_LAB_ERROR: Final = 0.06
REGISTERED_HUE_ERROR: Final = 0.0025
"""The same for patches of the same organs as the views, in addition to the sensor's noise: few samples of
light, 8 bits, and a camera in formulas. Chosen: twice what simulated patches show (0.03 and 0.001), because
the errors are partly systematic and shift several observables together."""
RELATIVE_SPREAD_ERROR: Final = 0.2  # chosen: between organs; a few do not determine their spread better
_DEFAULT_HUE_SD: Final = 0.1  # radians; chosen: differences between organs if there is only one
_REGISTERED_ERRORS: Final = np.array([REGISTERED_LAB_ERROR] * 6 + [REGISTERED_HUE_ERROR] * 2)
_PIXELS: Final = 20_000  # of a kind that are compared; more add no information
NOT_ORGANS: Final = ("background", "wire", "cut")
SIMULATED_QUALITY: Final = Quality(64, 64, 64, 1, target=None, denoise=False)
"""Chosen: the noise of the light simulation is then far below that of photons."""


class TuningTarget:
    """A recipe and the patches that it is to be tuned to.

    Args:
        recipe: The recipe.
        patches: The measurements.
        bounds: A bounds file or its tables, overriding the shipped bounds (see `select_parameters`).
        registered: Whether patches are named after views and show the same organs, as simulated patches do;
            otherwise patches and views show different samples of organs.
        organs: Number of organs of each kind to view.
        pixels: Width and height of a view.
        quality: Samples of light in a view.
        seed: Seed of organs, light and noise.

    Attributes:
        camera: The recipe's camera, without a pose.
        cultivar: The recipe's cultivar with dense pigment paths.

    Raises:
        InputError: The recipe, the bounds or the patches are not valid, or the sensor is monochrome.
    """

    def __init__(
        self,
        recipe: Recipe,
        patches: PatchSet,
        *,
        bounds: str | Path | Mapping[str, Any] | None = None,
        registered: bool = False,
        organs: int = ORGANS,
        pixels: int = PIXELS,
        quality: Quality = VIEW_QUALITY,
        seed: int = 0,
    ) -> None:
        self.recipe, self.patches, self.registered = recipe, patches, registered
        self._bounds, self._organs, self._pixels = bounds, organs, pixels
        self._quality, self._seed = quality, seed
        if recipe.camera.exposure_s == AUTO:
            problem = "must be a time: colours are tuned at one exposure of all photographs"
            raise InputError(recipe.name, problem, key="camera.exposure_us", value=AUTO)
        if recipe.developing.isp is not None:
            problem = "must be left out: colours are tuned to linear light, which no image processor changed"
            raise InputError(recipe.name, problem, key="developing.isp")
        self.frame_renderer = FrameRenderer(recipe)
        self.camera = self.frame_renderer.resolved.camera
        if self.camera.sensor.pattern in ("mono", "bands"):
            problem, sensor = "must be a colour sensor", recipe.camera.sensor
            raise InputError(recipe.name, problem, key="camera.sensor", value=sensor)
        self.cultivar = densify_cultivar(self.frame_renderer.cultivar)

    def parameters(self, names: Sequence[str]) -> tuple[Parameter, ...]:
        """Return the parameters of these names; errors as for `select_parameters`."""
        return select_parameters(self.recipe, self.cultivar, self.camera, names, self._bounds)

    def unfitted_parameters(self, fitted: Iterable[str]) -> dict[str, tuple[Parameter, ...]]:
        """Parameters that are not fitted and that could change the predictions, by group."""
        excluded = set(fitted)
        surfaces = {name for view in self.views for name in view.scene.mesh.surfaces}
        if self.direct_model is not None:
            surfaces |= {surface.surface for surface in self.direct_model.surfaces}
        # Parameters of single path ends would duplicate those of the whole path.
        names = [name for name in known_parameters(self.cultivar, self.camera) if name.count(".") < 2]
        relevant = [
            parameter
            for parameter in self.parameters([name for name in names if name not in excluded])
            if parameter.group not in ("pigments", "cuticle") or parameter.name.partition(".")[0] in surfaces
        ]
        groups = dict.fromkeys(parameter.group for parameter in relevant)
        return {
            group: tuple(parameter for parameter in relevant if parameter.group == group) for group in groups
        }

    def tuned_parts(self, values: Values) -> TunedParts:
        """Return the recipe's parts at parameter values."""
        return tuned_parts(self.cultivar, self.camera, values, self._nodes_nm)

    @cached_property
    def _nodes_nm(self) -> Array:
        """Wavelengths of the renderer's factors on the flash spectrum."""
        return self.view_models[0].nodes_nm if self.view_models else np.zeros(0)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of organs of the patches from images."""
        kinds = dict.fromkeys(patch.kind for patch in self.patches.patches)
        return tuple(kind for kind in kinds if kind not in NOT_ORGANS)

    @cached_property
    def targets(self) -> Mapping[str, Array]:
        """`(n, 3)` linear sRGB of the patches by kind; equal weights of images unless registered."""
        if self.registered:
            return {kind: self.patches.pixels(kind) for kind in self.kinds}
        targets = {}
        for kind in self.kinds:
            images = dict.fromkeys(patch.picture for patch in self.patches.of_kind(kind))
            count = _PIXELS // len(images)
            parts = [self.patches.select([image]).pixels(kind) for image in images]
            indices = [np.arange(count) * len(part) // count for part in parts]
            targets[kind] = np.concatenate([part[at] for part, at in zip(parts, indices, strict=True)])
        return targets

    @cached_property
    def views(self) -> tuple[OrganView, ...]:
        """Views of the kinds of organs that the patches show."""
        if not self.kinds:
            return ()
        size = {"organs": self._organs, "pixels": self._pixels, "seed": self._seed}
        sky = self.frame_renderer.sky(self.recipe.plan.frame(0))
        return organ_views(self.recipe, self.cultivar, self.camera, self.kinds, sky=sky, **size)

    @cached_property
    def view_models(self) -> tuple[ViewModel, ...]:
        """The views as functions of the recipe's parts."""
        return tuple(
            ViewModel(view, self.cultivar, self._seed + i, self._quality) for i, view in enumerate(self.views)
        )

    @cached_property
    def direct_model(self) -> DirectModel | None:
        """Model of the measured reflectances, or None if there are none."""
        spectra = self.patches.spectra
        return DirectModel.of(spectra, self.cultivar, self.tuned_parts) if spectra else None

    def problem(
        self,
        names: Sequence[str],
        neighbours: Mapping[str, NeighbourEffect] | None = None,
        noise_at: Values | None = None,
    ) -> FitProblem:
        """Return the fit of these parameters to all patches.

        Args:
            names: of the parameters.
            neighbours: effects of neighbouring organs by kind, unless patches are registered.
            noise_at: values at which the sensor has the noise of registered patches: those of an earlier fit,
                since less light has more noise; None for the recipe's.
        """
        observations = self._by_view(noise_at or {}) if self.registered else self._by_kind(neighbours or {})
        return FitProblem(self.parameters(names), self.tuned_parts, observations, self.direct_model)

    def _by_view(self, noise_at: Values) -> list[Observation]:
        """One observation for each view that a patch is named after, with the noise at these values."""
        parts = self.tuned_parts(noise_at)
        patches = {patch.name: patch for patch in self.patches.patches}
        observations = []
        for model in self.view_models:
            name = model.view.name
            if name in patches:
                sigma = np.hypot(_REGISTERED_ERRORS, model.standard_errors(parts))
                target = observables(patches[name].linear)
                observations.append(Observation(name, (model,), target, sigma, NO_NEIGHBOURS))
        return observations

    def _by_kind(self, neighbours: Mapping[str, NeighbourEffect]) -> list[Observation]:
        """One observation for all organs of a kind."""
        observations = []
        for kind, pixels in self.targets.items():
            models = tuple(model for model in self.view_models if model.view.kind == kind)
            if not models:
                continue
            target = observables(pixels)
            samples = [[patch.linear for patch in self.patches.of_kind(kind)]]
            if kind not in neighbours:
                # The views are a small sample of organs, like the patches; the whole scene shows many.
                parts = self.tuned_parts({})
                samples.append([model.linear(parts, NO_NEIGHBOURS.shade) for model in models])
            effect = neighbours.get(kind, NO_NEIGHBOURS)
            observations.append(Observation(kind, models, target, _observable_sd(samples, target), effect))
        return observations


def _observable_sd(samples: Sequence[Sequence[Array]], target: Array) -> Array:
    """`(8,)` standard deviations of the difference between samples of organs; pixels of each organ given."""
    between = np.zeros(5)
    if len(samples[0]) == 1:
        # Differences between organs are unknown for a single one; assume those within the organ.
        between = np.append(target[3:6], [_DEFAULT_HUE_SD] * 2)
    for sample in samples:
        if len(sample) > 1:
            means = np.array([observables(pixels) for pixels in sample])[:, [0, 1, 2, 6, 7]]
            between = np.maximum(between, means.std(axis=0, ddof=1))
    errors = np.array([LAB_ERROR, LAB_ERROR, LAB_ERROR, HUE_ERROR, HUE_ERROR])
    of_mean = np.sqrt(errors**2 + between**2 * sum(1.0 / len(sample) for sample in samples))
    of_spread = LAB_ERROR + RELATIVE_SPREAD_ERROR * np.sqrt(len(samples) / 2.0) * target[3:6]
    return np.concatenate([of_mean[:3], of_spread, of_mean[3:]])


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
    tone = camera.developing.tone
    render_seed = int(np.random.default_rng(seed).integers(2**31))
    electrons = Renderer(view.scene).render(camera, ["electrons"], SIMULATED_QUALITY, render_seed)[
        "electrons"
    ]
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
