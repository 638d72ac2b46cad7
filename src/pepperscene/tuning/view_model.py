"""Views of organs as functions of the parameters, with derivatives.

Light is computed by the differentiable renderer, in every wavelength; the camera is a few formulas. The
derivatives of parameters that change light are Dr.Jit's, in forward mode. Those of exposure, white balance
and colour matrix, which act on the counted electrons, are finite differences of the formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import pedestal
from pepperscene.cultivar import Cultivar, Distribution
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.render.gradients.tunable import path_values
from pepperscene.render.quality import Quality
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.observables import OBSERVABLE_COUNT, SensorModel, observables, standardised_noise
from pepperscene.tuning.tuned import TunedParts
from pepperscene.tuning.views import OrganView

Array = NDArray[np.float64]
Values = Mapping[str, Array]
VIEW_QUALITY: Final = Quality(16, 16, 16, 1, target=None, denoise=False)
"""Chosen: the noise of a view's mean is then a thousandth of it; a single organ hardly lights itself."""
LIGHT_GROUPS: Final = ("pigments", "cuticle", "light")  # the others change what the camera makes of it
_STEP: Final = 1e-4
"""Finite-difference step, in prior standard deviations, from a parameter to the renderer's tables. These
functions are smooth and in double precision, so that the error is about 1e-8 of the slope."""
_NOISE_IMAGES: Final = 24  # chosen: a standard error is then known to a seventh


@dataclass(frozen=True)
class Entry:
    """One scalar of a fit: the entry of a parameter with this index."""

    parameter: Parameter
    index: int

    @property
    def label(self) -> str:
        """Name of the parameter, with the entry's label if there are several."""
        return self.parameter.entry_labels[self.index]

    @property
    def prior(self) -> Distribution:
        """Prior distribution."""
        return self.parameter.prior[self.index]

    def value(self, values: Values) -> float:
        """Its value, or the default if it is not among the values."""
        return float(np.asarray(values.get(self.parameter.name, self.parameter.default))[self.index])

    def with_step(self, values: Values, step: float) -> dict[str, Array]:
        """Values with a step added to this entry."""
        changed = np.array(values.get(self.parameter.name, self.parameter.default), float)
        changed[self.index] += step
        return {**values, self.parameter.name: changed}


def entries_of(parameters: Sequence[Parameter]) -> tuple[Entry, ...]:
    """All entries of some parameters, in order."""
    return tuple(
        Entry(parameter, index) for parameter in parameters for index in range(len(parameter.default))
    )


@dataclass(frozen=True, eq=False)
class ParameterStep:
    """The recipe's parts at two values of one entry, for a finite difference."""

    above: TunedParts  # parts at the larger and at the smaller value
    below: TunedParts  # parts at the larger and at the smaller value
    width: float  # difference of the values
    changes_light: bool  # whether the light changes, or only what the camera makes of it

    @classmethod
    def along(cls, entry: Entry, values: Values, tuned_parts: Callable[[Values], TunedParts]) -> Self:
        """Return a central step along an entry; at a bound a one-sided one that stays within the bounds."""
        prior, value = entry.prior, entry.value(values)
        step = _STEP * float(prior.sd)
        up, down = min(step, prior.high - value), min(step, value - prior.low)
        if up <= 0.0 and down <= 0.0:
            raise ValueError(f"{entry.label} cannot change: its bounds are {prior.low:g} to {prior.high:g}")
        up, down = max(up, 0.0), max(down, 0.0)
        above, below = tuned_parts(entry.with_step(values, up)), tuned_parts(entry.with_step(values, -down))
        return cls(above, below, up + down, entry.parameter.group in LIGHT_GROUPS)


class ViewModel:
    """One view as a function of the recipe's parts.

    Args:
        view: The view, of surfaces that the cultivar's pigments make.
        cultivar: The cultivar.
        seed: Seed of light and noise.
        quality: Samples of light.
    """

    def __init__(self, view: OrganView, cultivar: Cultivar, seed: int, quality: Quality) -> None:
        self.view = view
        self._cultivar, self._seed, self._quality = cultivar, seed, quality
        camera, steps = view.camera, view.camera.developing
        noise = standardised_noise(
            int(view.mask.sum()), camera.sensor.channels, np.random.default_rng([seed, 1])
        )
        self._sensor = SensorModel(
            camera.sensor,
            steps.saturation,
            noise if steps.shot_noise or steps.read_noise else None,
            steps.shot_noise,
            steps.read_noise,
            scales_time=camera.flash is None,
            pedestal=pedestal(camera),
        )

    def electrons(self, parts: TunedParts) -> Array:
        """`(n, c)` electrons that the photosites of the view's pixels expect."""
        return self._renderer.rgb(self._light(parts))[self.view.mask]

    def linear(self, parts: TunedParts, shade: Array) -> Array:
        """`(n, 3)` linear sRGB of the view's pixels; neighbours let the fraction `shade` `(c,)` through."""
        return self._developed(shade * self.electrons(parts), parts)

    def linear_and_derivatives(
        self, parts: TunedParts, steps: Sequence[ParameterStep], shade: Array
    ) -> tuple[Array, Array]:
        """`linear`, and its derivatives `(p, n, 3)` along steps."""
        electrons = shade * self.electrons(parts)
        linear, by_electrons, unclipped = self._sensor.linear_and_slopes(
            electrons, parts.exposure, parts.gains, parts.matrix
        )
        derivatives = np.zeros((len(steps), *linear.shape))
        parameters = self._light(parts)
        for derivative, step in zip(derivatives, steps, strict=True):
            if step.changes_light:
                direction = _direction(self._light(step.above), self._light(step.below), step.width)
                if direction:
                    change = shade * self._renderer.forward(parameters, direction)[self.view.mask]
                    derivative[:] = unclipped * ((by_electrons * change) @ parts.matrix.T)
            else:
                above, below = (self._developed(electrons, end) for end in (step.above, step.below))
                derivative[:] = (above - below) / step.width
        return linear, derivatives

    def standard_errors(self, parts: TunedParts) -> Array:
        """`(8,)` standard errors of the observables of one image, from the noise of its sensor alone."""
        electrons, rng = self.electrons(parts), np.random.default_rng([self._seed, 2])
        if self._sensor.noise is None:
            return np.zeros(OBSERVABLE_COUNT)
        samples = []
        for _ in range(_NOISE_IMAGES):
            sensor = replace(self._sensor, noise=rng.standard_normal(electrons.shape))
            samples.append(observables(sensor.linear(electrons, parts.exposure, parts.gains, parts.matrix)))
        return np.asarray(np.std(samples, axis=0, ddof=1))

    @property
    def nodes_nm(self) -> Array:
        """`(m,)` wavelengths of the renderer's factors on the flash spectrum."""
        return self._renderer.flash_nodes_nm

    @cached_property
    def _renderer(self) -> DifferentiableRenderer:
        return DifferentiableRenderer(
            self.view.scene, self.view.camera, self._cultivar, self._quality, self._seed
        )

    def _light(self, parts: TunedParts) -> dict[str, Array]:
        """The renderer's parameters for this view."""
        values: dict[str, Array] = {}
        for surface, path in parts.pigments.items():
            values |= path_values(surface, path)
        if parts.flash_factors.size:
            values |= {"flash.spectrum": parts.flash_factors}
        values |= {"flash.power": np.array(parts.flash_power)}
        return {name: np.asarray(values[name]) for name in self._renderer.parameters if name in values}

    def _developed(self, electrons: Array, parts: TunedParts) -> Array:
        return self._sensor.linear(electrons, parts.exposure, parts.gains, parts.matrix)


def _direction(above: dict[str, Array], below: dict[str, Array], width: float) -> dict[str, Array]:
    """Derivatives of the renderer's parameters that change."""
    derivatives = {name: (value - below[name]) / width for name, value in above.items()}
    return {name: change for name, change in derivatives.items() if np.any(change != 0.0)}
