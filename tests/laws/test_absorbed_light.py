"""Absorbed light: closed forms of leaves and canopies, conservation, and Mitsuba's own path tracer."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bodies import RANGE_NM, axis_camera, body, card, sphere
from random_leaves import leaf_corners

from pepperscene.camera import Lamp, aimed_axes
from pepperscene.camera.lamps.beam import lambertian_beam
from pepperscene.camera.lamps.lamp import EmitterShape, ring
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.materials import Surface
from pepperscene.render.absorbed import AbsorbedLight, LightTracer, absorbed_light
from pepperscene.render.reference.path_tracer import path_scene
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum

RADIANCE, BEAM = 0.3, 1.0  # W m-2 nm-1, of the sky per sr
PAR_NM = 300.0
NM_PER_UMOL = 8.359347e-3  # umol per joule and nm: 1e-9 / (h c N_A) 1e6 (SI 2019)


def daylight(towards=(0.6, 0.0, 0.8), radiance=RADIANCE, beam=BEAM) -> Sky:
    """A sky of equal radiance in all directions of the sphere, and the sun."""
    sun = Sun(np.asarray(towards, float), Spectrum(RANGE_NM, np.full(2, beam))) if beam else None
    return Sky(np.ones((1, 2, 4), np.float32), Spectrum(RANGE_NM, np.full((1, 2), radiance)), sun)


def grey(name: str, reflectance: float, transmittance: float = 0.0, **gloss) -> Surface:
    """A surface of one reflectance and transmittance."""
    return Surface(name, RANGE_NM, np.full((1, 2, 2), reflectance), np.full((1, 2), transmittance), **gloss)


def watts(light: AbsorbedLight) -> tuple[np.ndarray, np.ndarray]:
    return light.amounts.watts[0], light.amounts.watts_error[0]


def test_single_leaf_is_the_closed_form():
    scene = assemble_scene(card(0, 0, 0.2, 0.3, "leaf"), {"leaf": grey("leaf", 0.2, 0.3)}, daylight())
    expected = 0.06 * (2.0 * np.pi * RADIANCE + 0.8 * BEAM)
    bands = ["par", "red=655-665", "nir=700-1000"]
    absorbed = absorbed_light(scene, bands, target_error=0.005).amounts
    received = absorbed_light(scene, bands, target_error=0.005, measured="received").amounts
    widths = np.array([PAR_NM, 10.0, 300.0])
    for amounts, share in ((absorbed, 0.5), (received, 1.0)):
        z = (amounts.watts[:, 0] - share * expected * widths) / amounts.watts_error[:, 0]
        assert np.abs(z).max() < 3.5
        assert amounts.watts[:, 0] == pytest.approx(share * expected * widths, rel=0.01)
    # Photons of equal power at all wavelengths are those of the mean wavelength.
    photons = absorbed.watts[:, 0] * np.array([550.0, 660.0, 850.0]) * NM_PER_UMOL
    assert absorbed.umol_s[:, 0] == pytest.approx(photons, rel=0.005)


def test_sphere_is_the_closed_form():
    scene = assemble_scene(sphere((0, 0, 0), 0.5, "skin"), {"skin": grey("skin", 0.3)}, daylight())
    power, error = watts(absorbed_light(scene, target_error=0.008))
    expected = 0.7 * PAR_NM * np.pi * 0.25 * (4.0 * np.pi * RADIANCE + BEAM)
    assert abs(power[0] - expected) < 3.5 * error[0]
    assert power[0] == pytest.approx(expected, rel=0.02)


NARROW = Spectrum(np.array([300.0, 590.0, 600.0, 610.0, 1100.0]), np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
BROAD = Spectrum(RANGE_NM, np.ones(2))


def lamp(shape, spectrum: Spectrum, flux: float, x: float, **changes) -> Lamp:
    """A lamp 40 cm above the card of the closed form, aimed at its middle."""
    position = np.array([x, 0.1, 0.9])
    axes = aimed_axes(np.array([0.0, 0.0, 0.5]) - position, 0.0)
    return Lamp("lamp", spectrum, flux, lambertian_beam(), shape, position, axes, **changes)


def test_leaf_under_lamps_is_the_closed_form():
    panel = lamp(EmitterShape(3, 2, (0.05, 0.05), (0.03, 0.04)), NARROW, 20.0, -0.2)
    ring_lamp = lamp(ring(0.1, 0.05), BROAD, 100.0, 0.3)
    flashed = lamp(ring(0.1), BROAD, 1e4, 0.0, pulse_s=1e-3)
    centres = (np.stack(np.meshgrid(*[(np.arange(24) + 0.5) / 24 - 0.5] * 2), axis=-1) * (0.2, 0.3)).reshape(
        -1, 2
    )
    points, up = np.pad(centres, ((0, 0), (0, 1)), constant_values=0.5), np.tile([0.0, 0.0, 1.0], (576, 1))
    # The narrow lamp has all its light in PAR, the other one 3/8.
    factors = [one.flux_W * one.irradiance_factor(points, up).mean() for one in (panel, ring_lamp)]
    received = 0.06 * (factors[0] + 0.375 * factors[1])
    mesh, surfaces = card(0, 0, 0.2, 0.3, "leaf"), {"leaf": grey("leaf", 0.2, 0.3)}
    scene = assemble_scene(mesh, surfaces, lamps=[panel, ring_lamp, flashed])
    for measured, share in (("absorbed", 0.5), ("received", 1.0)):
        power, error = watts(absorbed_light(scene, target_error=0.003, measured=measured))
        assert abs(power[0] - share * received) < 3.5 * error[0]
        assert error[0] < 0.004 * power[0]
    photons = absorbed_light(scene, target_error=0.003, measured="received").amounts.umol_s[0, 0]
    expected = 0.06 * NM_PER_UMOL * (600.0 * factors[0] + 550.0 * 0.375 * factors[1])
    assert photons == pytest.approx(expected, rel=0.01)
    # A flash alone is no light.
    assert watts(absorbed_light(assemble_scene(mesh, surfaces, lamps=[flashed])))[0] == 0.0


def test_lossless_surfaces_absorb_nothing():
    lossless = grey("leaf", 0.6, 0.4, ior=1.45, roughness=(0.2, 0.5))
    light = absorbed_light(assemble_scene(card(0, 0, 0.2, 0.3, "leaf"), {"leaf": lossless}, daylight()))
    received = 0.06 * PAR_NM * (2.0 * np.pi * RADIANCE + 0.8 * BEAM)
    assert abs(watts(light)[0][0]) < 1e-5 * received


def leaves(count: int, size_m: float, rng, low, high, *, horizontal: bool) -> list[Mesh]:
    """Square leaves with centres in a box, of all orientations alike or level."""
    vertices = leaf_corners(rng.uniform(low, high, (count, 3)), size_m, rng, level=horizontal)
    return [trimesh.Trimesh(part, [[0, 1, 2], [0, 2, 3]], process=False) for part in vertices]


def canopy(leaf: Surface, leaf_area_index: float, sky: Sky, *, horizontal: bool):
    """A black floor below random leaves; instance 0 is a patch of the floor in the middle."""
    half, size = 5.0, 0.06
    rng = np.random.default_rng(8)
    count = int(leaf_area_index * (2.0 * half) ** 2 / size**2)
    parts = leaves(count, size, rng, [-half, -half, 0.1], [half, half, 0.7], horizontal=horizontal)
    crown = body(trimesh.util.concatenate(parts), "leaf")
    mesh = concatenate_meshes([card(0, 0, 4.0, 4.0, "floor", 0.0), crown])
    # The floor's lower side must see nothing.
    below = card(0, 0, 40.0, 40.0, "floor", -0.001)
    mesh = concatenate_meshes([mesh, below])
    return assemble_scene(mesh, {"floor": grey("floor", 0.0), "leaf": leaf}, sky)


@pytest.mark.parametrize("horizontal", [True, False])
def test_black_leaves_follow_beer_and_lambert(horizontal):
    leaf_area_index, cosine = 1.5, 0.8
    sky = daylight(radiance=0.0)
    scene = canopy(grey("leaf", 0.0), leaf_area_index, sky, horizontal=horizontal)
    power, error = watts(absorbed_light(scene, target_error=0.015))
    projection = cosine if horizontal else 0.5
    expected = 16.0 * PAR_NM * cosine * np.exp(-projection * leaf_area_index / cosine)
    # With 1,000 times the area of a leaf, the patch's own light differs by 1 % from row to row of chance.
    assert power[0] == pytest.approx(expected, abs=max(0.03 * expected, 2.0 * error[0]))
    assert error[0] < 0.035 * power[0]


def test_grey_level_leaves_follow_two_streams():
    leaf_area_index, r, t = 1.5, 0.3, 0.4
    scene = canopy(grey("leaf", r, t), leaf_area_index, daylight(), horizontal=True)
    power, error = watts(absorbed_light(scene, target_error=0.01))
    k = np.sqrt((1.0 - t) ** 2 - r**2)
    passing = k / (k * np.cosh(k * leaf_area_index) + (1.0 - t) * np.sinh(k * leaf_area_index))
    expected = 16.0 * PAR_NM * (np.pi * RADIANCE + 0.8 * BEAM) * passing
    assert power[0] == pytest.approx(expected, abs=max(0.02 * expected, 2.0 * error[0]))
    assert error[0] < 0.02 * expected


def chamber():
    """Grey leaves, and the six walls of a box with edges of 1 m, in this order.

    The walls let half pass, and absorb the rest of what arrives from inside. Outside, nothing absorbs light.
    """
    rng = np.random.default_rng(3)
    parts = leaves(12, 0.4, rng, [-0.25, -0.25, 0.25], [0.25, 0.25, 0.75], horizontal=False)
    parts = [body(part, "leaf") for part in parts]
    box = trimesh.creation.box((1.0, 1.0, 1.0), trimesh.transformations.translation_matrix([0.0, 0.0, 0.5]))
    parts += [body(box.submesh([side], append=True), "wall") for side in box.facets]
    both = np.repeat(np.array([0.5, 0.0])[None, :, None], 2, axis=2)
    wall = Surface("wall", RANGE_NM, both, np.full((1, 2), 0.5))
    return assemble_scene(
        concatenate_meshes(parts), {"leaf": grey("leaf", 0.3, 0.4), "wall": wall}, daylight(beam=0.3)
    )


@pytest.mark.parametrize("seeds", [2, pytest.param(16, marks=pytest.mark.long)])
def test_energy_in_is_absorbed_and_left(seeds):
    tracer, parts = LightTracer(chamber()), []
    for seed in range(seeds):
        replicates = tracer.trace(target_error=0.005, seed=seed).replicates[0, 0]
        absorbed, walls = replicates[:, :-6].sum(axis=1), replicates[:, -6:].sum(axis=1)
        # As much leaves through the walls as they absorb.
        parts.append([absorbed, walls, walls])
    entered = 0.5 * PAR_NM * (6.0 * np.pi * RADIANCE + (0.6 + 0.8) * 0.3)
    shares = np.concatenate(parts, axis=1) / entered
    total = shares.sum(axis=0)
    error = total.std(ddof=1) / np.sqrt(total.size)
    # .29 % of two seeds, .08 % of sixteen.
    assert error < 0.0042 / np.sqrt(seeds)
    assert abs(total.mean() - 1.0) < min(0.005, 3.5 * error)
    # Not the walls alone decide.
    assert shares[0].mean() > 0.1


def fifty_leaves(rng, r: float, t: float):
    """Leaves that shade each other, and their triangles."""
    parts = leaves(50, 0.12, rng, [-0.25] * 3, [0.25] * 3, horizontal=False)
    mesh = concatenate_meshes([body(part, "leaf") for part in parts])
    return assemble_scene(mesh, {"leaf": grey("leaf", r, t)}, daylight()), parts


@pytest.mark.parametrize("target_error", [0.05, 0.015])
def test_errors_are_those_of_repeated_runs(target_error):
    count = 16
    tracer = LightTracer(fifty_leaves(np.random.default_rng(5), 0.4, 0.35)[0])
    runs = [watts(tracer.trace(target_error=target_error, seed=seed)) for seed in range(count)]
    power, error = np.moveaxis(np.array(runs), 1, 0)
    assert np.median(error / power) < target_error
    z = (power - power.mean(axis=0)) / error * np.sqrt(count / (count - 1.0))
    # By 32 replicates, these follow Student's distribution, whose standard deviation is 1.03.
    assert 0.95 < z.std() < 1.1
    # Chance that makes an organ dark must not make its error small.
    assert np.square(error).mean() == pytest.approx(power.var(axis=0, ddof=1).mean(), rel=0.15)


def test_organs_agree_with_the_path_tracer_of_mitsuba():
    # A matt leaf sends pi (L_front + L_back) = (R + T) (E_front + E_back); Mitsuba traces both radiances.
    rng, r, t = np.random.default_rng(5), 0.4, 0.35
    scene, parts = fifty_leaves(rng, r, t)
    light = absorbed_light(scene, target_error=0.01, measured="received")
    density = light.amounts.watts[0] / light.area_m2 / PAR_NM
    error = light.amounts.watts_error[0] / light.area_m2 / PAR_NM

    mi, _ = mitsuba_modules()
    groups, count = 32, 256
    samples = groups * count
    place = rng.uniform(0.0, 1.0, (2, 50, samples))
    corners = np.stack([part.vertices for part in parts]).astype(np.float32)
    origin, u, v = corners[:, :1], corners[:, 1:2] - corners[:, :1], corners[:, 3:] - corners[:, :1]
    points = origin + place[0][..., None] * u + place[1][..., None] * v
    normals = np.stack([part.face_normals[0] for part in parts])[:, None] + 0.0 * points
    both = [points + side * 1e-3 * normals for side in (1.0, -1.0)]
    starts = np.concatenate(both).reshape(-1, 3).astype(np.float32)
    towards = np.concatenate([-normals, normals]).reshape(-1, 3).astype(np.float32)
    reference = path_scene(scene, axis_camera(16, 12, flash=None))
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(1, len(starts))
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(starts.T), mi.Vector3f(towards.T)))
    ray.wavelengths = mi.Spectrum(550.0)
    integrator = mi.load_dict({"type": "path", "max_depth": 64})
    radiance, _, _ = integrator.sample(reference.scene, sampler, ray)
    values = np.array(radiance[0]).reshape(2, 50, groups, count).sum(axis=0).mean(axis=-1) * np.pi / (r + t)
    expected, spread = values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(groups)

    z = (density - expected) / np.hypot(error, spread)
    assert np.median(np.hypot(error, spread) / expected) < 0.012
    # 50 tests together have a significance of 1e-3 (Bonferroni).
    assert np.abs(z).max() < 4.27
    assert abs(z.mean()) < 3.0 / np.sqrt(50.0)
    assert 0.75 < z.std() < 1.3
