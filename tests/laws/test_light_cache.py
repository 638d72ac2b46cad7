"""Light that is gathered from cells at second hits, against closed forms and against paths."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, sheet
from greenhouse import camera, greenhouse

from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Quality, Renderer
from pepperscene.render.kernel.camera import spectral_response
from pepperscene.render.transport import channel_light
from pepperscene.render.transport.light_cache import light_cache
from pepperscene.render.transport.path_lengths import has_mainly_sun
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.scene.sky import Sun
from pepperscene.spectra import Spectrum

MATT = lambertian_surface("white", 1.0)
SMOOTH = replace(MATT, ior=1.5, roughness=(0.1, 0.1))
SKY = uniform_sky(Spectrum(np.array([300.0, 1100.0]), np.ones(2)), 1000.0)


def quality(samples: int, directions: int) -> Quality:
    return Quality(
        samples, samples, samples, 2, target=None, denoise=False, most_bounces=64, directions=directions
    )


@pytest.mark.parametrize("surface", [MATT, SMOOTH], ids=["matt", "smooth"])
def test_white_surfaces_in_an_even_sky_are_as_bright_as_the_sky(surface):
    """With any gloss, because all light that it does not reflect reaches the body.

    A pixel's ratio has a standard deviation of .002, so that the mean of all has one of 1e-4."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    ball.apply_translation((0.0, 0.0, 0.44))
    view = axis_camera(24, 18, flash=False)
    before_wall = assemble_scene(
        concatenate_meshes([body(ball, "white"), sheet(2.0, 2.0, 0.5, "white")]), {"white": surface}, SKY
    )
    behind_camera = assemble_scene(sheet(0.01, 0.01, -1.0, "white"), {"white": surface}, SKY)
    electrons, empty = (
        Renderer(scene).render(view, ("electrons",), quality(samples, 2), 1)["electrons"]
        for scene, samples in ((before_wall, 64), (behind_camera, 1))
    )
    ratio = electrons / empty
    assert ratio == pytest.approx(1.0, abs=0.05)
    assert ratio.mean() == pytest.approx(1.0, abs=1e-3)


def test_the_error_is_measured_with_half_of_the_paths(monkeypatch):
    counts = []
    monkeypatch.setattr(
        channel_light, "light_cache", lambda paths: (counts.append(paths.side.size), light_cache(paths))[1]
    )
    view = camera(flash=False)
    view = replace(view, developing=replace(view.developing, white_balance="daylight"))
    Renderer(greenhouse()).render(view, ("electrons",), "draft", 1)
    assert counts == [counts[0], (counts[0] + 1) // 2]


def test_gathered_light_has_the_mean_of_paths():
    """Two plants by daylight, by class and channel: standard errors of the ratios are below .5 %."""
    renderer, view = Renderer(greenhouse()), camera(flash=False)
    labels = renderer.render(view, ("class",))["class"]
    paths, gathered = (
        renderer.render(view, ("electrons",), quality(samples, directions), 1)["electrons"]
        for samples, directions in ((256, 0), (64, 2))
    )
    counts = np.bincount(labels.ravel())
    numbers = np.flatnonzero(counts[1:] >= 100) + 1
    assert OrganClass.LEAF in numbers
    for number in numbers:
        ratio = gathered[labels == number].mean(axis=0) / paths[labels == number].mean(axis=0)
        assert ratio == pytest.approx(1.0, abs=0.02), number


@pytest.mark.parametrize("directions", [1, 2])
def test_sunlight_from_a_second_surface_is_that_of_paths(directions):
    """The sun behind a grey sheet lights a wall behind the camera, from which its front has all sunlight."""
    sun = Sun(np.array([0.0, 0.0, 1.0]), Spectrum(np.array([300.0, 1100.0]), np.full(2, 0.05)))
    sheets = concatenate_meshes([sheet(0.6, 0.6, 0.5, "grey"), sheet(4.0, 4.0, -0.5, "grey")])
    grey, view = lambertian_surface("grey", 0.5), axis_camera(24, 18, flash=False)
    scene = assemble_scene(sheets, {"grey": grey}, replace(SKY, sun=sun))
    assert has_mainly_sun(scene, spectral_response(view, scene))
    without_sun = assemble_scene(sheets, {"grey": grey}, SKY)
    paths, gathered, dark = (
        Renderer(scene).render(view, ("electrons",), quality(samples, number), 1)["electrons"].mean()
        for scene, samples, number in (
            (scene, 256, 0),
            (scene, 64, directions),
            (without_sun, 64, directions),
        )
    )
    assert gathered == pytest.approx(paths, rel=0.02)
    assert gathered > 1.5 * dark


def test_gathering_needs_a_bounce():
    with pytest.raises(ValueError, match="directions need at least one bounce"):
        Quality(1, 1, 1, 0, target=None, denoise=False, directions=2)
