"""The exposure as a factor of the picture, and its derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera, expected_electrons
from pepperscene.render.gradients.detached_sampling import Passes
from pepperscene.render.gradients.diff_tables import DiffTables, Tables
from pepperscene.render.gradients.pigment_models import RANGES, Values
from pepperscene.render.gradients.tunable import Parameters, Tunable
from pepperscene.render.kernel.arrays import device_table, local_coordinates
from pepperscene.render.kernel.camera import LensCache, response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.quality import Quality, find_quality
from pepperscene.render.transport.samples import FrameTables
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar


_POWERS: Final = {"exposure.time": 1.0, "exposure.gain": 1.0, "exposure.f_number": -2.0}
"""Of each parameter of the exposure in the picture."""


def exposure(values: Values, own: Values) -> float:
    """What the exposure makes of the camera's own picture, as a factor."""
    stops = own["exposure.f_number"] / values["exposure.f_number"]
    return float(values["exposure.time"] * values["exposure.gain"] * stops**2)


def relative_exposure(values: Values, along: Values) -> float:
    """The exposure's relative change along a direction."""
    return sum(float(power * along[name] / values[name]) for name, power in _POWERS.items() if name in along)


def by_exposure(values: Values, loss: float) -> dict[str, NDArray[np.float64]]:
    """Derivatives by the exposure of what grows with it in proportion."""
    return {name: np.asarray(power * loss / values[name]) for name, power in _POWERS.items()}


Array = NDArray[np.float64]

FLASH_WEIGHTS: Final = 8  # chosen: an LED's blue peak and the rise and fall of its phosphor lie apart


class DifferentiableRenderer:
    """A picture of a scene as a smooth function of parameters, with its derivatives.

    Parameters are named after the scene's surfaces: `leaf.chlorophyll_ug_cm2` and the other contents of
    `Pigments`, `(k,)` at the knots of the surface's path through pigment space; `fruit.flesh_reflectance`,
    `fruit.ior`, and `fruit.roughness`, `(2,)` for front and back. For the light there are `flash.power`,
    a factor, and `flash.spectrum`, `(m,)` factors at `flash_nodes_nm`, linear in between; for the exposure
    `exposure.time` and `exposure.gain`, factors of the whole picture, and `exposure.f_number`.

    The flash shines through the whole exposure, as `exposure.time` takes it, and a change of the f-number
    leaves the depth of field as it is.

    Directions and wavelengths are drawn for the surfaces and lights that the scene has (see
    `gradients.detached_sampling`) and no path ends by chance: the same parameters give the same picture, and
    any others one with the same random numbers. Far from the scene's own surfaces noise grows, and nothing is
    drawn through one that lets no light through at all: there go on from a scene of the new ones.

    Args:
        scene: with surfaces.
        camera: lens, sensor, flash and pose.
        cultivar: whose pigments made the surfaces; None offers those of cuticles, flash and exposure alone.
        quality: of `QUALITIES`; its samples in every pixel, and its bounces.
        seed: of all that is random.
        flash_weights: number of the spectrum's factors.

    Attributes:
        parameters: every parameter with the value that the scene and the camera have.
        flash_nodes_nm: `(m,)` evenly over the range in which the sensor sees the flash.

    Raises:
        InputError: unknown quality.
        ValueError: a surface is not what the cultivar's pigments make, or fewer than one weight is asked for.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        cultivar: Cultivar | None = None,
        quality: str | Quality = "standard",
        seed: int = 0,
        flash_weights: int = FLASH_WEIGHTS,
    ) -> None:
        if flash_weights < 1:
            raise ValueError(f"at least one weight of the flash's spectrum is needed, not {flash_weights}")
        effort = find_quality(quality) if isinstance(quality, str) else quality
        self._camera = camera

        # The renderer as it is, with everything that is drawn from it.
        spectral = response(camera, scene)
        grid = spectral.grid_nm
        light = light_scene(scene, float(grid[0]), float(grid[-1]))
        view, sky = LensCache().view(camera, local_coordinates(scene.mesh)), sky_tables(scene, grid)
        self._frame = FrameTables(light, view, spectral, camera.flash, sky)
        self._frame.roulette = False
        self._passes = Passes(self._frame, camera.width * camera.height, effort, seed)

        # What it depends on, and how.
        tunable = Tunable(scene.surfaces, cultivar, grid)
        self.flash_nodes_nm = np.zeros(0)
        values = dict(tunable.defaults)
        if self._frame.flash is not None:
            lit = grid[spectral.flash > 0.0]
            self.flash_nodes_nm = np.linspace(lit[0], lit[-1], flash_weights)
            values |= {"flash.power": np.array(1.0), "flash.spectrum": np.ones(flash_weights)}
        values |= {"exposure.time": np.array(1.0), "exposure.gain": np.array(1.0)}
        values["exposure.f_number"] = np.array(float(camera.lens.f_number))
        sun = None
        if sky is not None and self._frame.sunlit is not None:
            sun = np.asarray(sky.sun_irradiance, float)[: grid.size]
        self._leaves = DiffTables(tunable, spectral, self.flash_nodes_nm, sun)
        for value in values.values():
            value.setflags(write=False)
        self.parameters: Mapping[str, Array] = MappingProxyType(values)

    # --- the picture and its derivatives ----------------------------------------------------------------

    def rgb(self, parameters: Parameters | None = None) -> Array:
        """`(h, w, c)` electrons that each photosite expects, before noise and saturation.

        Args:
            parameters: those that differ from the scene's own.

        Raises:
            ValueError: an unknown parameter, or one of a wrong shape or out of its range.
        """
        values = self._values(parameters or {})
        leaves = _on_device(self._leaves.tables(values))
        passes = self._passes
        return self._picture([passes.sums(passes.lanes(leaves, block)) for block in passes.blocks], values)

    def forward(self, parameters: Parameters, direction: Parameters) -> Array:
        """`(h, w, c)` how the picture changes along a direction: its derivative times that direction.

        Args:
            parameters: those that differ from the scene's own.
            direction: how much the entries of some parameters change.

        Raises:
            ValueError: as of `rgb`.
        """
        _, dr = mitsuba_modules()
        values, along = self._values(parameters), self._shaped(direction)
        leaves = _on_device(self._leaves.tables(values))
        tangents = _on_device(self._leaves.forward(values, along))
        channels, found = self._frame.channels, []
        for block in self._passes.blocks:
            for name, leaf in leaves.items():
                dr.enable_grad(leaf)
                dr.set_grad(leaf, tangents[name])
            light = self._passes.lanes(leaves, block)
            slopes = dr.forward_to(light, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            found.append(self._passes.sums([*slopes, *dr.detach(light)]))
            dr.disable_grad(leaves)
        exposed = self._picture([sums[:, channels:] for sums in found], values)
        slope = self._picture([sums[:, :channels] for sums in found], values)
        return slope + relative_exposure(values, along) * exposed

    def backward(self, parameters: Parameters, loss_gradient: ArrayLike) -> dict[str, Array]:
        """Derivatives of a loss with respect to the parameters that are given.

        Args:
            parameters: those that are wanted, at the values where they are.
            loss_gradient: `(h, w, c)` derivatives of the loss with respect to the picture.

        Raises:
            ValueError: as of `rgb`, or the gradient does not have the picture's shape.
        """
        mi, dr = mitsuba_modules()
        values = self._values(parameters)
        # What comes behind the light scales each pixel, and is its own transpose.
        weights = self._picture([self._flat(loss_gradient)], values).reshape(-1, self._frame.channels)
        scale = float(np.abs(weights).max()) or 1.0  # so that single precision holds it
        blocks = self._passes.blocks
        weights = np.pad(weights / scale, ((0, blocks[-1].stop - len(weights)), (0, 0)))
        tables = self._leaves.tables(values)
        leaves, loss = _on_device(tables), 0.0
        found = {name: np.zeros(table.shape) for name, table in tables.items()}
        for block in blocks:
            columns = [device_table(column) for column in weights[block.start : block.stop].T]
            dr.enable_grad(leaves)
            lanes, place = mi.Float(0.0), self._passes.place(block)
            for light, weight in zip(self._passes.lanes(leaves, block), columns, strict=True):
                lanes += light * dr.gather(mi.Float, weight, place)
            dr.backward(lanes, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            slopes = {name: dr.grad(leaf) for name, leaf in leaves.items()}
            lanes = dr.detach(lanes)
            dr.eval(lanes, slopes)
            loss += float(np.asarray(lanes).sum(dtype=np.float64))
            for name, slope in slopes.items():
                # A table of one entry is there twice, and the second is never read.
                found[name] += np.asarray(slope)[: found[name].size].reshape(found[name].shape)
            dr.disable_grad(leaves)
        scaled = {name: scale * slope for name, slope in found.items()}
        names = tuple(parameters)
        slopes = self._leaves.backward(values, scaled, names) | by_exposure(values, scale * loss)
        return {name: slopes[name] for name in names}

    # --- the camera --------------------------------------------------------------------------------------

    def _picture(self, sums: list[Array], values: Values) -> Array:
        """`(h, w, c)` electrons from sums over samples."""
        height, width = self._camera.height, self._camera.width
        signal = np.concatenate(sums)[: height * width].reshape(height, width, -1) / self._passes.samples
        return expected_electrons(signal, self._camera) * exposure(values, self.parameters)

    # --- parameters -------------------------------------------------------------------------------------

    def _flat(self, image: ArrayLike) -> Array:
        given = np.asarray(image, dtype=float)
        shape = (self._camera.height, self._camera.width, self._frame.channels)
        if given.shape != shape:
            raise ValueError(
                f"derivatives with respect to a picture of {shape} are needed, not {given.shape}"
            )
        return given.reshape(-1, shape[2])

    def _shaped(self, parameters: Parameters) -> dict[str, Array]:
        """Arrays of the parameters' own shapes; a single number stands for all of a parameter's entries."""
        found = {}
        for name, value in parameters.items():
            if name not in self.parameters:
                known = ", ".join(self.parameters)
                raise ValueError(f"there is no parameter {name!r}; there are {known}")
            shape, given = self.parameters[name].shape, np.asarray(value, dtype=float)
            if given.shape not in ((), shape):
                raise ValueError(f"{name} has the shape {shape}, not {given.shape}")
            found[name] = np.broadcast_to(given, shape).copy()
        return found

    def _values(self, parameters: Parameters) -> dict[str, Array]:
        """All parameters, those that are given checked."""
        given = self._shaped(parameters)
        for name, value in given.items():
            low, high = RANGES.get(name.rpartition(".")[2], (0.0, np.inf))
            if not ((value >= low) & (value <= high) & (value < np.inf)).all():
                raise ValueError(f"{name} must lie in [{low:g}, {high:g}] and be finite, not {value}")
        for name in ("flash.power", "flash.spectrum", "exposure.time", "exposure.gain", "exposure.f_number"):
            if name in given and not (given[name] > 0.0).any():
                raise ValueError(f"{name} must be above 0")
        return {**self.parameters, **given}


def _on_device(tables: Tables) -> dict[str, Any]:
    return {name: device_table(table) for name, table in tables.items()}
