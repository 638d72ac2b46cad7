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
from pepperscene.render.transport.path_lengths import has_mainly_sun
from pepperscene.scene import Scene, assemble_scene, uniform_sky
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


def in_the_sun(scene: Scene) -> Scene:
    """The scene in the light of the sun, 45 degrees high, which is three times as strong as the sky's."""
    sun = Sun(np.array([0.5, 0.5, 0.5**0.5]), Spectrum(np.array([300.0, 1100.0]), np.full(2, 0.05)))
    materials = {surface.name: surface for surface in scene.surfaces}
    return assemble_scene(scene.mesh, materials, replace(SKY, sun=sun))


@pytest.mark.parametrize(("sunny", "pixels"), [(False, 100), (True, 400)])
def test_gathered_light_has_the_mean_of_paths(sunny, pixels):
    """Two plants by daylight, by class and channel: standard errors of the ratios are below .5 %.

    In the sun, that of the few fruit is 3 % (the mean of twelve seeds is .99 +- .01), so leaves are compared.
    """
    scene = in_the_sun(greenhouse()) if sunny else greenhouse()
    renderer, view = Renderer(scene), camera(flash=False)
    assert has_mainly_sun(scene, spectral_response(view, scene)) == sunny
    labels = renderer.render(view, ("class",))["class"]
    paths, gathered = (
        renderer.render(view, ("electrons",), quality(samples, directions), 1)["electrons"]
        for samples, directions in ((256, 0), (64, 2))
    )
    counts = np.bincount(labels.ravel())
    numbers = np.flatnonzero(counts[1:] >= pixels) + 1
    assert OrganClass.LEAF in numbers
    for number in numbers:
        ratio = gathered[labels == number].mean(axis=0) / paths[labels == number].mean(axis=0)
        assert ratio == pytest.approx(1.0, abs=0.02), number


def test_gathering_needs_a_bounce():
    with pytest.raises(ValueError, match="directions need at least one bounce"):
        Quality(1, 1, 1, 0, target=None, denoise=False, directions=2)
