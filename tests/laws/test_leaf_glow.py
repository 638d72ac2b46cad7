"""A backlit leaf has the colour of its transmittance.

A flat blade across the optical axis at 50 cm, the sun's disc directly behind it or behind the camera,
everything else dark. By hand: its radiance is E A_s A_o T min(a_s, a_o) / (a_s a_o pi), where A is the
fraction of light along the normal that enters a side's rough cuticle and a its cosine-weighted mean, both
integrals over the gloss lobes without colour. The sampling error of the mean is .25 %: the colour must be
within 1 %, the level within 2 %.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import SENSORS, axis_camera, columns_of, irradiance_by_hand, matt, response_by_hand, sheet

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import organ_surfaces
from pepperscene.render import render_scene
from pepperscene.scene import Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 1000.1, 0.5)  # infrared that the sensor's filter leaks is .3 % of a blue pixel here
LUX = 50_000.0
SUN = columns_of("light/astm_g173_300_1100")["direct_W_m2_nm"]
BEHIND, OVER_SHOULDER = (0.0, 0.0, 1.0), (0.0, np.sqrt(0.5), -np.sqrt(0.5))
HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about the vertical


@pytest.fixture(scope="module")
def blade():
    """The leaf surface without textures, and one of its patterns."""
    leaf = organ_surfaces(load_cultivar("kaite"), NM)["leaf"]
    plain = replace(leaf, pattern=None, relief_mm=None, residue_pattern=None, ageing_order=None)
    return plain, leaf.pattern[:1]


def sun_alone(direction):
    """A black sky with the sun's disc."""
    nm, values = SUN
    disc = Sun(np.array(direction), Spectrum(nm, irradiance_by_hand(SUN, LUX, nm)))
    return Sky(np.zeros((1, 2, 4), np.float32), Spectrum(nm, values[None] / values.mean()), disc)


def photograph(surface, direction, sensor, *, back=False, side=8, mesh=None):
    """`(side, side, 3)` electrons of a sheet of this surface, seen from the front or the back."""
    mesh = sheet(2.0, 2.0, 0.0, surface.name) if mesh is None else mesh
    mesh = mesh.moved(HALF_TURN if back else np.eye(3), np.array([0.0, 0.0, 0.5]))
    camera = axis_camera(side, side, sensor=sensor, flash=None)
    scene = assemble_scene(mesh, {surface.name: surface}, sun_alone(direction))
    return render_scene(scene, camera, ["electrons"], "reference", seed=5)["electrons"].astype(float)


def electrons_by_hand(radiance, sensor):
    return np.trapezoid(radiance * response_by_hand(sensor, NM), NM)


def gloss_albedo(cosine, ior, alpha, steps=200):
    """Fraction of light that a rough dielectric reflects: Walter et al. 2007, by the midpoint rule."""
    z, phi = np.meshgrid((np.arange(steps) + 0.5) / steps, (np.arange(steps) + 0.5) / steps * 2 * np.pi)
    o = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z])
    i = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    h = o + i[:, None, None]
    h /= np.linalg.norm(h, axis=0)
    c = np.tensordot(i, h, 1)
    normals = alpha**2 / (np.pi * (h[2] ** 2 * (alpha**2 - 1) + 1) ** 2)
    g = np.sqrt(ior**2 - 1 + c**2)
    fresnel = ((g - c) / (g + c)) ** 2 / 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)

    def unmasked(x):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / x**2 - 1)))

    return 2 * np.pi * np.mean(normals * fresnel * unmasked(z) * unmasked(cosine)) / (4 * cosine)


@cache
def cuticle_transmittance(ior, alpha):
    """Fraction of light along the normal that reaches the body, and its cosine-weighted mean."""
    node, weight = np.polynomial.legendre.leggauss(12)
    cosine = (node + 1) / 2
    albedo = np.array([gloss_albedo(x, ior, alpha) for x in cosine])
    return 1 - gloss_albedo(1.0, ior, alpha), 1 - np.sum(weight * albedo * cosine)


def side_transmittance(blade, side):
    """As `cuticle_transmittance`, for the two lobes of a side on their shares of the area."""
    lobes = (1 - blade.wide_share, blade.roughness[side]), (blade.wide_share, blade.wide_roughness[side])
    return sum(share * np.array(cuticle_transmittance(blade.ior, alpha)) for share, alpha in lobes)


def front_by_hand(blade, cosine, body):
    """Reflectance factor along the normal of the front lit from a direction, with that of the body inside."""
    factor, entering = 0.0, 0.0
    lobes = (1 - blade.wide_share, blade.roughness[0]), (blade.wide_share, blade.wide_roughness[0])
    half = np.cos(np.arccos(cosine) / 2)  # of the half vector to the normal, and to both directions
    g = np.sqrt(blade.ior**2 - 1 + half**2)
    minus, plus = g - half, g + half
    fresnel = (minus / plus) ** 2 / 2 * (1 + ((half * plus - 1) / (half * minus + 1)) ** 2)
    for share, alpha in lobes:
        normals = alpha**2 / (np.pi * (half**2 * (alpha**2 - 1) + 1) ** 2)
        unmasked = 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))
        factor += share * np.pi * normals * fresnel * unmasked / (4 * cosine)
        entering += share * (1 - gloss_albedo(cosine, blade.ior, alpha))
    along_normal, mean = side_transmittance(blade, 0)
    return factor + entering * along_normal / mean * body


def glow_by_hand(blade, transmittance):
    """`(n,)` radiance of the backlit blade along its normal."""
    (a, mean_a), (b, mean_b) = (side_transmittance(blade, side) for side in (0, 1))
    through = transmittance * a * b * min(mean_a, mean_b) / (mean_a * mean_b)
    return irradiance_by_hand(SUN, LUX, NM) * through / np.pi


@pytest.mark.parametrize(("sensor", "back"), [(SENSORS[0], False), (SENSORS[1], True)])
def test_backlit_leaf_has_the_colour_and_level_of_its_transmittance(blade, sensor, back):
    surface, _ = blade
    pixels = photograph(surface, BEHIND, sensor, back=back).reshape(-1, 3)
    assert (pixels.std(0) / pixels.mean(0)).max() < 0.02
    mean = pixels.mean(0)
    rows = surface.transmittance.shape[0]
    middle = surface.transmittance[3 * (rows - 1) // 4]  # the sheet's state is .5, and the first row's is -1
    sunlight = irradiance_by_hand(SUN, LUX, NM)
    colour = electrons_by_hand(middle * sunlight, sensor)
    assert mean / mean[1] == pytest.approx(colour / colour[1], rel=0.01)
    assert mean == pytest.approx(electrons_by_hand(glow_by_hand(surface, middle), sensor), rel=0.02)


def test_patterned_leaf_transmits_the_mean_of_its_transmittances(blade):
    # The whole blade in the image with its pattern of pigments: light is averaged, not pigments.
    surface, pattern = blade
    side = 48
    width = side * 9e-6 / 4.16e-3 * 0.5
    mesh = sheet(width, width, 0.0, surface.name)
    mesh = replace(mesh, uv=(mesh.vertices[:, :2] / width + 0.5).astype(np.float32))
    image = photograph(replace(surface, pattern=pattern), BEHIND, "ueye_ui5250re", side=side, mesh=mesh)
    rows = surface.transmittance.shape[0]
    # The rows' states go from -1, for dry tissue, to 1.
    state = (0.5 * (1.0 + np.clip(0.5 + pattern.astype(float), 0.0, 1.0)) * (rows - 1)).ravel()
    row, fraction = np.floor(state).astype(int), state % 1
    weight = np.bincount(row, 1 - fraction, rows + 1) + np.bincount(row + 1, fraction, rows + 1)
    mean = weight[:rows] / state.size @ surface.transmittance
    expected = electrons_by_hand(glow_by_hand(surface, mean), "ueye_ui5250re")
    level = image.mean((0, 1))
    assert level / level[1] == pytest.approx(expected / expected[1], rel=0.01)
    assert level == pytest.approx(expected, rel=0.02)
    # The veins are visible.
    assert image[..., 1].std() > 0.05 * level[1]


def test_backlit_leaf_is_greener_and_yellower_than_a_front_lit_one(blade):
    (surface, _), sensor = blade, SENSORS[0]
    white = electrons_by_hand(irradiance_by_hand(SUN, LUX, NM) / np.pi, sensor)
    backlit = photograph(surface, BEHIND, sensor).mean((0, 1)) / white
    lit = photograph(surface, OVER_SHOULDER, sensor).mean((0, 1)) / (white * np.sqrt(0.5))
    front = surface.reflectance[3 * (surface.reflectance.shape[0] - 1) // 4, 0]
    sunlight = irradiance_by_hand(SUN, LUX, NM) / np.pi
    body = electrons_by_hand(front * sunlight, sensor) / white
    assert lit == pytest.approx(front_by_hand(surface, np.sqrt(0.5), body), rel=0.02)
    # Channels relative to a white diffuser: transmission removes blue, and leaves more green than red.
    assert backlit[1] / backlit[2] > 1.75 * lit[1] / lit[2]
    assert backlit[0] / backlit[2] > 1.5 * lit[0] / lit[2]
    assert backlit[1] > backlit[0] > backlit[2]


def test_opaque_sheet_transmits_nothing():
    image = photograph(matt("card", NM, np.full(NM.size, 0.9)), BEHIND, "ueye_ui5250re")
    assert image.max() < 1e-3
