"""Extreme surfaces: lossless, black, mirrors, fully rough."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, axis_camera, card, point_flash_camera, response_by_hand, sheet
from strain import render, surface

from pepperscene.camera import Camera
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface
from pepperscene.scene import Sky, assemble_scene


def electrons_of_two_leaves(
    *leaf: float, sky: Sky | None = EVEN_SKY, camera: Camera | None = None, quality: str = "standard"
) -> np.ndarray:
    """Electrons of two leaves that light each other; `leaf` as for `surface`."""
    mesh = concatenate_meshes([card(-0.02, 0.0, 0.05, 0.2, "leaf", 0.4), sheet(0.3, 0.3, 0.45, "leaf")])
    scene = assemble_scene(mesh, {"leaf": surface("leaf", *leaf)}, sky)
    return render(scene, camera or axis_camera(16, 12), quality)["electrons"]


@pytest.mark.parametrize(
    "reflectance", [1e-7, *(pytest.param(r, marks=pytest.mark.long) for r in (1e-38, 1e-45))]
)
def test_almost_black_leaves_are_like_black_ones(reflectance):
    # Light is proportional to R at the first hit, and to R squared or less after it.
    options = {"camera": point_flash_camera(), "quality": "standard"}
    result, black, white = (electrons_of_two_leaves(r, sky=None, **options) for r in (reflectance, 0.0, 1.0))
    assert result.max() <= white.max() * reflectance * 1.01 + 1e-30
    assert black.max() == 0.0
    result, expected = (electrons_of_two_leaves(r, r, 1.4, **options) for r in (reflectance, 0.0))
    assert result == pytest.approx(expected, rel=1e-4, abs=1e-3 + 10.0 * reflectance * float(white.max()))


@pytest.mark.parametrize(("roughness", "ior"), [(0.0, 1.5), pytest.param(1e-3, 2.5, marks=pytest.mark.long)])
def test_mirror_shows_the_flash_at_twice_the_distance(roughness, ior):
    # A black body under a smooth cuticle; the flash is a point at the lens. Its image gives the irradiance
    # F I / (2 d)^2, with Fresnel's F = ((n - 1) / (n + 1))^2, and a pixel covers the solid angle 1 / (fx fy).
    # Cuticles smoother than alpha = .001 are rendered as that: 1 / (1 + 27^2) of such a lobe is outside the
    # image. At least 100 samples hit a pixel in the lobe: 1 %.
    camera = point_flash_camera(48, 48)
    mirror = assemble_scene(sheet(0.2, 0.2, 0.5, "leaf"), {"leaf": surface("leaf", 0.0, 0.0, ior, roughness)})
    result = render(mirror, camera, "reference")["electrons"].astype(float).sum((0, 1))
    nm = np.arange(360.0, 831.0, 0.5)
    irradiance = ((ior - 1.0) / (ior + 1.0)) ** 2 * camera.flash.radiant_intensity(nm) / 1.0**2
    electrons = np.trapezoid(response_by_hand("ueye_ui5250re", nm) * irradiance, nm, axis=-1)
    assert result == pytest.approx(electrons * camera.intrinsics[0, 0] * camera.intrinsics[1, 1], rel=0.01)


@pytest.mark.parametrize(
    ("ior", "roughness"),
    [(1.0, 0.0), (1.4, 1.0 - 1e-6), pytest.param(2.5, 1.0 + 1e-6, marks=pytest.mark.long)],
)
def test_roughness_is_continuous_at_one_and_irrelevant_without_gloss(ior, roughness):
    result, expected = (electrons_of_two_leaves(0.3, 0.3, ior, alpha) for alpha in (roughness, 1.0))
    assert result == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("bad", [np.nan, -1e-3])
@pytest.mark.parametrize("field", ["reflectance", "transmittance"])
def test_rejects_invalid_spectra(field, bad):
    values = {"reflectance": np.full((1, 2, 2), 0.4), "transmittance": np.full((1, 2), 0.4)}
    values[field].flat[0] = bad
    with pytest.raises(ValueError, match="must be >= 0 and sum to at most 1"):
        Surface("leaf", RANGE_NM, **values)


@pytest.mark.parametrize(
    ("field", "bad", "message"),
    [
        *(("ior", bad, "ior must be at least 1") for bad in (np.nan, np.inf, 0.9)),
        ("roughness", (np.nan, 0.3), "roughness"),
        ("roughness", (0.3, -0.1), "roughness"),
        ("roughness", (np.inf, 0.3), "roughness"),
        ("pattern", np.array([[[0.0, np.nan]]], np.float32), "pattern"),
        ("relief_mm", np.array([[[0.0, np.inf]]], np.float32), "relief"),
        ("relief_mm", np.array([[0.0, 1.0]], np.float32), "relief_mm must be a stack"),
        ("residue_pattern", np.array([[[0.0, -0.1]]], np.float32), "residue_pattern must not be negative"),
        ("ageing_order", np.array([[[0.0, -0.1]]], np.float32), "ageing_order must not be negative"),
        ("wide_roughness", (0.3, np.nan), "roughness"),
        ("wide_share", 1.1, "wide_share"),
        ("residue_reflectance", np.nan, "residue_reflectance"),
        ("first_state", -0.5, "first_state must be 0 or -1"),
    ],
)
def test_rejects_invalid_surface_parameters(field, bad, message):
    with pytest.raises(ValueError, match=message):
        replace(surface("leaf", 0.4), **{field: bad})
