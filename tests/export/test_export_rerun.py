"""Rerun recordings, read by Rerun itself: geometry against closed forms, labels against the data set."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from rerun_recording import IMAGE, Recording
from traced_set import FRUIT, HEIGHT, IGNORED, WIDTH, colour_of, intersect, make_traced_set

from pepperscene.errors import InputError, SetupError
from pepperscene.export import export_dataset
from pepperscene.export.rerun import RECORDING

chunk = pytest.importorskip("rerun.chunk")


def surfaces(matrix, pose):
    """By closed form: depth `(h, w)` in metres along the axis, whether it is the sphere, and colours."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    in_camera = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ np.linalg.inv(matrix).T
    length = np.linalg.norm(in_camera, axis=1, keepdims=True)
    direction = in_camera / length @ pose[:3, :3].T
    sphere, wall = intersect(np.tile(pose[:3, 3], (len(direction), 1)), direction)
    distance = np.minimum(sphere, wall)
    with np.errstate(invalid="ignore"):
        colours = colour_of(
            np.where(np.isinf(distance)[:, None], np.inf, pose[:3, 3] + distance[:, None] * direction)
        )
    depth = (distance / length[:, 0]).reshape(HEIGHT, WIDTH)
    return depth, (sphere < wall).reshape(HEIGHT, WIDTH), colours.reshape(HEIGHT, WIDTH, 3)


def errors(recording, frame):
    """Median difference of depth in mm, IoU of the sphere, and median difference of colours in codes."""
    depth, is_sphere, colours = surfaces(*recording.camera(frame))
    depth_mm = recording.image("depth", frame).astype(float)
    both = (depth_mm > 0) & np.isfinite(depth)
    found = recording.image("classes", frame) == 2
    inside = recording.colour(frame).any(axis=-1)
    iou = (found & is_sphere & inside).sum() / max(((found | is_sphere) & inside).sum(), 1)
    difference = np.abs(recording.colour(frame).astype(float) - colours)[both]
    return np.median(np.abs(depth_mm - 1e3 * depth)[both]), iou, np.median(difference)


@pytest.mark.parametrize("lens", ["pinhole", "rational", "fisheye"])
def test_every_pixel_shows_what_the_recorded_pinhole_camera_sees(lens, traced, exported):
    dataset, recording = traced(lens), Recording(exported("rerun", lens) / RECORDING)
    assert recording.frames == list(dataset.indices())
    for frame in recording.frames:
        depth_mm, iou, codes = errors(recording, frame)
        # Depth and classes are those of the nearest pixel, half a pixel away at most.
        assert depth_mm < (0.51 if lens == "pinhole" else 2.0)
        assert iou > (0.999 if lens == "pinhole" else 0.95)
        assert codes < 1.5


def test_images_of_a_pinhole_camera_are_those_of_the_data_set(traced, exported):
    dataset, recording = traced(), Recording(exported("rerun") / RECORDING)
    for frame in dataset.indices():
        assert (
            bytes(recording.get(f"{IMAGE}/colour", "EncodedImage:blob", frame)[0])
            == dataset.path(frame, "colour").read_bytes()
        )
        np.testing.assert_array_equal(recording.image("classes", frame), dataset.image(frame, "class"))
        depth = np.nan_to_num(1e3 * dataset.image(frame, "depth_z"), posinf=0.0)
        assert np.abs(recording.image("depth", frame) - depth).max() <= 0.51
        np.testing.assert_array_equal(
            recording.camera(frame)[1], np.float32(dataset.metadata(frame)["camera"]["pose"])
        )


def test_boxes_enclose_the_organs(traced, tmp_path):
    dataset = traced()
    export_dataset(dataset.folder, "rerun", tmp_path / "out", classes="pepper")
    recording = Recording(tmp_path / "out" / RECORDING)
    for frame in dataset.indices():
        columns = {
            name: recording.get(f"{IMAGE}/boxes", f"Boxes2D:{name}", frame)
            for name in ("centers", "half_sizes", "class_ids", "labels")
        }
        rows, cols = np.nonzero(dataset.image(frame, "instance") == FRUIT)
        (centre,), (half,) = np.array(columns["centers"]), np.array(columns["half_sizes"])
        np.testing.assert_array_equal(centre - half, (cols.min(), rows.min()))
        np.testing.assert_array_equal(centre + half, (cols.max() + 1, rows.max() + 1))
        assert (columns["class_ids"], columns["labels"]) == ([2], [f"fruit {FRUIT}"])


def test_ignored_pixels_have_a_class_of_their_own(ignoring, tmp_path):
    export_dataset(ignoring.folder, "rerun", tmp_path / "out", frames="0:1")
    recording = Recording(tmp_path / "out" / RECORDING)
    ignored = ignoring.image(0, "instance") == IGNORED
    np.testing.assert_array_equal(recording.image("classes", 0) == 255, ignored)
    names = [entry["class_id"] for entry in recording.get("/world", "AnnotationContext:context")[0]]
    assert names == [*range(8), 255]


def test_several_scenes_have_a_recording_each(two_scenes, tmp_path):
    out = export_dataset(two_scenes.folder, "rerun", tmp_path / "out").folder
    for name, frames in (("set_000_rotation_000", [0, 1]), ("set_001_rotation_000", [2, 3])):
        assert Recording(out / name / RECORDING).frames == frames
        (entry,) = chunk.RrdReader(out / name / RECORDING).recordings()
        assert entry.recording_id.endswith(name)


def test_missing_outputs_and_package_are_one_sentence(tmp_path, monkeypatch):
    dataset = make_traced_set(tmp_path / "set", outputs=("colour", "class", "instance"))
    with pytest.raises(InputError, match="frame 000000 has no output 'distance'"):
        export_dataset(dataset.folder, "rerun", tmp_path / "out")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(SetupError, match=r"needs rerun, which is not installed.*pepperscene\[rerun\]"):
        export_dataset(dataset.folder, "rerun", tmp_path / "out")
    assert not (tmp_path / "out").exists()
