"""The reference for exposures in which the camera moves: the mean of images of cameras that stand still.

Each image has one pose, and its rows are combined afterwards: only the poses and the times of the rows are
those of our integrator, not how it samples time and moves rays and the flash.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.sensor.rows import RowWindows
from pepperscene.render.quality import Quality
from pepperscene.render.reference.path_tracer import path_scene, path_traced, samples_taken
from pepperscene.scene import Scene

INSTANTS: Final = 16
"""Chosen: images of each row over the time of a light; a sixteenth of a blur of ten pixels is below one."""


def exposed_paths(
    scene: Scene, camera: Camera, quality: Quality, seed: np.random.SeedSequence
) -> tuple[NDArray[np.float32], float]:
    """Trace an exposure with Mitsuba's path tracer.

    Daylight is traced at `INSTANTS` times in the exposure and the flash at as many in its pulse: a random one
    in each equal part of them. Each of the two lights has the quality's samples, divided among its times.

    Returns:
        `(h, w, c)` electrons s-1 m-2 sr-1, averaged over the exposure; and the samples per pixel.
    """
    signal = np.zeros((camera.height, camera.width, camera.sensor.channels))
    flash, samples = camera.flash, 0.0
    if scene.sky is not None or flash is None:
        daylight = replace(camera, flash=None)
        exposures = camera.shutter.exposures()
        samples += _add_instants(signal, scene, daylight, exposures, camera.exposure_s, quality, seed)
    if flash is not None:
        dark = replace(scene, sky=None)
        lit, longest = camera.shutter.flash_windows(flash.pulse_s), min(flash.pulse_s, camera.exposure_s)
        samples += _add_instants(signal, dark, camera, lit, longest, quality, seed)
    return signal.astype(np.float32), samples


def _add_instants(
    signal: NDArray[np.float64],
    scene: Scene,
    camera: Camera,
    windows: RowWindows,
    longest_s: float,
    quality: Quality,
    seed: np.random.SeedSequence,
) -> float:
    """Add the light of rows in their windows, as fractions of `longest_s`; return the samples per pixel."""
    step = longest_s / INSTANTS
    spp = -(-quality.samples // INSTANTS)
    (stream,) = seed.spawn(1)
    begin, finish = float(windows.begin_s.min()), float(windows.end_s.max())
    # One random time in each step. They repeat after all steps, so that each complete window has as many.
    number = np.arange(-1, int(np.ceil((finish - begin) / step)) + 1)
    times = begin + (number + np.random.default_rng(stream).random(INSTANTS)[number % INSTANTS]) * step
    kernel_scene = path_scene(scene, camera)
    for t, branch in zip(times, stream.spawn(len(times)), strict=True):
        rows = np.flatnonzero((windows.begin_s <= t) & (t < windows.end_s))
        if not rows.size:
            continue
        first, end = int(rows[0]), int(rows[-1]) + 1
        still = replace(camera, pose=camera.pose_at(t), motion=None)
        image = path_traced(
            scene,
            still,
            spp=spp,
            bounces=max(quality.bounces, quality.most_bounces),
            sampler=quality.sampler,
            seed=int(branch.generate_state(1)[0]),
            kernel_scene=kernel_scene,
            rows=(first, end),
        )
        signal[rows] += image[rows - first] / INSTANTS
    return float(INSTANTS * samples_taken(quality.sampler, spp))
