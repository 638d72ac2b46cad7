"""Surfaces at the ends of what surfaces can be: lossless, black, mirrors, rough all over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import RANGE_NM, bench_camera, card, response_by_hand, sheet
from strain import DAYLIGHT, picture, point_flash_camera, surface

from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface
from pepperscene.scene import assemble_scene


def two_leaves(kind: Surface, sky=None):
    """Two leaves, so that light goes to and fro between them."""
    mesh = concatenate_meshes([card(-0.02, 0.0, 0.05, 0.2, "leaf", 0.4), sheet(0.3, 0.3, 0.45, "leaf")])
    return assemble_scene(mesh, {"leaf": replace(kind, name="leaf")}, sky)


@pytest.mark.parametrize("roughness", [0.0, 1e-9, 0.03, 1.0])
@pytest.mark.parametrize("ior", [1.000001, 2.5])
@pytest.mark.parametrize("transmittance", [0.0, 0.5, 1.0])
def test_a_lossless_leaf_of_any_gloss_vanishes_in_an_even_light(roughness, ior, transmittance):
    # 256 samples on some 600 pixels; weights vary by 1, so that the mean's standard error is .2 % at most.
    leaf = surface("leaf", 1.0 - transmittance, transmittance, ior, roughness)
    scene = assemble_scene(sheet(0.02, 0.02, 0.4, "leaf"), {"leaf": leaf}, DAYLIGHT)
    frame = picture(scene, bench_camera(columns=32, rows=24, flash=False), "reference")
    seen = frame["class"] > 0
    assert 400 < seen.sum() < 700
    light = frame["electrons"] / frame["electrons"][~seen].mean(axis=0)
    assert light[seen].mean(axis=0) == pytest.approx(np.ones(3), abs=0.01)


@pytest.mark.parametrize("transmittance", [0.0, 0.4, 1.0 - 1e-7])
def test_almost_lossless_is_next_to_lossless(transmittance):
    # R + T = 1 - 1e-7: after at most 3 scatterings 3e-7 of the light is missing, and rounding.
    camera = bench_camera(columns=16, rows=12)
    almost = surface("leaf", 1.0 - 1e-7 - transmittance, transmittance, 1.4)
    whole = surface("leaf", 1.0 - transmittance, transmittance, 1.4)
    found, expected = (
        picture(two_leaves(k, DAYLIGHT), camera, "standard")["electrons"] for k in (almost, whole)
    )
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("least", [1e-7, 1e-20, 1e-38, 1e-45, 5e-324])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_almost_black_is_next_to_black(least, quality):
    # Light is proportional to R at the first hit; beyond that there is R squared of it.
    camera = point_flash_camera()
    found = picture(two_leaves(surface("leaf", least)), camera, quality)["electrons"]
    white = picture(two_leaves(surface("leaf", 1.0)), camera, quality)["electrons"]
    assert found.max() <= white.max() * least * 1.01 + 1e-30
    black = picture(two_leaves(surface("leaf", 0.0)), camera, quality)["electrons"]
    assert black.max() == 0.0
    both = surface("leaf", least, least, 1.4), surface("leaf", 0.0, 0.0, 1.4)
    found, expected = (picture(two_leaves(k, DAYLIGHT), camera, quality)["electrons"] for k in both)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-3 + 10.0 * least * float(white.max()))


@pytest.mark.parametrize("roughness", [0.0, 1e-12, 1e-3])
@pytest.mark.parametrize("ior", [1.5, 2.5])
def test_a_mirror_shows_the_lamp_at_twice_the_distance(roughness, ior):
    # A black body under a smooth cuticle, straight ahead; the lamp is a point in the lens' place. What
    # arrives from its image is F I / (2 d)^2, with Fresnel's F = ((n - 1) / (n + 1))^2; a pixel of the solid
    # angle 1 / (fx fy) holds as many electrons as the radiance in it makes. Cuticles smoother than alpha =
    # .001 are taken as that: 1 / (1 + 27^2) of such a lobe lies outside the picture. 100 samples or more hit
    # a pixel in the lobe: 1 %.
    camera = point_flash_camera(columns=48, rows=48)
    mirror = assemble_scene(sheet(0.2, 0.2, 0.5, "leaf"), {"leaf": surface("leaf", 0.0, 0.0, ior, roughness)})
    found = picture(mirror, camera, "reference")["electrons"].astype(float).sum((0, 1))
    nm = np.arange(360.0, 831.0, 0.5)
    arriving = ((ior - 1.0) / (ior + 1.0)) ** 2 * camera.flash.radiant_intensity(nm) / 1.0**2
    electrons = np.trapezoid(response_by_hand("ueye_ui5250re", nm) * arriving, nm, axis=-1)
    assert found == pytest.approx(electrons * camera.intrinsics[0, 0] * camera.intrinsics[1, 1], rel=0.01)


@pytest.mark.parametrize("ior", [1.0, 1.4, 2.5])
def test_roughness_goes_through_one_without_a_step(ior):
    camera = bench_camera(columns=16, rows=12)
    below, at, above = (
        picture(two_leaves(surface("leaf", 0.3, 0.3, ior, alpha), DAYLIGHT), camera, "standard")["electrons"]
        for alpha in (1.0 - 1e-6, 1.0, 1.0 + 1e-6)
    )
    assert below == pytest.approx(at, rel=1e-4)
    assert above == pytest.approx(at, rel=1e-4)


def test_without_gloss_roughness_does_not_matter():
    camera = bench_camera(columns=16, rows=12)
    first, second = (
        picture(two_leaves(surface("leaf", 0.3, 0.3, 1.0, alpha), DAYLIGHT), camera, "standard")["electrons"]
        for alpha in (0.0, 1.0)
    )
    assert first == pytest.approx(second, rel=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1e-3])
@pytest.mark.parametrize("field", ["reflectance", "transmittance"])
def test_spectra_of_no_numbers_are_refused(field, bad):
    values = {"reflectance": np.full((1, 2, 2), 0.4), "transmittance": np.full((1, 2), 0.4)}
    values[field].flat[0] = bad
    with pytest.raises(ValueError, match="must be >= 0 and sum to at most 1"):
        Surface("leaf", RANGE_NM, **values)


@pytest.mark.parametrize(
    ("field", "bad", "told"),
    [
        ("ior", np.nan, "index"),
        ("ior", np.inf, "index"),
        ("ior", 0.9, "index"),
        ("roughness", (np.nan, 0.3), "roughness"),
        ("roughness", (0.3, -0.1), "roughness"),
        ("roughness", (np.inf, 0.3), "roughness"),
        ("pattern", np.array([[0.0, np.nan]], np.float32), "pattern"),
        ("relief_mm", np.array([[0.0, np.inf]], np.float32), "relief"),
    ],
)
def test_surfaces_of_no_numbers_are_refused(field, bad, told):
    with pytest.raises(ValueError, match=told):
        replace(surface("leaf", 0.4), **{field: bad})
