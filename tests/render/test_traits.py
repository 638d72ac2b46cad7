"""Maps of chlorophyll, carotenoids, water, ripeness and leaf age, against the surfaces that light sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera
from greenhouse import camera, digests, greenhouse, row_of_plants, short_plant
from scipy.ndimage import map_coordinates
from test_albedo import NM, VIEW, leaf_path, seen

from pepperscene.camera import look_at
from pepperscene.classes import Appearance, OrganClass
from pepperscene.geometry import mesh_plant, rectangle
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
VIEWPOINTS = trimesh.creation.icosphere(subdivisions=1).vertices
"""`(42, 3)` unit vectors, evenly over all directions."""


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


def points_on(mesh, count=40_000):
    """`(n, 2)` uv and `(n,)` states of points that are even over the area of a mesh."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, face = trimesh.sample.sample_surface(solid, count, seed=8)
    weights = trimesh.triangles.points_to_barycentric(solid.triangles[face], points)
    corners = mesh.faces[face]
    return (
        np.einsum("nk,nkd->nd", weights, mesh.uv[corners].astype(float)),
        np.einsum("nk,nk->n", weights, mesh.state[corners].astype(float)),
    )


def mean_over_organ(mesh, surface, path, trait):
    """Mean of a content over the area of an isolated organ: no code of the renderer."""
    uv, state = points_on(mesh)
    (appearance,) = mesh.appearances
    number, mirrored = (
        appearance.variant % len(surface.pattern),
        appearance.variant // len(surface.pattern) % 2,
    )

    def texture(images):
        height, width = images.shape[1:]
        u = 1.0 - uv[:, 0] if mirrored else uv[:, 0]
        at = np.stack([np.clip(uv[:, 1] * height - 0.5, 0, height - 1), u * width - 0.5])
        return map_coordinates(images[number].astype(float), at, order=1, mode="grid-wrap")

    state = np.clip(state + texture(surface.pattern), 0.0, 1.0)
    if surface.ageing_order is not None:
        aged = np.clip((appearance.ageing - texture(surface.ageing_order)) / 0.25, 0.0, 1.0)
        state -= aged * (1.0 + state)
    contents = path.at(state)
    return {
        "chlorophyll": contents["chlorophyll_ug_cm2"],
        "carotenoids": contents["carotenoid_ug_cm2"] + contents["capsanthin_ug_cm2"],
        "water": contents["water_cm"],
        "ripeness": state,
    }[trait].mean()


def seen_mean(mesh, surfaces, trait):
    """Mean of a map over all directions, weighted by the area across the view.

    By Cauchy's theorem, a convex body or a flat sheet shows each part of its area equally, on average.
    """
    low, high = mesh.bounds.astype(float)
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    view, renderer = axis_camera(64, 64), Renderer(assemble_scene(mesh, surfaces))
    sensor = replace(view.sensor, pitch_m=view.lens.focal_length_m * 1.1 / 20.0 / 64.0 / view.sensor.binning)
    total = area = 0.0
    for direction in VIEWPOINTS:
        pose = look_at(centre + 20.0 * size * direction, centre, up=np.roll(direction, 1))
        image = renderer.render(replace(view, sensor=sensor, pose=pose), [trait])[trait].astype(float)
        assert np.isnan(image[[0, -1]]).all()
        total, area = total + np.nansum(image), area + np.isfinite(image).sum()
    return total / area


@pytest.mark.parametrize(
    ("kind", "trait", "tolerance"),
    [
        ("lamina", "chlorophyll", 0.01), ("lamina", "water", 0.01),
        ("fruit", "chlorophyll", 0.02), ("fruit", "carotenoids", 0.01), ("fruit", "ripeness", 0.01),
    ],
)  # fmt: skip
def test_maps_integrate_to_the_value_of_the_organ(kaite, organs, kind, trait, tolerance):
    mesh, surfaces = organs[kind]
    (name,) = mesh.surfaces
    expected = mean_over_organ(mesh, surfaces[name], kaite.pigments[name], trait)
    assert seen_mean(mesh, surfaces, trait) == pytest.approx(expected, rel=tolerance)


@pytest.fixture(scope="module")
def organs(scene):
    """A blade that has begun to age, and a fruit that turns, each alone: mesh and surfaces."""
    plant = short_plant(12, 3)
    half_ripe = (replace(organ, measures={**organ.measures, "ripeness": 0.5}) for organ in plant.organs)
    plant = replace(plant, organs=tuple(half_ripe))
    mesh = mesh_plant(plant, 0.6)
    surfaces = {surface.name: surface for surface in scene.surfaces}
    found = {}
    for kind in ("lamina", "fruit"):
        number = next(index for index, organ in enumerate(plant.organs) if organ.kind == kind)
        alone = mesh.select_instances([number])
        aged = tuple(replace(item, ageing=0.3) for item in alone.appearances)
        found[kind] = replace(alone, appearances=aged), surfaces
    return found


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


def test_they_need_surfaces():
    with pytest.raises(ValueError, match="no surfaces"):
        Renderer(assemble_scene(row_of_plants())).render(camera(), ["ripeness"])


def test_colours_of_a_scan_have_no_pigments(organs):
    mesh, surfaces = organs["fruit"]
    scanned = replace(mesh, colour=np.full((len(mesh.vertices), 3), 0.4, np.float32))
    centre = scanned.bounds.mean(axis=0).astype(float)
    view = axis_camera(16, 12).at_pose(look_at(centre - np.array([0.0, 0.4, 0.0]), centre))
    image = Renderer(assemble_scene(scanned, surfaces)).render(view, ["class", "ripeness", "chlorophyll"])
    assert (image["class"] == OrganClass.PEPPER).any()
    assert np.isnan(image["ripeness"]).all()
    assert np.isnan(image["chlorophyll"]).all()
