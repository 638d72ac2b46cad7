"""The outline of a coarse mesh is as bright as that of the smooth body.

The last triangles before an outline are visible while their interpolated normals face away: without
correction, or filtered together with the empty background, they draw a dark line around every fruit.
"""

import math

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, axis_camera, sphere
from scipy.ndimage import distance_transform_edt

from pepperscene.camera import look_at
from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import Organ, Plant
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render import Renderer
from pepperscene.render.surface.normals import shading_normals
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene


def photograph(mesh, surfaces, quality="reference", seed=0, pose=None, side=72):
    """`(h, w)` brightness relative to the sky, and each pixel's distance to the outline, 0 outside."""
    camera = axis_camera(side, side, flash=False)
    camera = camera if pose is None else camera.at_pose(pose)
    scene = assemble_scene(mesh, surfaces, EVEN_SKY)
    frame = Renderer(scene).render(camera, ["electrons", "class"], quality, seed)
    covered = frame["class"] > 0
    light = frame["electrons"].astype(float)
    sky = light[distance_transform_edt(~covered) > 3.0].mean(axis=0)
    return (light / sky).mean(axis=-1), distance_transform_edt(covered)


def white(name: str, ior: float, alpha: float) -> Surface:
    return Surface(name, RANGE_NM, np.ones((1, 2, 2)), np.zeros((1, 2)), ior, (alpha, alpha))


@pytest.mark.parametrize(
    ("ior", "roughness", "least", "rim"), [(1.0, 0.3, 0.92, 0.99), (1.5, 0.05, 0.75, 0.94)]
)
def test_coarse_lossless_ball_has_no_dark_rim_in_a_uniform_sky(ior, roughness, least, rim):
    # 80 triangles, whose normals are up to 20 degrees off: without correction, the darkest pixels fall to .65
    # and the outermost to .90 to .95. Of a mirror image at the rim, up to half is still lost on the wrong
    # side of a triangle.
    ball = sphere((0.0, 0.0, 0.5), 0.03, "white", subdivisions=1)
    light, depth = photograph(ball, {"white": white("white", ior, roughness)})
    assert light[depth > 0].min() > least
    assert light[(depth > 0) & (depth < 1.5)].mean() > rim
    assert light[depth > 0].mean() == pytest.approx(1.0, abs=0.01)


def fruit(detail: float):
    """A blocky fruit of 8 cm with its calyx and stalk."""
    down, up = np.array([0.0, 0.1, -1.0]) / np.hypot(0.1, 1.0), np.array([1.0, 0.0, 0.0])
    top = np.array([0.0, 0.0, 0.04])
    stalk = top - 0.004 * down + np.linspace(1.0, 0.0, 7)[:, None] * np.array([0.02, 0.0, 0.03])
    shape = {"length_m": 0.085, "diameter_m": 0.08, "seed": 0.31, "lobes": 4, "ripeness": 1.0}
    shape |= {"lobe_depth": 0.9, "shoulder": 0.55, "taper": 0.83, "ripeness_spread": 0.0}
    organs = (
        Organ("peduncle", -1, 0, stalk, up, {"radius_m": 0.0034, "radius_tip_m": 0.0042, "seed": 0.3}),
        Organ("calyx", 0, 0, np.stack([stalk[-1], top]), up, {"radius_m": 0.02, "seed": 0.3, "tooth": 0.3}),
        Organ("fruit", 1, 0, np.stack([top, top + 0.085 * down]), up, shape),
    )
    return mesh_plant(Plant("fruit", organs, DEFAULT_KINDS), detail)


@pytest.mark.long
@pytest.mark.parametrize("ior", [pytest.param(1.0, marks=pytest.mark.long), 1.3])
def test_coarse_white_fruit_has_the_outline_of_a_fine_one(ior):
    # From 15 cm, in a uniform sky, everything white so that lost light is visible. Without correction, the
    # outermost pixels of the coarse fruit are 2 % darker than the fine one's, their darkest fortieth 7 to 8
    # %; with it both agree within 1 %.
    surfaces = {name: white(name, ior, 0.25) for name in ("fruit", "calyx", "peduncle")}
    pose = look_at((0.0, -0.15, 0.03), (0.03, 0.0, 0.0))
    rims = []
    for detail in (1.0, 4.0):
        light, depth = photograph(fruit(detail), surfaces, pose=pose, side=96)
        rim = (depth > 0) & (depth < 1.2)
        rims.append((light[rim].mean(), np.quantile(light[rim], 0.025)))
    assert rims[0] == pytest.approx(rims[1], rel=0.015)


def corrected(g: np.ndarray, n: np.ndarray, v: np.ndarray):
    """Normal, tangents and view `(m, 3)` after `shading_normals`; geometric and shading normals, views."""
    mi, dr = mitsuba_modules()

    def vectors(values):
        return mi.Vector3f(*(mi.Float(column.astype(np.float32)) for column in values.T))

    si = dr.zeros(mi.SurfaceInteraction3f, len(g))
    si.n = mi.Normal3f(vectors(g))
    si.sh_frame.n = mi.Normal3f(vectors(n))
    si.dp_du = vectors(np.roll(g, 1, axis=1) + np.array([0.1, 0.2, 0.3]))
    si.initialize_sh_frame()
    si.wi = si.to_local(vectors(v))
    si = shading_normals(si)
    return tuple(np.array(axis).T for axis in (si.sh_frame.n, si.sh_frame.s, si.sh_frame.t, si.wi))


@pytest.mark.parametrize("albedo", [1.0, 0.5])
def test_no_light_leaves_between_the_normals_of_triangle_and_surface(albedo):
    # Of a matt body, (1 - cos t) / 2 of the light is below a plane that is turned by t. It meets the body
    # again, so p (1 - l) / (1 - l p) leaves in the end.
    mi, dr = mitsuba_modules()
    turn, count = math.radians(25.0), 1 << 14
    body = Surface("matt", RANGE_NM, np.full((1, 2, 2), albedo), np.zeros((1, 2)), 1.0, (0.3, 0.3))
    optics = Optics.pack([body], *RANGE_NM)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi, si.n = mi.Vector3f(0.0, 0.0, 1.0), mi.Normal3f(math.sin(turn), 0.0, math.cos(turn))
    si.sh_frame, si.wavelengths = mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0)), mi.Spectrum(550.0)
    point = optics.point(si, mi.UInt32(0), mi.Float(0.5), mi.Bool(True), None)
    rng = np.random.default_rng(3)
    u = rng.random((3, count)).astype(np.float32)
    wo, density, weight, _ = point.sample(mi.Float(u[0]), mi.Point2f(u[1], u[2]))
    going = np.asarray(density) > 0.0
    assert np.asarray(dr.dot(si.n, wo))[going].min() > 0.0
    lost = 0.5 * (1.0 - math.cos(turn))
    assert 1.0 - going.mean() == pytest.approx(lost, abs=0.01)  # four standard deviations
    sent = np.where(going, np.asarray(weight)[0], 0.0).mean()
    expected = albedo * (1.0 - lost) / (1.0 - albedo * lost)
    assert sent == pytest.approx(expected, abs=0.01)
    assert np.asarray(point.diffuse_reflectance())[0] == pytest.approx(expected, rel=1e-5)
    # Values along directions that were not sampled follow the same sides.
    below = mi.Vector3f(-0.98, 0.0, 0.199)
    assert dr.max(point.eval_pdf(below)[0])[0] == 0.0


def random_units(rng, count):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def dot(a, b):
    return np.sum(a * b, axis=-1)


def test_normals_are_rotated_only_as_far_as_needed():
    rng = np.random.default_rng(7)
    g, v = random_units(rng, 20_000), random_units(rng, 20_000)
    n = g + 1.2 * rng.uniform(0.0, 1.0, (20_000, 1)) * random_units(rng, 20_000)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    normal, s, t, wi = corrected(g, n, v)
    side = np.sign(dot(g, v))
    front = side * dot(n, v)
    mirror = side * (2.0 * dot(n, v) * dot(n, g) - dot(g, v))
    valid, needed = (front > 1e-5) & (mirror > 1e-5), (front < -1e-5) | (mirror < -1e-5)
    assert valid.sum() > 2000 < needed.sum()
    # Valid normals do not change; the others mirror the view along the triangle.
    assert normal[valid] == pytest.approx(n[valid], abs=1e-6)
    mirrored = 2.0 * dot(normal, v) * dot(normal, g) - dot(g, v)
    assert mirrored[needed] == pytest.approx(0.0, abs=2e-5)
    # The viewer is on the triangle's side; the normal is between the two original ones.
    assert (dot(normal, v) * dot(g, v) > 0.0).all()
    assert (dot(normal, g) >= dot(n, g) - 1e-5).all()
    assert dot(normal, np.cross(n, g)) == pytest.approx(0.0, abs=1e-5)
    # The frame is orthonormal, and contains the view.
    frame = np.stack([s, t, normal], axis=1)
    assert frame @ frame.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (20_000, 1, 1)), abs=1e-5)
    assert wi == pytest.approx(np.einsum("nij,nj->ni", frame, v), abs=1e-5)


def test_grazing_views_and_opposite_normals_give_finite_frames():
    z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    cases = [(z, -z, z), (z, -z, x), (z, z, x), (z, x, x), (z, x, -x), (z, x, z), (z, -z, -z), (z, x, -z)]
    g, n, v = (np.array(part) for part in zip(*cases, strict=True))
    for part in corrected(g, n, v):
        assert np.isfinite(part).all()


def test_gradients_with_respect_to_normals_are_finite():
    mi, dr = mitsuba_modules()
    si = dr.zeros(mi.SurfaceInteraction3f, 3)
    si.n, si.dp_du = mi.Normal3f(0.0, 0.0, 1.0), mi.Vector3f(1.0, 0.0, 0.0)
    tilt = mi.Float(0.0, 0.3, 1.4)
    dr.enable_grad(tilt)
    si.sh_frame.n = mi.Normal3f(dr.sin(tilt), 0.0, dr.cos(tilt))
    si.initialize_sh_frame()
    si.wi = si.to_local(mi.Vector3f(-0.8, 0.0, 0.6))
    dr.backward(dr.sum(shading_normals(si).wi.z))
    assert np.isfinite(np.array(dr.grad(tilt))).all()


def test_denoiser_keeps_the_brightness_of_the_outline():
    # A matt ball in front of the sky. Filtered together with the empty background, the outermost pixels lose
    # a fifth of the body's light, a tenth of all light. Twelve frames of 4 samples: standard error below 1 %.
    ball, surfaces = sphere((0.0, 0.0, 0.5), 0.03, "grey"), {"grey": lambertian_surface("grey", 0.25)}
    traced, depth = photograph(ball, surfaces)
    frames = [photograph(ball, surfaces, "standard", seed)[0] for seed in range(12)]
    filtered = np.mean(frames, axis=0)
    for inner, outer in ((0.0, 1.2), (1.2, 2.3), (2.3, 5.0)):
        ring = (depth > inner) & (depth <= outer)
        assert filtered[ring].mean() == pytest.approx(traced[ring].mean(), rel=0.03)
