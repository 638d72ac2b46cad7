"""Maps of chlorophyll, carotenoids, water, ripeness and leaf age, against the surfaces that light sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, digests, greenhouse
from test_albedo import NM, VIEW, leaf_path, seen

from pepperscene.classes import Appearance, OrganClass
from pepperscene.geometry import rectangle
from pepperscene.materials.leaf import leaf_surface
from pepperscene.outputs import DEFAULT_OUTPUTS, TRAIT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.kernel.camera import camera_rays
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene
from pepperscene.spectra import leaf_spectra

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
    values = dr.select(active, point.reflectance[0], dr.nan)
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
