"""Lamps in our integrator against Mitsuba's path tracer, which finds their light with other code."""

import dataclasses

import numpy as np
import pytest
from bodies import axis_camera, card, columns_of, matt, sheet, sphere

from pepperscene.camera import Developing, Lamp, aimed_axes
from pepperscene.camera.lamps.beam import even_beam, lambertian_beam
from pepperscene.camera.lamps.lamp import POINT, EmitterShape, ring
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum, read_spectrum

SPECTRUM = Spectrum(*columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"])
NM = np.array([300.0, 1100.0])
SURFACES = {
    "wall": matt("wall", NM, np.array([0.7, 0.4])),
    "ball": matt("ball", NM, np.array([0.3, 0.8])),
    "card": matt("card", NM, np.array([0.5, 0.5])),
}
OURS = Quality(samples=256, soft=256, most=256, bounces=2, target=None, denoise=False)


def lamp(shape, beam, position, aim, flux_lm=8e3, spectrum=SPECTRUM):
    axes = aimed_axes(np.subtract(aim, position), 0.3)
    return Lamp("lamp", spectrum, 1.0, beam, shape, np.array(position), axes).with_strength(flux_lm=flux_lm)


POINT_LAMP = lamp(POINT, even_beam(), (0.15, -0.1, 0.1), (0.0, 0.0, 0.5))
DISC = lamp(ring(0.05), lambertian_beam(), (-0.2, -0.1, 0.1), (0.0, 0.0, 0.5))
PANEL = lamp(
    EmitterShape(3, 2, (0.05, 0.05), (0.03, 0.04)), lambertian_beam(), (0.0, -0.25, 0.2), (0.0, 0.05, 0.5)
)
OTHER = dataclasses.replace(POINT_LAMP, spectrum=read_spectrum("light/cie_illuminants_colour_science", "a"))
# Right of the camera, in its axes.
AT_CAMERA = lamp(ring(0.03, 0.02), lambertian_beam(), (0.05, 0.0, 0.0), (0.0, 0.0, 0.5), 4e3)
CASES = {
    "point": ([POINT_LAMP], []),
    "disc": ([DISC], []),
    "panel, point of another spectrum, and ring at the camera": ([PANEL, OTHER], [AT_CAMERA]),
    "many": (
        [
            dataclasses.replace(DISC, position_m=DISC.position_m + np.array([0.03 * k, 0, 0]))
            for k in range(12)
        ],
        [],
    ),
}


def scene_mesh():
    """A ball and a card in front of a wall."""
    return concatenate_meshes(
        [
            sheet(0.8, 0.6, 0.6, "wall"),
            sphere((0.03, 0.02, 0.5), 0.06, "ball", 3),
            card(-0.08, 0, 0.06, 0.1, "card", 0.45),
        ]
    )


def images(name, sensor="ueye_ui5250re"):
    """Blocks of electrons of both integrators, and the standard errors of their difference."""
    lamps, at_camera = CASES[name]
    scene = assemble_scene(scene_mesh(), SURFACES, lamps=lamps)
    camera = dataclasses.replace(axis_camera(16, 12, flash=False, sensor=sensor), lamps=tuple(at_camera))
    renderer, blocks = Renderer(scene), []
    for quality in (OURS, dataclasses.replace(OURS, integrator="path", sampler="multijitter")):
        stack = [
            renderer.render(camera, ["electrons"], quality, seed)["electrons"]
            .reshape(4, 3, 4, 4, -1)
            .mean((1, 3))
            for seed in range(4)
        ]
        blocks.append(np.stack(stack))
    means = [stack.mean(axis=0) for stack in blocks]
    # Four images say little about the error of a block: the relative error is that of all together.
    relative = sum(stack.var(axis=0, ddof=1) / mean**2 for stack, mean in zip(blocks, means, strict=True))
    error = means[1] * np.sqrt(relative.mean(axis=(0, 1)) / 4.0)
    return means[0] - means[1], error, means[1]


@pytest.mark.parametrize("name", CASES)
def test_light_of_lamps_is_that_of_the_path_tracer(name):
    difference, error, light = images(name)
    # Each of 48 differences in units of its error.
    score = difference / np.maximum(error, 1e-3 * light.mean())
    assert np.mean(score**2) < 2.0
    assert np.abs(score).max() < 5.0
    # Two lights that are chosen at random have the noise of the choice in all blocks.
    assert np.abs(difference.sum((0, 1)) / light.sum((0, 1))).max() < 6e-3


@pytest.mark.parametrize("name", ["panel, point of another spectrum, and ring at the camera", "many"])
def test_bands_see_the_light_that_colour_channels_see(name):
    lamps, at_camera = CASES[name]
    camera = dataclasses.replace(axis_camera(16, 12, flash=False), lamps=tuple(at_camera))
    bands = dataclasses.replace(
        camera,
        sensor=dataclasses.replace(camera.sensor, pattern="bands"),
        developing=Developing(white_balance="daylight"),
    )
    renderer = Renderer(assemble_scene(scene_mesh(), SURFACES, lamps=lamps))
    seen = [
        renderer.render(each, ["electrons"], dataclasses.replace(OURS, samples=64, soft=64))["electrons"]
        for each in (camera, bands)
    ]
    np.testing.assert_allclose(seen[1].sum((0, 1)), seen[0].sum((0, 1)), rtol=2e-3)
