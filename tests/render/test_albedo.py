"""Albedo against closed forms, and maps of pigments, water, ripeness and age against what light sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, sheet
from greenhouse import camera, digests, greenhouse, row_of_plants
from scipy.ndimage import binary_erosion
from test_kernel_reuse import count_compiled

from pepperscene.camera import Developing, colour_transform, reference_light
from pepperscene.classes import Appearance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.materials.gloss import cone_gloss, cuticle_transmittance
from pepperscene.materials.leaf import leaf_optics, leaf_surface
from pepperscene.outputs import DEFAULT_OUTPUTS, TRAIT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.aov import albedo
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.surface.normals import lost_fraction
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum, leaf_spectra

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


TRAITS = sorted(TRAIT_OUTPUTS)


@pytest.fixture(scope="module")
def scene():
    """Two plants whose leaves have aged, each differently."""
    bare = greenhouse()
    ages = np.random.default_rng(4).uniform(0.0, 1.0, len(bare.mesh.appearances))
    appearances = tuple(
        replace(item, ageing=float(age)) for item, age in zip(bare.mesh.appearances, ages, strict=True)
    )
    return replace(bare, mesh=replace(bare.mesh, appearances=appearances))


@pytest.fixture(scope="module")
def frame(scene):
    return Renderer(scene).render(camera(), ["class", "instance", "uv", *TRAITS])


def reflectance_at_centres(scene, view):
    """`(h, w)` reflectance of what the rays through the centres of pixels hit, as light sees it."""
    mi, dr = mitsuba_modules()
    kernel_scene = light_scene(scene, 500.0, 600.0)
    rays = camera_rays(view, local_coordinates(scene.mesh))
    row, column = (
        mi.UInt32(part.ravel().astype(np.uint32)) for part in np.mgrid[: view.height, : view.width]
    )
    origin, direction = rays.centre_rays(column, row, mi.Float(0.5), mi.Float(0.5))
    active, si, hit = kernel_scene.intersect(mi.Ray3f(origin, direction, 0.0, mi.Spectrum(550.0)))
    point = kernel_scene.surface_point(si, hit, active)
    # Light between the normals of triangle and surface meets the body again: R = p / (1 - l p).
    reflectance = point.reflectance[0]
    content = reflectance / (1.0 + lost_fraction(point.frame, point.triangle) * reflectance)
    values = dr.select(active, content, dr.nan)
    return np.array(values).reshape(view.height, view.width)


@pytest.mark.parametrize("trait", ["chlorophyll", "carotenoids", "water", "ripeness"])
def test_maps_are_the_contents_behind_what_light_sees(scene, frame, trait):
    # Matt bodies whose reflectance is their content, so that the renderer interpolates it as it does spectra.
    largest = 100.0 if trait in ("chlorophyll", "carotenoids") else 1.0
    surfaces, known = {}, set()
    for number, surface in enumerate(scene.surfaces):
        amounts = surface.contents.get(trait, np.zeros(len(surface.states)))
        body = np.tile((amounts / largest)[:, None, None], (1, 2, surface.wavelength_nm.size))
        surfaces[surface.name] = replace(
            surface, reflectance=body, transmittance=0.0 * body[:, 0], ior=1.0, relief_mm=None
        )
        known |= {number} if trait in surface.contents else set()
    clean = tuple(replace(item, residue=0.0) for item in scene.mesh.appearances)
    expected = reflectance_at_centres(
        assemble_scene(replace(scene.mesh, appearances=clean), surfaces), camera()
    )
    # Which surfaces have the trait, by the instance image.
    first_face = np.unique(scene.mesh.face_instance, return_index=True)[1]
    has_trait = np.append(False, np.isin(scene.mesh.face_surface[first_face], list(known)))
    is_known = has_trait[frame["instance"]]
    image = frame[trait].astype(float)
    np.testing.assert_array_equal(np.isfinite(image), is_known)
    assert is_known.sum() > 100
    # In the single precision of the kernel.
    error = np.abs(image[is_known] - largest * expected[is_known])
    assert error.max() < 1e-4 * image[is_known].max()
    assert np.ptp(image[is_known]) > 0.8 * image[is_known].max()


def test_traits_are_where_their_organs_are(frame):
    leaf, fruit = frame["class"] == OrganClass.LEAF, frame["class"] == OrganClass.PEPPER
    np.testing.assert_array_equal(np.isfinite(frame["leaf_age"]), leaf)
    np.testing.assert_array_equal(np.isfinite(frame["water"]), leaf)
    np.testing.assert_array_equal(np.isfinite(frame["ripeness"]), fruit)
    green = ~np.isin(frame["class"], (OrganClass.BACKGROUND, OrganClass.WIRE, OrganClass.CUT))
    np.testing.assert_array_equal(np.isfinite(frame["chlorophyll"]), green)
    np.testing.assert_array_equal(np.isfinite(frame["carotenoids"]), green)


def test_leaf_age_is_the_ageing_of_each_blade(scene, frame):
    leaf = frame["class"] == OrganClass.LEAF
    of_instance = np.zeros(len(scene.mesh.instances))
    ages = np.array([item.ageing for item in scene.mesh.appearances])
    of_instance[scene.mesh.face_instance] = ages[scene.mesh.face_appearance]
    expected = of_instance[frame["instance"][leaf] - 1]
    np.testing.assert_array_equal(frame["leaf_age"][leaf], expected.astype(np.float32))
    # Dry leaves have hardly any chlorophyll, and healthy ones have it.
    dry, healthy = (frame["chlorophyll"][leaf][chosen] for chosen in (expected > 0.99, expected < 0.02))
    assert dry.size == 0 or dry.max() < 1.1
    assert healthy.size == 0 or np.median(healthy) > 25.0


@pytest.mark.parametrize("ageing", [0.0, 0.5])
def test_prospect_with_the_values_of_a_map_is_the_albedo_of_the_leaf(ageing):
    # A flat leaf without gloss, relief and residue, whose state rises from left to right.
    path = leaf_path(ior=1.0)
    ramp = np.linspace(-0.5, 0.5, 64, dtype=np.float32)[None, None]
    surface = replace(leaf_surface("leaf", path, NM), pattern=ramp, is_blade=True)
    sheet = rectangle([0.0, 0.0, 0.5], [0.026, 0.0, 0.0], [0.0, -0.026, 0.0])
    sheet = replace(sheet, appearances=(Appearance(ageing=ageing),))
    image = Renderer(assemble_scene(sheet, {"leaf": surface})).render(VIEW, [*TRAITS, "albedo"])
    assert (image["leaf_age"] == np.float32(ageing)).all()
    # Chlorophyll rises with the state, which then shows what the maps do not.
    states = np.linspace(-1.0, 1.0, 2001)
    chlorophyll = path.at(states)["chlorophyll_ug_cm2"]
    assert (np.diff(chlorophyll) > 0).all()
    row = {name: image[name][4].astype(float) for name in TRAITS}
    contents = path.at(np.interp(row["chlorophyll"], chlorophyll, states)) | {
        "chlorophyll_ug_cm2": row["chlorophyll"],
        "carotenoid_ug_cm2": row["carotenoids"],
        "water_cm": row["water"],
    }
    leaves = leaf_spectra(NM, **contents).reflectance
    expected = np.stack([seen(VIEW, NM, spectrum) for spectrum in leaves])
    # Pixels at the ends show texels of both ends; spectra between two rows err by .002.
    np.testing.assert_allclose(image["albedo"][4, 1:-1].astype(float), expected[1:-1], atol=3e-3)
    assert np.ptp(expected[1:-1, 1]) > 0.02


def test_other_outputs_keep_their_bits_and_no_light_is_traced(scene):
    outputs = [*DEFAULT_OUTPUTS, "albedo"]
    alone = Renderer(scene).render(camera(), outputs, "draft", 5)
    both = Renderer(scene).render(camera(), [*outputs, *TRAITS], "draft", 5)
    assert {name: digests(both)[name] for name in outputs} == digests(alone)
    assert both.metadata == alone.metadata


def test_colours_of_a_scan_have_no_pigments_and_maps_need_surfaces(scene):
    mesh = scene.mesh
    scanned = replace(mesh, colour=np.full((len(mesh.vertices), 3), 0.4, np.float32))
    surfaces = {surface.name: surface for surface in scene.surfaces}
    image = Renderer(assemble_scene(scanned, surfaces)).render(camera(), ["class", "ripeness", "chlorophyll"])
    assert (image["class"] == OrganClass.PEPPER).any()
    assert np.isnan(image["ripeness"]).all()
    assert np.isnan(image["chlorophyll"]).all()
    with pytest.raises(ValueError, match="no surfaces"):
        Renderer(assemble_scene(mesh)).render(camera(), ["ripeness"])
