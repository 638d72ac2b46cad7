"""An image as a smooth function of pigments, cuticles, flash and exposure, with its derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera, expected_electrons
from pepperscene.errors import ArgumentError
from pepperscene.render.arrays import device_array, local_coordinates
from pepperscene.render.gradients.detached_sampling import SamplePasses
from pepperscene.render.gradients.diff_tables import DiffTables, Tables
from pepperscene.render.gradients.tunable import RANGES, Parameters, Tunable, Values
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.quality import Quality, find_quality
from pepperscene.render.transport.lights import frame_tables
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar

Array = NDArray[np.float64]

FLASH_WEIGHTS: Final = 8  # chosen: resolves an LED's blue peak from the rise and fall of its phosphor

_EXPOSURE_POWERS: Final = {"exposure.time": 1.0, "exposure.gain": 1.0, "exposure.f_number": -2.0}
"""The image is proportional to each of these parameters to this power."""
_POSITIVE: Final = ("flash.power", "flash.spectrum", *_EXPOSURE_POWERS)


class DifferentiableRenderer:
    """An image of a scene as a smooth function of parameters, with its derivatives.

    Parameters are named after the scene's surfaces: `leaf.chlorophyll_ug_cm2` and the other contents of
    `Pigments`, `(k,)` at the knots of the surface's pigment path; `fruit.flesh_reflectance`, `fruit.ior`, and
    `fruit.roughness`, `(2,)` for front and back. For the light there are `flash.power`, a factor, and
    `flash.spectrum`, `(m,)` factors at `flash_nodes_nm`, linear in between; for the exposure `exposure.time`
    and `exposure.gain`, factors of the whole image, and `exposure.f_number`.

    The second lobe of a gloss, residue, ageing and textures are not parameters: they stay as in the scene.

    `exposure.time` assumes that the flash shines through the whole exposure, and `exposure.f_number` does not
    change the depth of field.

    Directions and wavelengths are sampled for the original surfaces and lights of the scene (see
    `gradients.detached_sampling`) and no path ends by Russian roulette: all images have the same random
    numbers. Far from the original surfaces noise grows, and no direction is sampled through one that
    transmits nothing: build a new renderer from a scene of the new surfaces there.

    Args:
        scene: with surfaces.
        camera: lens, sensor, flash and pose.
        cultivar: whose pigments made the surfaces; None offers cuticles, flash and exposure alone.
        quality: of `QUALITIES`; its samples in every pixel, and its bounces.
        seed: of all random numbers.
        flash_weights: number of factors of the flash's spectrum.

    Attributes:
        parameters: every parameter with their values in the scene and the camera.
        flash_nodes_nm: `(m,)` evenly over the range in which the sensor detects the flash.

    Raises:
        InputError: unknown quality, fruit have the colours of scans and no pigments, or the sensor has bands.
        ValueError: a surface differs from what the cultivar's pigments make, or `flash_weights` is below 1.
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
            raise ValueError(f"flash_weights must be at least 1, not {flash_weights}")
        if scene.mesh.colour is not None:
            problem = (
                "has fruit with the colours of scans, which have no pigments to fit: set scan_colour = false"
            )
            raise ArgumentError("scene", problem)
        if camera.sensor.pattern == "bands":
            raise ArgumentError(
                "camera", f"needs a colour or monochrome sensor; {camera.sensor.name} has bands"
            )
        quality = find_quality(quality) if isinstance(quality, str) else quality
        self._camera = camera

        # The original scene, which all random decisions are made for.
        response = spectral_response(camera, scene)
        grid = response.grid_nm
        kernel_scene = light_scene(scene, float(grid[0]), float(grid[-1]))
        rays, sky = camera_rays(camera, local_coordinates(scene.mesh)), sky_tables(scene, grid)
        self._frame = frame_tables(kernel_scene, rays, response, camera.flash, sky, roulette=False)
        self._passes = SamplePasses(self._frame, camera.width * camera.height, quality, seed)

        # The parameters, and the tables as functions of them.
        tunable = Tunable(scene.surfaces, cultivar, grid)
        self.flash_nodes_nm = np.zeros(0)
        values = dict(tunable.defaults)
        if self._frame.flash is not None:
            lit = grid[response.flash > 0.0]
            self.flash_nodes_nm = np.linspace(lit[0], lit[-1], flash_weights)
            values |= {"flash.power": np.array(1.0), "flash.spectrum": np.ones(flash_weights)}
        values |= {"exposure.time": np.array(1.0), "exposure.gain": np.array(1.0)}
        values["exposure.f_number"] = np.array(float(camera.lens.f_number))
        sun = None
        if sky is not None and self._frame.sun_optics is not None:
            sun = np.asarray(sky.sun_irradiance, float)[: grid.size]
        self._tables = DiffTables(tunable, response, self.flash_nodes_nm, sun)
        for value in values.values():
            value.setflags(write=False)
        self.parameters: Mapping[str, Array] = MappingProxyType(values)

    def rgb(self, parameters: Parameters | None = None) -> Array:
        """`(h, w, c)` expected electrons of each photosite, before noise and saturation.

        Args:
            parameters: those that differ from the scene's own.

        Raises:
            ValueError: a parameter is unknown, has a wrong shape, or is out of its range.
        """
        values = self._values(parameters or {})
        tables = _to_device(self._tables.tables(values))
        passes = self._passes
        return self._image([passes.sums(passes.lanes(tables, block)) for block in passes.blocks], values)

    def forward(self, parameters: Parameters, direction: Parameters) -> Array:
        """`(h, w, c)` derivative of the image along a direction of the parameters.

        Args:
            parameters: those that differ from the scene's own.
            direction: change of the entries of some parameters.

        Raises:
            ValueError: see `rgb`.
        """
        _, dr = mitsuba_modules()
        values, direction = self._values(parameters), self._with_shapes(direction)
        tables = _to_device(self._tables.tables(values))
        tangents = _to_device(self._tables.forward(values, direction))
        channels, sums = self._frame.channels, []
        for block in self._passes.blocks:
            for name, table in tables.items():
                dr.enable_grad(table)
                dr.set_grad(table, tangents[name])
            light = self._passes.lanes(tables, block)
            slopes = dr.forward_to(light, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            sums.append(self._passes.sums([*slopes, *dr.detach(light)]))
            dr.disable_grad(tables)
        picture = self._image([block_sums[:, channels:] for block_sums in sums], values)
        slope = self._image([block_sums[:, :channels] for block_sums in sums], values)
        by_exposure = sum(
            float(power * direction[name] / values[name])
            for name, power in _EXPOSURE_POWERS.items()
            if name in direction
        )
        return slope + by_exposure * picture

    def backward(self, parameters: Parameters, loss_gradient: ArrayLike) -> dict[str, Array]:
        """Derivatives of a loss with respect to some parameters.

        Args:
            parameters: to differentiate by, and their values.
            loss_gradient: `(h, w, c)` derivatives of the loss with respect to the image.

        Raises:
            ValueError: see `rgb`; or the gradient does not have the image's shape.
        """
        mi, dr = mitsuba_modules()
        values = self._values(parameters)
        # The steps from light to electrons scale each pixel: they are their own transpose.
        weights = self._image([self._flatten(loss_gradient)], values).reshape(-1, self._frame.channels)
        scale = float(np.abs(weights).max()) or 1.0  # keeps weights within single precision
        blocks = self._passes.blocks
        weights = np.pad(weights / scale, ((0, blocks[-1].stop - len(weights)), (0, 0)))
        tables = self._tables.tables(values)
        device_tables, loss = _to_device(tables), 0.0
        cotangents = {name: np.zeros(table.shape) for name, table in tables.items()}
        for block in blocks:
            columns = [device_array(column) for column in weights[block.start : block.stop].T]
            dr.enable_grad(device_tables)
            lanes, pixel = mi.Float(0.0), self._passes.pixel_in_block(block)
            for light, weight in zip(self._passes.lanes(device_tables, block), columns, strict=True):
                lanes += light * dr.gather(mi.Float, weight, pixel)
            dr.backward(lanes, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            slopes = {name: dr.grad(table) for name, table in device_tables.items()}
            lanes = dr.detach(lanes)
            dr.eval(lanes, slopes)
            loss += float(np.asarray(lanes).sum(dtype=np.float64))
            for name, slope in slopes.items():
                # Device arrays repeat a single entry; the copy is never read.
                cotangent = cotangents[name]
                cotangent += np.asarray(slope)[: cotangent.size].reshape(cotangent.shape)
            dr.disable_grad(device_tables)
        names = tuple(parameters)
        scaled = {name: scale * cotangent for name, cotangent in cotangents.items()}
        gradients = self._tables.backward(values, scaled, names)
        for name, power in _EXPOSURE_POWERS.items():
            gradients[name] = np.asarray(power * (scale * loss) / values[name])
        return {name: gradients[name] for name in names}

    def _image(self, sums: list[Array], values: Values) -> Array:
        """`(h, w, c)` electrons from sums over samples."""
        height, width = self._camera.height, self._camera.width
        signal = np.concatenate(sums)[: height * width].reshape(height, width, -1) / self._passes.samples
        stops = self.parameters["exposure.f_number"] / values["exposure.f_number"]
        exposure = float(values["exposure.time"] * values["exposure.gain"] * stops**2)
        return expected_electrons(signal, self._camera) * exposure

    def _flatten(self, loss_gradient: ArrayLike) -> Array:
        gradient = np.asarray(loss_gradient, dtype=float)
        shape = (self._camera.height, self._camera.width, self._frame.channels)
        if gradient.shape != shape:
            raise ValueError(f"loss_gradient must have the image's shape {shape}, not {gradient.shape}")
        return gradient.reshape(-1, shape[2])

    def _with_shapes(self, parameters: Parameters) -> dict[str, Array]:
        """Arrays of the parameters' own shapes; a single number is repeated."""
        arrays = {}
        for name, value in parameters.items():
            if name not in self.parameters:
                raise ValueError(f"unknown parameter {name!r}; allowed are {', '.join(self.parameters)}")
            shape, array = self.parameters[name].shape, np.asarray(value, dtype=float)
            if array.shape not in ((), shape):
                raise ValueError(f"{name} must have the shape {shape}, not {array.shape}")
            arrays[name] = np.broadcast_to(array, shape).copy()
        return arrays

    def _values(self, parameters: Parameters) -> dict[str, Array]:
        """All parameters, with the given ones checked."""
        changed = self._with_shapes(parameters)
        for name, value in changed.items():
            low, high = RANGES.get(name.rpartition(".")[2], (0.0, np.inf))
            if not ((value >= low) & (value <= high) & (value < np.inf)).all():
                raise ValueError(f"{name} must be finite and between {low:g} and {high:g}, not {value}")
        for name in _POSITIVE:
            if name in changed and not (changed[name] > 0.0).any():
                raise ValueError(f"{name} must be above 0")
        return {**self.parameters, **changed}


def _to_device(tables: Tables) -> dict[str, Any]:
    return {name: device_array(table) for name, table in tables.items()}
