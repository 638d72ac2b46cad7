"""What views look like at other values of the parameters, and how that changes with each of them.

Light goes through the differentiable renderer, in every wavelength; what the camera makes of it is a few
formulas. Derivatives of the parameters that change light are Dr.Jit's, forward; those of exposure, white
balance and colour matrix, which act on what was counted, are differences of those formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.gradients.pigment_models import path_values
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.render.quality import Quality
from pepperscene.tuning.model.observables import NUMBERS, PatchObservables, numbers, pixel_noise
from pepperscene.tuning.model.views import OrganView

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.tuning.parameters.parameter import Parameter
    from pepperscene.tuning.parameters.tuned import TunedParts


Array = NDArray[np.float64]
Values = Mapping[str, Array]

EFFORT: Final = Quality(16, 16, 16, 1, target=None, denoise=False)
"""Chosen: the noise of a view's mean is then a thousandth of it; organs alone hardly light themselves."""

IN_THE_SCENE: Final = ("pigments", "cuticle", "light")
"""Groups of parameters that change light; others change what the camera makes of it."""

_STEP: Final = 1e-4
"""Of a parameter's own scale, by which the chain from it to the renderer's tables is differentiated: its
functions are smooth and in double precision, so that the error is about 1e-8 of the slope."""

_PICTURES: Final = 24  # chosen: a standard error is then known to a seventh


@dataclass(frozen=True)
class Entry:
    """One number of a fit.

    Attributes:
        parameter: that it belongs to.
        place: among its entries.
    """

    parameter: Parameter
    place: int

    @property
    def label(self) -> str:
        """Name, with the entry's own where there are several."""
        own = self.parameter.labels[self.place]
        return f"{self.parameter.name} ({own})" if own else self.parameter.name

    @property
    def scale(self) -> float:
        """Standard deviation of its bounds."""
        return float(self.parameter.prior[self.place].sd)

    def moved(self, values: Values, step: float) -> dict[str, Array]:
        """Values with this one moved by a step."""
        own = np.array(values.get(self.parameter.name, self.parameter.default), float)
        own[self.place] += step
        return {**values, self.parameter.name: own}


def entries_of(parameters: Sequence[Parameter]) -> tuple[Entry, ...]:
    """Their numbers, in order."""
    return tuple(Entry(one, place) for one in parameters for place in range(len(one.default)))


@dataclass(frozen=True, eq=False)
class ParameterStep:
    """The recipe's parts a little to either side of some values, along one entry.

    Attributes:
        above, below: the parts there.
        width: of the entry between the two.
        in_the_scene: whether light changes.
    """

    above: TunedParts
    below: TunedParts
    width: float
    in_the_scene: bool

    @classmethod
    def along(cls, entry: Entry, values: Values, tuned: Callable[[Values], TunedParts]) -> Self:
        """The move along an entry; at an end of its bounds, inwards alone: beyond lies what cannot be."""
        law = entry.parameter.prior[entry.place]
        value = float(np.asarray(values.get(entry.parameter.name, entry.parameter.default))[entry.place])
        step = _STEP * entry.scale
        up, down = min(step, law.high - value), min(step, value - law.low)
        if up <= 0.0 and down <= 0.0:
            raise ValueError(f"{entry.label} cannot move: its bounds are {law.low:g} to {law.high:g}")
        up, down = max(up, 0.0), max(down, 0.0)
        above, below = tuned(entry.moved(values, up)), tuned(entry.moved(values, -down))
        return cls(above, below, up + down, entry.parameter.group in IN_THE_SCENE)


class ViewModel:
    """One view as a function of the recipe's parts.

    Args:
        view: what is seen.
        cultivar: whose pigments made its surfaces.
        seed: of light and noise.
        effort: of light.
    """

    def __init__(self, view: OrganView, cultivar: Cultivar, seed: int, effort: Quality) -> None:
        self.view = view
        self._cultivar, self._seed, self._effort = cultivar, seed, effort
        steps = view.camera.developing
        pixels, channels = int(view.mask.sum()), view.camera.sensor.channels
        noise = pixel_noise(pixels, channels, np.random.default_rng([seed, 1]))
        noisy = steps.shot_noise or steps.read_noise
        self._photograph = PatchObservables(
            view.camera.sensor,
            steps.saturation,
            noise if noisy else None,
            steps.shot_noise,
            steps.read_noise,
            timed=view.camera.flash is None,
        )

    def electrons(self, made: TunedParts) -> Array:
        """`(n, c)` that the photosites of the view's pixels expect."""
        return self._renderer.rgb(self._light(made))[self.view.mask]

    def linear(self, made: TunedParts, shade: Array) -> Array:
        """`(n, 3)` linear sRGB of the view's pixels.

        Args:
            made: the recipe's parts.
            shade: `(c,)` share of the light that neighbours let through, by colour.
        """
        return self._developed(shade * self.electrons(made), made)

    def linear_and_slopes(
        self, made: TunedParts, moves: Sequence[ParameterStep], shade: Array
    ) -> tuple[Array, Array]:
        """`linear`, and its derivatives `(p, n, 3)` along moves."""
        electrons = shade * self.electrons(made)
        found, by_electrons, free = self._photograph.linear_and_slope(
            electrons, made.exposure, made.gains, made.matrix
        )
        slopes = np.zeros((len(moves), *found.shape))
        parameters = self._light(made)
        for slope, move in zip(slopes, moves, strict=True):
            if move.in_the_scene:
                direction = _direction(self._light(move.above), self._light(move.below), move.width)
                if direction:
                    change = shade * self._renderer.forward(parameters, direction)[self.view.mask]
                    slope[:] = free * ((by_electrons * change) @ made.matrix.T)
            else:
                here = [self._developed(electrons, one) for one in (move.above, move.below)]
                slope[:] = (here[0] - here[1]) / move.width
        return found, slopes

    def noise(self, made: TunedParts) -> Array:
        """`(8,)` standard errors of the numbers of one picture, by the noise of its sensor alone."""
        electrons, rng = self.electrons(made), np.random.default_rng([self._seed, 2])
        if self._photograph.noise is None:
            return np.zeros(NUMBERS)
        found = []
        for _ in range(_PICTURES):
            taken = replace(self._photograph, noise=rng.standard_normal(electrons.shape))
            found.append(numbers(taken.linear(electrons, made.exposure, made.gains, made.matrix)))
        return np.asarray(np.std(found, axis=0, ddof=1))

    @property
    def nodes_nm(self) -> Array:
        """`(m,)` where the renderer takes factors of the flash's spectrum."""
        return self._renderer.flash_nodes_nm

    @cached_property
    def _renderer(self) -> DifferentiableRenderer:
        return DifferentiableRenderer(
            self.view.scene, self.view.camera, self._cultivar, self._effort, self._seed
        )

    def _light(self, made: TunedParts) -> dict[str, Array]:
        """The renderer's parameters of this view."""
        found: dict[str, Array] = {}
        for surface, path in made.pigments.items():
            found |= path_values(surface, path)
        if made.flash_spectrum.size:
            found |= {"flash.spectrum": made.flash_spectrum}
        found |= {"flash.power": np.array(made.flash_power)}
        return {name: np.asarray(found[name]) for name in self._renderer.parameters if name in found}

    def _developed(self, electrons: Array, made: TunedParts) -> Array:
        return self._photograph.linear(electrons, made.exposure, made.gains, made.matrix)


def _direction(above: dict[str, Array], below: dict[str, Array], step: float) -> dict[str, Array]:
    """How the renderer's parameters change, those that do."""
    found = {name: (value - below[name]) / step for name, value in above.items()}
    return {name: change for name, change in found.items() if np.any(change != 0.0)}
