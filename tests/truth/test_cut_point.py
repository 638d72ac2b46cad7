"""Cut points, tool approaches, organ graphs and blossom ends against closed forms."""

import numpy as np
import pytest
import trimesh

from pepperscene.camera import look_at
from pepperscene.classes import Instance, OrganClass
from pepperscene.truth.cut_point import blossom_end, fruit_stalk, tool_approach
from pepperscene.truth.harvest import organ_graph

STEM = (np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), 6e-3, 6e-3)


def arc(inclination, length, bend, start, steps=64):
    """A stalk that starts towards +x and bends down evenly."""
    middle = (np.arange(steps) + 0.5) / steps
    slope = np.radians(inclination) - np.radians(bend) * middle
    step = length / steps * np.stack([np.cos(slope), np.zeros(steps), np.sin(slope)], axis=1)
    return np.cumsum(np.vstack([[start, 0.0, 0.0], step]), axis=0)


@pytest.mark.parametrize("inclination", [0.0, 30.0, 60.0])
def test_straight_stalk_emerges_from_the_stems_surface(inclination):
    line = arc(inclination, 0.05, 0.0, 0.8 * 6e-3)
    stalk = fruit_stalk(line, 3.5e-3, STEM, instance=4, parent_instance=3)
    hidden = 0.2 * 6e-3 / np.cos(np.radians(inclination))
    assert stalk.attachment[0] == pytest.approx(6e-3, abs=1e-9)
    assert stalk.length_m == pytest.approx(0.05 - hidden, abs=1e-9)
    np.testing.assert_allclose(stalk.curve[-1], line[-1])
    np.testing.assert_allclose(stalk.tangent, (line[-1] - line[0]) / 0.05, atol=1e-12)
    # In the furrow, 1.8 radii from the base, and a radius clear of the stem.
    along = np.linalg.norm(stalk.cut - line[0])
    assert along == pytest.approx(max(1.8 * 3.5e-3, hidden + 3.5e-3), abs=1e-9)
    assert (stalk.instance, stalk.parent) == (4, 3)


def test_cut_is_on_a_bent_stalk_with_its_tangent():
    # A quarter circle of radius r: the tangent at arc length s has rotated by s / r.
    length = 0.04
    radius = length / (0.5 * np.pi)
    line = arc(0.0, length, 90.0, 0.8 * 6e-3, steps=512)
    stalk = fruit_stalk(line, 3e-3, STEM)
    rotated = np.arctan2(-stalk.tangent[2], stalk.tangent[0])
    centre = np.array([line[0, 0], 0.0, -radius])
    assert np.linalg.norm(stalk.cut - centre) == pytest.approx(radius, rel=1e-4)
    along = radius * np.arctan2(stalk.cut[0] - line[0, 0], stalk.cut[2] + radius)
    assert rotated == pytest.approx(along / radius, abs=2e-3)
    assert np.linalg.norm(stalk.tangent) == pytest.approx(1.0)


def test_pedicel_is_cut_half_way():
    truss = (np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]), 3e-3, 1e-3)
    stalk = fruit_stalk(np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -0.03], 33), 1.5e-3, truss, on_stalk=True)
    # Half-way along the tapering truss its radius is 2 mm.
    assert stalk.attachment[2] == pytest.approx(-2e-3, abs=1e-9)
    assert stalk.cut[2] == pytest.approx(-0.5 * (2e-3 + 0.03), abs=1e-9)


def test_short_stalk_is_cut_at_its_middle():
    stalk = fruit_stalk(arc(0.0, 6e-3, 0.0, 0.8 * 6e-3), 3.5e-3, STEM)
    assert np.linalg.norm(stalk.cut - stalk.attachment) == pytest.approx(0.5 * stalk.length_m)


@pytest.mark.parametrize(
    ("length", "start", "parent"), [(0.05, 9e-3, STEM), (0.05, 9e-3, None), (2e-3, 0.0, STEM)]
)
def test_stalk_that_starts_outside_or_never_emerges_is_attached_at_its_base(length, start, parent):
    line = arc(10.0, length, 0.0, start)
    stalk = fruit_stalk(line, 3e-3, parent)
    np.testing.assert_allclose(stalk.attachment, line[0])
    assert stalk.length_m == pytest.approx(length)
    assert np.linalg.norm(np.diff(stalk.curve, axis=0), axis=1).min() > 0.0
    assert np.linalg.norm(stalk.cut - line[0]) == pytest.approx(min(1.8 * 3e-3, 0.5 * length))


UPRIGHT = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])


@pytest.mark.parametrize("azimuth", [0.0, 40.0, -40.0, 150.0])
def test_azimuth_is_that_of_the_camera_around_the_fruit(azimuth):
    # The fruit is in front of the stem as seen from -y. For a camera to the right of that, the tool moves
    # right.
    fruit = np.array([0.0, -0.05, 1.0])
    approach = tool_approach(fruit, UPRIGHT)
    np.testing.assert_allclose(approach.direction, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(approach.stem, [0.0, 0.0, 1.0], atol=1e-12)
    angle = np.radians(azimuth)
    position = fruit + 0.4 * np.array([np.sin(angle), -np.cos(angle), -0.3])
    assert np.degrees(approach.azimuth(look_at(position, fruit))) == pytest.approx(azimuth)


def test_stem_is_taken_at_the_height_of_the_fruit():
    leaning = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 1.0], [0.2, 0.0, 1.0], [0.6, 0.0, 2.0]])
    approach = tool_approach(np.array([0.5, 0.3, 1.5]), leaning)
    np.testing.assert_allclose(approach.stem, [0.4, 0.0, 1.5], atol=1e-12)
    assert approach.direction[2] == 0.0
    assert np.linalg.norm(approach.direction) == pytest.approx(1.0)
    # Beyond its ends, the nearer end is used.
    np.testing.assert_allclose(tool_approach(np.array([0.5, 0.3, 2.3]), leaning).stem, leaning[-1])
    np.testing.assert_allclose(tool_approach(np.array([0.5, 0.3, -0.1]), leaning).stem, leaning[0])


def test_no_approach_to_a_fruit_around_the_stem():
    assert tool_approach(np.array([0.0, 5e-4, 1.0]), UPRIGHT) is None


def test_azimuth_is_defined_for_a_camera_that_looks_up():
    approach = tool_approach(np.array([0.0, -0.05, 1.0]), UPRIGHT)
    pose = look_at([0.0, -0.05, 0.5], [0.0, -0.05, 1.0], up=(0.0, -1.0, 0.0))
    assert np.isfinite(approach.azimuth(pose))


def test_graph_has_each_organ_and_edge_once():
    kinds = [
        ("node", OrganClass.STEM, -1),
        ("truss", OrganClass.PEDUNCLE, 0),
        ("pedicel", OrganClass.PEDUNCLE, 1),
        ("fruit", OrganClass.PEPPER, 2),
        ("pedicel", OrganClass.PEDUNCLE, 1),
        ("fruit", OrganClass.PEPPER, 4),
        ("lamina", OrganClass.LEAF, 0),
    ]
    instances = [Instance(organ_class, kind, 0, 7, parent) for kind, organ_class, parent in kinds]
    pixels = np.bincount([0, 0, 2, 4, 4, 4])
    graph = organ_graph([(3, 2, 1, 0), (5, 4, 1, 0)], instances, pixels)
    assert [node["instance"] for node in graph["nodes"]] == [1, 2, 3, 4, 5, 6]
    assert [node["pixels"] for node in graph["nodes"]] == [0, 1, 0, 3, 0, 0]
    assert graph["nodes"][1] == {
        "instance": 2, "kind": "truss", "class": 3, "plant": 0, "phytomer": 7, "pixels": 1,
    }  # fmt: skip
    assert graph["edges"] == [[2, 1], [3, 2], [4, 3], [5, 2], [6, 5]]
    assert organ_graph([], instances, pixels) == {"nodes": [], "edges": []}


# --- blossom ends -------------------------------------------------------------------------------------------


STRETCH = np.array([0.03, 0.03, 0.05])


def ellipsoid():
    """A fruit 10 cm long whose stalk end is at the origin, triangulated finely; its vertices and faces."""
    ball = trimesh.creation.icosphere(4)
    return ball.vertices * STRETCH + [0.0, 0.0, STRETCH[2]], ball.faces


def test_vertex_with_the_last_surface_coordinate_counts_wherever_it_is():
    points, faces = ellipsoid()
    v = np.linspace(0.0, 0.9, len(points)).astype(np.float32)
    v[17] = 1.0
    np.testing.assert_array_equal(blossom_end(points, faces, v), points[17])


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.1])
def test_scan_ends_where_its_axis_leaves_the_skin(turn):
    points, faces = ellipsoid()
    # Moved aside, so that no vertex is on the axis.
    rotation = trimesh.transformations.rotation_matrix(turn, [0.0, 0.0, 1.0])[:3, :3]
    points = points @ rotation.T + np.array([1e-3, 5e-4, 0.0])
    end = blossom_end(points, faces, np.full(len(points), 0.5))
    np.testing.assert_array_equal(end[:2], 0.0)
    assert end[2] == pytest.approx(0.1, abs=2e-4)
    _, distance, _ = trimesh.proximity.closest_point(trimesh.Trimesh(points, faces, process=False), [end])
    assert distance[0] < 1e-12


def test_farthest_vertex_if_the_axis_misses_the_skin():
    points, faces = ellipsoid()
    end = blossom_end(points + np.array([1.0, 0.0, 0.0]), faces, np.full(len(points), 0.5))
    np.testing.assert_allclose(end, [1.0, 0.0, 0.1], atol=1e-9)
