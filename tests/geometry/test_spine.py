import numpy as np
import pytest

from pepperscene.geometry.spine import _resample, spines

UP = np.array([0.0, 0.0, 1.0])


def test_planar_curve_keeps_its_normal_in_the_plane():
    angle = np.linspace(0.0, 1.5, 12)
    arc = np.stack([np.zeros(12), np.sin(angle), np.cos(angle)], axis=1)
    spine = spines([arc], [UP], 40)
    np.testing.assert_allclose(spine.lengths, 1.5, rtol=1e-3)
    # The normal points away from the circle's centre everywhere; the binormal is the plane's normal.
    inner = slice(1, -1)
    radial = spine.points[0] / np.linalg.norm(spine.points[0], axis=1, keepdims=True)
    np.testing.assert_allclose(spine.normals[0][inner], radial[inner], atol=3e-3)
    np.testing.assert_allclose(np.abs(spine.binormals[0][:, 0]), 1.0, atol=1e-9)


def test_frame_of_a_helix_rotates_against_the_frenet_frame_by_its_torsion():
    # Seen from the Frenet frame, a rotation-minimising frame rotates about the tangent by minus the integral
    # of the torsion; for a helix of radius r and rise c per radian that is -c t / sqrt(r^2 + c^2).
    radius, rise, turns = 1.0, 0.6, 1.5
    t = np.linspace(0.0, 2.0 * np.pi * turns, 300)
    helix = np.stack([radius * np.cos(t), radius * np.sin(t), rise * t], axis=1)
    frenet = np.stack([-np.cos(t), -np.sin(t), 0.0 * t], axis=1)
    tangent = np.stack([-radius * np.sin(t), radius * np.cos(t), rise + 0.0 * t], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = spines([helix], [frenet[0]], 299).normals[0]
    binormal = np.cross(tangent, frenet)
    angle = np.unwrap(np.arctan2(np.sum(normal * binormal, axis=1), np.sum(normal * frenet, axis=1)))
    np.testing.assert_allclose(angle, -rise * t / np.hypot(radius, rise), atol=0.03)


def test_frames_are_orthonormal_and_twist_rotates_the_tip():
    rng = np.random.default_rng(5)
    curves = [np.cumsum(rng.uniform(0.2, 1.0, (k, 3)), axis=0) for k in (2, 3, 9, 9)]
    ups = [np.array([0.3, -0.5, 0.8])] * 4
    twist = np.array([0.0, 0.4, -1.0, 2.0])
    plain, twisted = spines(curves, ups, 30), spines(curves, ups, 30, twist)
    for spine in (plain, twisted):
        np.testing.assert_allclose(np.sum(spine.normals * spine.binormals, axis=2), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(spine.normals, axis=2), 1.0, atol=1e-12)
    cosine = np.sum(twisted.normals * plain.normals, axis=2)
    np.testing.assert_allclose(cosine[:, -1], np.cos(twist), atol=1e-12)
    np.testing.assert_allclose(cosine[:, 0], 1.0)
    # Curves pass through their end points at equal steps.
    for index, curve in enumerate(curves):
        np.testing.assert_allclose(plain.points[index, [0, -1]], curve[[0, -1]], atol=1e-12)
        step = np.linalg.norm(np.diff(plain.points[index], axis=0), axis=1)
        np.testing.assert_allclose(step, step.mean(), rtol=0.03)


def test_an_upper_side_along_the_curve_still_gives_a_frame():
    spine = spines([np.array([[0.0, 0, 0], [0, 0, 1]])], [UP], 4)
    np.testing.assert_allclose(np.linalg.norm(spine.normals, axis=2), 1.0)
    np.testing.assert_allclose(spine.normals[..., 2], 0.0, atol=1e-12)


def test_points_are_placed_beyond_both_ends():
    spine = spines([np.array([[0.0, 0, 0], [0, 2.0, 0]])], [UP], 5)
    along, right, up = np.array([[-0.5, 1.0, 3.0]]), np.array([[0.1, 0.0, 0.0]]), np.array([[0.0, 0.2, 0.3]])
    expected = [[0.1, -0.5, 0.0], [0.0, 1.0, 0.2], [0.0, 3.0, 0.3]]
    np.testing.assert_allclose(spine.place(along, right, up)[0], expected, atol=1e-12)


@pytest.mark.parametrize("curve", [np.zeros((3, 3)), np.zeros((1, 3))])
def test_raises_on_a_curve_without_length(curve):
    with pytest.raises(ValueError, match="distinct"):
        spines([curve], [UP], 4)


def test_resampling_many_curves_equals_numpy_interpolation():
    # On polylines whose pieces differ by orders of magnitude.
    rng = np.random.default_rng(8)
    points = np.cumsum(rng.normal(size=(40, 25, 3)) * 10.0 ** rng.uniform(-5, 0, (40, 25, 1)), axis=1)
    points[3, 5] = points[3, 4]
    distance = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=2), axis=1)
    together = _resample(points, distance, 60)
    for row in range(len(points)):
        at = np.linspace(0.0, distance[row, -1], 61)
        for axis in range(3):
            alone = np.interp(at, distance[row], points[row, :, axis])
            np.testing.assert_allclose(together[row, :, axis], alone, atol=1e-11)
