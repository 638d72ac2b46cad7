"""Small frames with a reference, shared by the tests of the rendering error."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from bodies import axis_camera
from test_convergence import sphere_and_leaf

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, correct_colours
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Scene

COLUMNS, ROWS = 112, 84


def sphere_and_leaf_view() -> tuple[Scene, Camera]:
    """The scene of `test_convergence`, not overexposed."""
    camera = axis_camera(COLUMNS, ROWS)
    camera = replace(camera, sensor=replace(camera.sensor, binning=8), exposure_s=15e-6)
    return sphere_and_leaf(), camera


def bright_day(recipe: Recipe, exposure_us: float) -> dict[str, object]:
    """Changes of a recipe to bright daylight without a flash."""
    return {
        "daylight": replace(
            recipe.daylight,
            illuminance_lx=30e3,
            sun_azimuth_rad=np.radians(-60.0),
            sun_elevation_rad=np.radians(50.0),
        ),
        "camera": replace(recipe.camera, flash="none", exposure_s=exposure_us / 1e6),
        "developing": replace(recipe.developing, white_balance="daylight"),
    }


@cache
def plants_view(*, daylight: bool = False) -> tuple[Scene, Camera]:
    """Two plants of the demo with a fast lens: half-way up, by flash or by bright daylight alone."""
    recipe = load_recipe("demo", {"camera.lens": "lensagon_cmfa0420nd"})
    changes: dict[str, object] = {"row": replace(recipe.row, plants_front=1, plants_back=1)}
    if daylight:
        changes |= bright_day(recipe, 300.0)
    frames = FrameRenderer(recipe.model_copy(update=changes))
    spec = frames.recipe.plan.frame(125)
    camera = frames.camera(spec)
    return frames.scene(spec), replace(camera, sensor=replace(camera.sensor, columns=COLUMNS, rows=ROWS))


class Codes:
    """Converts small differences in electrons to codes of the developed image.

    Args:
        camera: with the developing settings.
        electrons: `(h, w, c)` nearly without noise, for the slope of the tone curve.
    """

    def __init__(self, camera: Camera, electrons: np.ndarray) -> None:
        # White balance and matrix alone; clipped channels have no slope.
        self._camera = replace(camera, developing=replace(camera.developing, saturation=False))
        linear = self._linear(electrons)
        # IEC 61966-2-1; 0 beyond black and white.
        value = np.clip(linear, 0.0031308, 1.0)
        slope = np.where(linear <= 0.0031308, 12.92, 1.055 / 2.4 * value ** (1 / 2.4 - 1.0))
        self._slope = np.where((linear <= 0.0) | (linear >= 1.0), 0.0, 255.0 * slope)

    def convert(self, electrons: np.ndarray) -> np.ndarray:
        """`(h, w, 3)` codes of a difference in electrons."""
        return self._slope * self._linear(electrons)

    def _linear(self, electrons: np.ndarray) -> np.ndarray:
        sensor = self._camera.sensor
        full = sensor.gain_e_per_dn * (sensor.full_scale_dn - sensor.black_level_dn)
        return correct_colours((electrons / full).astype(np.float32), self._camera).astype(float)


class WithReference:
    """A scene and camera with a reference in two independent halves.

    The product of the differences to both is the square of an error without the reference's own noise.
    """

    def __init__(self, scene: Scene, camera: Camera, *, bounces: int = 2, frames: int = 1) -> None:
        self.renderer, self.camera = Renderer(scene), camera
        best = Quality(256, 256, 256, bounces, target=None, denoise=False)
        self.halves = [
            np.mean([self.electrons(best, 1000 * half + k)[0] for k in range(1, frames + 1)], axis=0)
            for half in (1, 2)
        ]
        self.mean = np.mean(self.halves, axis=0)
        self.codes = Codes(camera, self.mean)

    def electrons(
        self, quality: str | Quality, seed: int, target: float | None = None
    ) -> tuple[np.ndarray, dict[str, float]]:
        """`(h, w, 3)` electrons of a frame, and its metadata about samples."""
        frame = self.renderer.render(self.camera, ["electrons"], quality, seed, target)
        return frame["electrons"].astype(float), frame.metadata["sampling"]

    def true_square(self, electrons: np.ndarray) -> float:
        """Mean square of the true error, codes."""
        first, second = (self.codes.convert(electrons - half) for half in self.halves)
        return float((first * second).mean())

    def errors(
        self, quality: str | Quality, target: float | None = None, frames: int = 6
    ) -> tuple[float, float, list[dict[str, float]]]:
        """True and reported error, root mean square over frames in codes, and the frames' metadata."""
        pairs = [self.electrons(quality, seed, target) for seed in range(frames)]
        true = np.sqrt(np.mean([self.true_square(electrons) for electrons, _ in pairs]))
        reported = np.sqrt(np.mean([metadata["error_codes"] ** 2 for _, metadata in pairs]))
        return float(true), float(reported), [metadata for _, metadata in pairs]
