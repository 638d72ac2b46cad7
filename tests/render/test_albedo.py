"""The output `albedo` against closed forms: grey cards, leaves by PROSPECT, edges, reliefs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, sheet
from greenhouse import camera, digests, greenhouse, row_of_plants
from scipy.ndimage import binary_erosion
from test_kernel_reuse import count_compiled

from pepperscene.camera import Developing, colour_transform, reference_light
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.materials.gloss import cone_gloss, cuticle_transmittance
from pepperscene.materials.leaf import leaf_optics, leaf_surface
from pepperscene.render import Renderer
from pepperscene.render.aov import albedo
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum

FOCAL_PX = 4.16e-3 / 9e-6  # of `axis_camera`
NM = np.arange(360.0, 831.0, 2.0)
VIEW = axis_camera(12, 8)
STATE = 0.5  # of the vertices of test bodies
GREY = lambertian_surface("grey", 0.5)


def turned(mesh):
    """A sheet at the origin, seen from its back at 50 cm."""
    return mesh.moved(np.diag([-1.0, 1.0, -1.0]), np.array([0.0, 0.0, 0.5]))


def albedo_of(mesh, surface, view=VIEW, sky=None):
    surfaces = dict.fromkeys(mesh.surfaces, surface)
    frame = Renderer(assemble_scene(mesh, surfaces, sky)).render(view, ["albedo"])
    return frame["albedo"].astype(float)


def seen(view, nm, reflectance):
    """`(3,)` linear sRGB of a reflectance on a grid, by the definition."""
    fine = np.arange(300.0, 1100.0, 0.1)
    weight = view.sensor.electrons_per_joule(fine) * reference_light(view).at(fine)
    spectrum = np.interp(fine, nm, reflectance)
    return colour_transform(view)[1] @ ((weight @ spectrum) / weight.sum(axis=1))


@pytest.mark.parametrize("reflectance", [0.0, 0.18, 1.0])
def test_grey_card_has_its_reflectance(reflectance):
    image = albedo_of(sheet(1.0, 1.0, 0.5, "grey"), lambertian_surface("grey", reflectance))
    assert image.shape == (8, 12, 3)
    # Half of the spacing of 16-bit floats, and what single precision leaves.
    np.testing.assert_allclose(image, reflectance, rtol=2.0**-11, atol=1e-6)


def test_monochrome_sensor_has_one_channel():
    curves = VIEW.sensor.quantum_efficiency
    green = Spectrum(curves.wavelength_nm, curves.values[1:2])
    view = replace(VIEW, sensor=replace(VIEW.sensor, pattern="mono", quantum_efficiency=green))
    image = albedo_of(sheet(1.0, 1.0, 0.5, "grey"), GREY, replace(view, flash=None))
    assert image.shape == (8, 12, 1)
    np.testing.assert_allclose(image, 0.5, rtol=2.0**-11)


def leaf_path(**changes):
    return load_cultivar("kaite").pigments["leaf"].model_copy(update=changes)


DAYLIGHT = replace(VIEW, flash=None, developing=Developing(white_balance="daylight"))


@pytest.mark.parametrize(
    ("side", "view"),
    [(0, VIEW), (1, DAYLIGHT), (0, replace(VIEW, developing=Developing(colour_matrix=False)))],
)
def test_leaf_without_gloss_has_the_reflectance_of_prospect(side, view):
    path = leaf_path(ior=1.0)
    expected = seen(view, NM, leaf_optics(path, NM, np.array([STATE]))[side][0])
    blade = sheet(1.0, 1.0, 0.5, "leaf") if side == 0 else turned(sheet(1.0, 1.0, 0.0, "leaf"))
    image = albedo_of(blade, leaf_surface("leaf", path, NM), view)
    assert np.ptp(image, axis=(0, 1)).max() == 0
    # Green, as a leaf is; the tables of states err by .002 at most.
    assert expected[1] > 1.05 * expected[0] > 1.05 * expected[2]
    np.testing.assert_allclose(image[0, 0], expected, atol=2e-3)


def test_gloss_is_not_part_of_the_albedo():
    """The gloss is taken off what PROSPECT's leaf reflects; the rest passes the cuticle twice."""
    rough = leaf_path().roughness[0]
    # With both sides equally rough, the cuticle sends no transmitted light back.
    path = leaf_path(wide_roughness=None, roughness=(rough, rough))
    gloss, openness = cone_gloss(path.ior, rough), cuticle_transmittance(path.ior, rough)[1]
    leaf = leaf_optics(path, NM, np.array([STATE]))[0][0]
    body = np.clip((leaf - gloss) / (1.0 - gloss), 0.0, 1.0)
    surface = leaf_surface("leaf", path, NM)
    image = albedo_of(sheet(1.0, 1.0, 0.5, "leaf"), surface)
    np.testing.assert_allclose(image[0, 0], seen(VIEW, NM, openness * body), atol=2e-3)
    # A body that absorbs all light under the same gloss is black.
    black = replace(surface, reflectance=np.zeros_like(surface.reflectance))
    assert not albedo_of(sheet(1.0, 1.0, 0.5, "leaf"), black).any()


def test_edges_have_the_mean_over_the_area_of_a_pixel():
    # The card covers columns 0 to 3, and .3 of column 4.
    size, edge = 0.5 / FOCAL_PX, 4.3
    mesh = card((edge - 6.0 - 10.0) * size, 0.0, 20.0 * size, 1.0, "grey")
    image = albedo_of(mesh, GREY)
    assert (image[:, :4] == 0.5).all()
    assert (image[:, 5:] == 0.0).all()
    np.testing.assert_allclose(image[:, 4], 0.5 * 0.3, atol=0.5 / 16)


@pytest.mark.parametrize("degrees", [0.0, 40.0])
def test_lossless_matt_relief_has_albedo_1(degrees):
    ramp = np.tan(np.radians(degrees)) * 1000.0 * np.abs(np.linspace(-1, 1, 64))
    relief = np.broadcast_to(ramp, (1, 64, 64)).astype(np.float32)
    surface = replace(lambertian_surface("white", 1.0), relief_mm=relief)
    mesh = rectangle([0.5, 0.0, 0.5], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], surface="white")
    np.testing.assert_allclose(albedo_of(mesh, surface), 1.0, atol=2e-3)


def test_light_of_the_scene_has_no_influence():
    mesh, surface = sheet(1.0, 1.0, 0.5, "leaf"), leaf_surface("leaf", leaf_path(), NM)
    lit = replace(DAYLIGHT, flash=VIEW.flash, exposure_s=1.0)
    images = [
        albedo_of(mesh, surface, *light) for light in ((DAYLIGHT, None), (DAYLIGHT, EVEN_SKY), (lit, None))
    ]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_it_is_as_even_as_the_surface_and_does_not_change_other_outputs(monkeypatch):
    scene, outputs = greenhouse(), ["electrons", "class", "instance", "distance"]
    used = Renderer(scene)
    both = used.render(camera(), [*outputs, "albedo"], "draft", 5)
    without = digests(Renderer(scene).render(camera(), outputs, "draft", 5))
    assert without == {name: digests(both)[name] for name in outputs}
    # No random number is in it, it is the same in parts, and it is where surfaces are.
    monkeypatch.setattr(albedo, "_LANES", 16 * 1000)
    alone = Renderer(scene).render(camera(), ["albedo"], "draft", 6)
    assert digests(alone)["albedo"] == digests(both)["albedo"]
    image, covered = both["albedo"].astype(float), both["instance"] > 0
    assert np.isfinite(image).all()
    assert (image[binary_erosion(covered)].max(axis=-1) > 0.02).all()
    # Another camera compiles nothing.
    used.render(camera(0), ["albedo"])
    assert count_compiled(lambda: used.render(camera(2, columns=84, rows=63), ["albedo"])) == 0


def test_white_plants_have_their_coverage():
    mesh = row_of_plants()
    # Their residue is white as well.
    white = {name: replace(lambertian_surface(name, 1.0), residue_reflectance=1.0) for name in mesh.surfaces}
    frame = Renderer(assemble_scene(mesh, white)).render(camera(), ["albedo", "coverage"])
    difference = frame["albedo"][..., 1] - (1.0 - frame["coverage"][..., 0].astype(float))
    # 16 points of a pixel against 64; the standard deviation over half-planes is about .04.
    assert np.abs(difference).max() < 0.2
    assert abs(difference.mean()) < 5e-4
    assert 0.1 < (frame["coverage"][..., 0] < 1).mean() < 0.9


def test_needs_surfaces_which_labels_do_not():
    mesh = sheet(1.0, 1.0, 0.5, "grey")
    Renderer(assemble_scene(mesh)).render(VIEW, ["class", "amodal"])
    with pytest.raises(ValueError, match="no surfaces"):
        Renderer(assemble_scene(mesh)).render(VIEW, ["albedo"])
