"""What a fit may change and what it is compared with: the recipe's parts, its views, and the patches."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset import FrameRenderer
from pepperscene.errors import InputError
from pepperscene.tuning.model.observables import numbers
from pepperscene.tuning.model.problem import Cell, FitProblem, NeighbourEffect, alone
from pepperscene.tuning.model.reflectance import DirectModel
from pepperscene.tuning.model.view_model import EFFORT, Values, ViewModel
from pepperscene.tuning.model.views import ORGANS, PIXELS, OrganView, organ_views
from pepperscene.tuning.parameters.parameter import Parameter, known_parameters, select_parameters
from pepperscene.tuning.parameters.tuned import TunedParts, dense, tuned_parts

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.dataset import Recipe
    from pepperscene.render import Quality


Array = NDArray[np.float64]

FLOOR: Final = 0.5
"""Chosen: CIELAB units by which mean and spread of a colour may always differ: half of what can be seen."""
FLOOR_REGISTERED: Final = 0.06
"""The same where patches show the very organs of the views, besides the sensor's noise: what few samples of
light leave, 8 bits, and a camera in formulas. Chosen: twice what twins show, 0.03, as it is not by chance
alone and shifts numbers together."""
FLOOR_HUE: Final = 0.05
"""Chosen: radians by which hues may always differ, three degrees; half a bin and more of their spectra."""
FLOOR_HUE_REGISTERED: Final = 0.0025
"""Chosen: the same where patches show the very organs of the views; twins show 0.001."""
SPREAD: Final = 0.2
"""Chosen: share of a spread by which that of other organs differs; a few organs tell it no better."""

_HUE_OF_ORGANS: Final = 0.1  # radians by which hues of organs differ where nothing is known; chosen
_FLOORS_REGISTERED: Final = np.array([FLOOR_REGISTERED] * 6 + [FLOOR_HUE_REGISTERED] * 2)
_PIXELS: Final = 20_000  # of a kind that are compared; more tell nothing new
NOT_ORGANS: Final = ("background", "wire", "cut")


class TuningTarget:
    """A recipe about to be tuned to patches.

    Args:
        recipe: what is tuned.
        patches: what is measured.
        bounds: of parameters, over the shipped ones: a file or a table (see `select_parameters`).
        registered: whether patches are named after views and show the same organs, as of a twin; else
            organs are a sample on either side.
        organs: of each kind that are looked at.
        pixels: along the sides of a view.
        effort: of light.
        seed: of organs, light and noise.

    Raises:
        InputError: the recipe, the bounds or the patches do not go with each other.
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
        effort: Quality = EFFORT,
        seed: int = 0,
    ) -> None:
        self.recipe, self.patches, self.registered = recipe, patches, registered
        self._bounds, self._organs, self._pixels = bounds, organs, pixels
        self._effort, self._seed = effort, seed
        self.stage = FrameRenderer(recipe)
        self.camera = self.stage.resolved.camera
        if self.camera.sensor.channels != 3:
            raise InputError(
                recipe.name, "must see colours to be tuned", key="camera.sensor", value=recipe.camera.sensor
            )
        self.cultivar = dense(self.stage.cultivar, self.stage.cultivar.pigments)

    # --- parameters -------------------------------------------------------------------------------------

    def parameters(self, names: Sequence[str]) -> tuple[Parameter, ...]:
        """Those of these names.

        Raises:
            InputError: as of `select_parameters`.
        """
        return select_parameters(self.recipe, self.cultivar, self.camera, names, self._bounds)

    def others(self, fitted: Iterable[str]) -> dict[str, tuple[Parameter, ...]]:
        """Parameters that were not fitted and that what is measured could depend on, by group."""
        taken = set(fitted)
        surfaces = {name for view in self.views for name in view.scene.mesh.surfaces}
        surfaces |= {one.surface for one in self.direct.shown} if self.direct is not None else set()
        known = known_parameters(self.cultivar, self.camera)
        # One name for each thing: those of single ends repeat others.
        plain = [name for name in known if name.count(".") < 2]
        wanted = [
            one
            for one in self.parameters([name for name in plain if name not in taken])
            if one.group not in ("pigments", "cuticle") or one.name.partition(".")[0] in surfaces
        ]
        groups = dict.fromkeys(one.group for one in wanted)
        return {group: tuple(one for one in wanted if one.group == group) for group in groups}

    def tuned(self, values: Values) -> TunedParts:
        """The recipe's parts at some values."""
        return tuned_parts(self.cultivar, self.camera, values, self._nodes_nm)

    @cached_property
    def _nodes_nm(self) -> Array:
        """Where the renderer takes factors of the flash's spectrum."""
        return self.eyes[0].nodes_nm if self.eyes else np.zeros(0)

    # --- what is seen -----------------------------------------------------------------------------------

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Of the patches out of pictures that have an organ."""
        found = dict.fromkeys(patch.kind for patch in self.patches.patches)
        return tuple(kind for kind in found if kind not in NOT_ORGANS)

    @cached_property
    def targets(self) -> Mapping[str, Array]:
        """`(n, 3)` linear sRGB of the patches, by kind; every picture counts the same, as in hue spectra.

        Where patches show the organs of the views, they are pooled pixel by pixel as those are.
        """
        if self.registered:
            return {kind: self.patches.pixels(kind) for kind in self.kinds}
        found = {}
        for kind in self.kinds:
            pictures = dict.fromkeys(patch.picture for patch in self.patches.of_kind(kind))
            share = _PIXELS // len(pictures)
            parts = [self.patches.select([picture]).pixels(kind) for picture in pictures]
            evenly = [np.arange(share) * len(part) // share for part in parts]
            found[kind] = np.concatenate([part[at] for part, at in zip(parts, evenly, strict=True)])
        return found

    @cached_property
    def views(self) -> tuple[OrganView, ...]:
        """Of the organs that the patches show."""
        if not self.kinds:
            return ()
        return organ_views(
            self.recipe,
            self.cultivar,
            self.camera,
            self.kinds,
            sky=self.stage.sky(0),
            organs=self._organs,
            pixels=self._pixels,
            seed=self._seed,
        )

    @cached_property
    def eyes(self) -> tuple[ViewModel, ...]:
        """The views as functions of the recipe's parts."""
        return tuple(
            ViewModel(view, self.cultivar, self._seed + place, self._effort)
            for place, view in enumerate(self.views)
        )

    @cached_property
    def direct(self) -> DirectModel | None:
        """The model of the measured reflectances, if there are any."""
        return (
            DirectModel.of(self.patches.spectra, self.cultivar, self.tuned) if self.patches.spectra else None
        )

    # --- the problem ------------------------------------------------------------------------------------

    def problem(
        self, names: Sequence[str], around: Mapping[str, NeighbourEffect] | None = None
    ) -> FitProblem:
        """The fit of some parameters to all patches.

        Args:
            names: of the parameters.
            around: by kind, what the whole scene does to single organs.
        """
        cells = self._by_view() if self.registered else self._by_kind(around or {})
        return FitProblem(self.parameters(names), self.tuned, cells, self.direct)

    def _by_view(self) -> list[Cell]:
        """A cell for each view that a patch is named after."""
        patches = {patch.name: patch for patch in self.patches.patches}
        eyes = [eye for eye in self.eyes if eye.view.name in patches]
        found = []
        for eye in eyes:
            pixels = patches[eye.view.name].linear
            target = numbers(pixels)
            sigma = np.hypot(_FLOORS_REGISTERED, eye.noise(self.tuned({})))
            found.append(Cell(eye.view.name, (eye,), target, sigma, alone()))
        return found

    def _by_kind(self, around: Mapping[str, NeighbourEffect]) -> list[Cell]:
        """A cell for each kind, all its organs together."""
        found = []
        for kind, pixels in self.targets.items():
            eyes = tuple(eye for eye in self.eyes if eye.view.kind == kind)
            if not eyes:
                continue
            target = numbers(pixels)
            sides = [[patch.linear for patch in self.patches.of_kind(kind)]]
            if kind not in around:
                # The scene as a whole shows many organs; the views' few are a sample as the patches are.
                sides.append([eye.linear(self.tuned({}), alone().shade) for eye in eyes])
            found.append(Cell(kind, eyes, target, _sigma(sides, target), around.get(kind, alone())))
        return found


def _sigma(sides: Sequence[Sequence[Array]], target: Array) -> Array:
    """`(8,)` by how much the numbers of samples of organs may differ from those of all.

    Args:
        sides: the pixels `(n, 3)` of each organ of each sample.
        target: numbers of the patches.
    """
    between = np.zeros(5)
    if len(sides[0]) == 1:
        # Of a single organ nobody knows how others differ; about as much as it does from place to place.
        between = np.append(target[3:6], [_HUE_OF_ORGANS] * 2)
    for side in sides:
        if len(side) > 1:
            seen = np.array([numbers(one) for one in side])[:, [0, 1, 2, 6, 7]]
            between = np.maximum(between, seen.std(axis=0, ddof=1))
    floors = np.array([FLOOR, FLOOR, FLOOR, FLOOR_HUE, FLOOR_HUE])
    of_mean = np.sqrt(floors**2 + between**2 * sum(1.0 / len(side) for side in sides))
    of_spread = FLOOR + SPREAD * np.sqrt(len(sides) / 2.0) * target[3:6]
    return np.concatenate([of_mean[:3], of_spread, of_mean[3:]])
