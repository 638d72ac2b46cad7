"""Run lengths, boxes, cuts of stalks, ways of tools, graphs: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import look_at
from pepperscene.classes import Instance, OrganClass
from pepperscene.truth.cut_point import fruit_stalk, tool_approach
from pepperscene.truth.encodings import decode_rle, encode_rle, mask_box, touches_border
from pepperscene.truth.harvest import organ_graph

# --- masks and boxes ----------------------------------------------------------------------------------------


def masks():
    rng = np.random.default_rng(0)
    yield np.zeros((4, 5), bool)
    yield np.ones((4, 5), bool)
    yield np.eye(4, 5, dtype=bool)
    for share in (0.05, 0.5, 0.95):
        yield rng.uniform(size=(13, 17)) < share


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools' own
@pytest.mark.parametrize("mask", list(masks()))
def test_run_lengths_are_those_of_the_library_that_owns_the_format(mask):
    coder = pytest.importorskip("pycocotools.mask", reason="pycocotools owns the format")
    runs = encode_rle(mask)
    assert sum(runs["counts"]) == mask.size
    assert sum(runs["counts"][1::2]) == mask.sum()
    packed = coder.frPyObjects(dict(runs), *mask.shape)
    np.testing.assert_array_equal(coder.decode(packed), mask)
    assert packed["counts"] == coder.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
    if mask.any():
        x0, y0, x1, y1 = mask_box(mask)
        assert coder.toBbox(packed).tolist() == [x0, y0, x1 - x0, y1 - y0]


@pytest.mark.parametrize("mask", list(masks()))
def test_masks_come_back_from_their_runs(mask):
    np.testing.assert_array_equal(decode_rle(encode_rle(mask)), mask)


@pytest.mark.parametrize("corner", [(0, 0), (3, 5), (2, 0)])
def test_a_part_of_a_picture_has_the_runs_of_the_whole(corner):
    part = np.random.default_rng(1).uniform(size=(8, 6)) < 0.6
    whole = np.zeros((13, 10), bool)
    x, y = corner
    whole[y : y + 8, x : x + 6] = part
    assert encode_rle(part, (13, 10), corner) == encode_rle(whole)
    assert mask_box(part, corner) == mask_box(whole)


def test_full_columns_are_one_run():
    # From the bottom of one column to the top of the next nothing is in between.
    mask = np.zeros((3, 4), bool)
    mask[:, 1:3] = True
    assert encode_rle(mask)["counts"] == [3, 6, 3]


def test_runs_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="does not lie"):
        encode_rle(np.ones((3, 3), bool), (5, 5), (3, 0))
    with pytest.raises(ValueError, match="does not lie"):
        encode_rle(np.ones((3, 3), bool), (5, 5), (-1, 0))
    for counts in ([3, 4], [-1, 7], []):
        with pytest.raises(ValueError, match="do not fill"):
            decode_rle({"size": [2, 3], "counts": counts})


def test_boxes_are_half_open_and_know_the_border():
    mask = np.zeros((6, 9), bool)
    assert mask_box(mask) is None
    mask[2:4, 5] = True
    assert mask_box(mask) == (5, 2, 6, 4)
    assert not touches_border((5, 2, 6, 4), mask.shape)
    for box in ((0, 2, 3, 4), (5, 0, 6, 4), (5, 2, 9, 4), (5, 2, 6, 6)):
        assert touches_border(box, mask.shape)


# --- the stalk ----------------------------------------------------------------------------------------------

STEM = (np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), 6e-3, 6e-3)


def arc(inclination, length, bend, start, steps=64):
    """A stalk that leaves the stem's side towards +x and bends down evenly."""
    middle = (np.arange(steps) + 0.5) / steps
    slope = np.radians(inclination) - np.radians(bend) * middle
    step = length / steps * np.stack([np.cos(slope), np.zeros(steps), np.sin(slope)], axis=1)
    return np.cumsum(np.vstack([[start, 0.0, 0.0], step]), axis=0)


@pytest.mark.parametrize("inclination", [0.0, 30.0, 60.0])
def test_a_straight_stalk_comes_out_where_the_stem_ends(inclination):
    line = arc(inclination, 0.05, 0.0, 0.8 * 6e-3)
    stalk = fruit_stalk(line, 3.5e-3, STEM, instance=4, bearer_instance=3)
    hidden = 0.2 * 6e-3 / np.cos(np.radians(inclination))
    assert stalk.attachment[0] == pytest.approx(6e-3, abs=1e-9)
    assert stalk.length_m == pytest.approx(0.05 - hidden, abs=1e-9)
    np.testing.assert_allclose(stalk.curve[-1], line[-1])
    np.testing.assert_allclose(stalk.tangent, (line[-1] - line[0]) / 0.05, atol=1e-12)
    # In the furrow, 1.8 radii from the base, and a radius clear of the stem.
    along = np.linalg.norm(stalk.cut - line[0])
    assert along == pytest.approx(max(1.8 * 3.5e-3, hidden + 3.5e-3), abs=1e-9)
    assert (stalk.instance, stalk.bearer) == (4, 3)


def test_cuts_lie_on_a_bent_stalk_across_its_tangent():
    # A quarter circle of radius r: the tangent at arc length s has turned by s / r.
    length = 0.04
    radius = length / (0.5 * np.pi)
    line = arc(0.0, length, 90.0, 0.8 * 6e-3, steps=512)
    stalk = fruit_stalk(line, 3e-3, STEM)
    turned = np.arctan2(-stalk.tangent[2], stalk.tangent[0])
    centre = np.array([line[0, 0], 0.0, -radius])
    assert np.linalg.norm(stalk.cut - centre) == pytest.approx(radius, rel=1e-4)
    along = radius * np.arctan2(stalk.cut[0] - line[0, 0], stalk.cut[2] + radius)
    assert turned == pytest.approx(along / radius, abs=2e-3)
    assert np.linalg.norm(stalk.tangent) == pytest.approx(1.0)


def test_a_pedicel_is_cut_half_way_and_short_stalks_before_their_middle():
    truss = (np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]), 3e-3, 1e-3)
    line = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -0.03], 33)
    stalk = fruit_stalk(line, 1.5e-3, truss, on_stalk=True)
    # Half-way along the tapering truss its radius is 2 mm.
    assert stalk.attachment[2] == pytest.approx(-2e-3, abs=1e-9)
    assert stalk.cut[2] == pytest.approx(-0.5 * (2e-3 + 0.03), abs=1e-9)
    # A stub that hardly comes out of the stem is cut before its middle.
    stub = arc(0.0, 6e-3, 0.0, 0.8 * 6e-3)
    stalk = fruit_stalk(stub, 3.5e-3, STEM)
    assert np.linalg.norm(stalk.cut - stalk.attachment) == pytest.approx(0.5 * stalk.length_m)


def test_a_stalk_that_starts_outside_begins_at_its_base():
    line = arc(10.0, 0.05, 0.0, 9e-3)
    for bearer in (STEM, None):
        stalk = fruit_stalk(line, 3e-3, bearer)
        np.testing.assert_allclose(stalk.attachment, line[0])
        assert stalk.length_m == pytest.approx(0.05)
        assert np.linalg.norm(np.diff(stalk.curve, axis=0), axis=1).min() > 0.0


def test_a_stalk_that_never_comes_out_is_told_as_it_is():
    line = arc(0.0, 2e-3, 0.0, 0.0)
    stalk = fruit_stalk(line, 3e-3, STEM)
    np.testing.assert_allclose(stalk.attachment, line[0])
    assert stalk.cut[0] == pytest.approx(1e-3)


# --- the way to the fruit -----------------------------------------------------------------------------------

UPRIGHT = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])


@pytest.mark.parametrize("azimuth", [0.0, 40.0, -40.0, 150.0])
def test_the_azimuth_is_that_of_the_camera_around_the_fruit(azimuth):
    # The fruit hangs in front of the stem as seen from -y. To a camera that stands to the right of that, the
    # tool goes to the right.
    fruit = np.array([0.0, -0.05, 1.0])
    way = tool_approach(fruit, UPRIGHT)
    np.testing.assert_allclose(way.direction, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(way.stem, [0.0, 0.0, 1.0], atol=1e-12)
    angle = np.radians(azimuth)
    place = fruit + 0.4 * np.array([np.sin(angle), -np.cos(angle), -0.3])
    assert np.degrees(way.azimuth(look_at(place, fruit))) == pytest.approx(azimuth)


def test_in_the_camera_a_positive_azimuth_points_to_the_right():
    # Seen from -y with the stem to the right of the fruit.
    fruit = np.array([-0.05, -0.02, 1.0])
    way, pose = tool_approach(fruit, UPRIGHT), look_at([-0.05, -0.4, 0.9], fruit)
    assert way.azimuth(pose) > 0.0
    assert (pose[:3, :3].T @ way.direction)[0] > 0.0


def test_the_stem_is_taken_at_the_height_of_the_fruit():
    leaning = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 1.0], [0.2, 0.0, 1.0], [0.6, 0.0, 2.0]])
    way = tool_approach(np.array([0.5, 0.3, 1.5]), leaning)
    np.testing.assert_allclose(way.stem, [0.4, 0.0, 1.5], atol=1e-12)
    assert way.direction[2] == 0.0
    assert np.linalg.norm(way.direction) == pytest.approx(1.0)
    # Beyond its ends the nearer end serves.
    np.testing.assert_allclose(tool_approach(np.array([0.5, 0.3, 2.3]), leaning).stem, leaning[-1])
    np.testing.assert_allclose(tool_approach(np.array([0.5, 0.3, -0.1]), leaning).stem, leaning[0])


def test_around_the_stem_there_is_no_side():
    assert tool_approach(np.array([0.0, 5e-4, 1.0]), UPRIGHT) is None


def test_a_camera_that_looks_up_is_told_by_its_upper_side():
    way = tool_approach(np.array([0.0, -0.05, 1.0]), UPRIGHT)
    pose = look_at([0.0, -0.05, 0.5], [0.0, -0.05, 1.0], up=(0.0, -1.0, 0.0))
    assert np.isfinite(way.azimuth(pose))


# --- what hangs on what -------------------------------------------------------------------------------------


def test_the_graph_holds_each_organ_and_each_joint_once():
    def organ(kind, organ_class, parent):
        return Instance(organ_class, kind, 0, 7, parent)

    instances = [
        organ("node", OrganClass.STEM, -1),
        organ("truss", OrganClass.PEDUNCLE, 0),
        organ("pedicel", OrganClass.PEDUNCLE, 1),
        organ("fruit", OrganClass.PEPPER, 2),
        organ("pedicel", OrganClass.PEDUNCLE, 1),
        organ("fruit", OrganClass.PEPPER, 4),
        organ("lamina", OrganClass.LEAF, 0),
    ]
    pixels = np.bincount([0, 0, 2, 4, 4, 4])
    graph = organ_graph([(3, 2, 1, 0), (5, 4, 1, 0)], instances, pixels)
    assert [node["instance"] for node in graph["nodes"]] == [1, 2, 3, 4, 5, 6]
    assert [node["pixels"] for node in graph["nodes"]] == [0, 1, 0, 3, 0, 0]
    assert graph["nodes"][1] == {
        "instance": 2, "kind": "truss", "class": 3, "plant": 0, "phytomer": 7, "pixels": 1,
    }  # fmt: skip
    assert graph["edges"] == [[2, 1], [3, 2], [4, 3], [5, 2], [6, 5]]
    assert organ_graph([], instances, pixels) == {"nodes": [], "edges": []}
