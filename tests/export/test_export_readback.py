"""Every format is read back as its users read it, and equals the data set; planted faults are found.

What is read from each format, and how, is in `read_back_objects`, `read_back_classes` and
`read_back_geometry`.
"""

from __future__ import annotations

import logging
import shutil
from importlib.util import find_spec

import numpy as np
import pytest
from figures import LARGEST_MM, LARGEST_PX
from planted_faults import FAULTS, scale, shift_fruit
from read_back_classes import verify_huggingface, verify_published, verify_semantic, verify_webdataset
from read_back_geometry import (
    compare_recordings,
    verify_bop,
    verify_colmap,
    verify_nerfstudio,
    verify_ply,
    verify_rerun,
    verify_rgbd,
)
from read_back_objects import verify_coco, verify_yolo, verify_yolo_detect, verify_yolo_pose
from rendered_set import make_rendered_set
from rerun_recording import IMAGE, Recording

from pepperscene.export import FORMATS, export_dataset

pytestmark = [
    pytest.mark.usefixtures("hub"),
    # Of pycocotools under NumPy 2, and of webdataset, which does not close what it has read.
    pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
VERIFY = {
    "published": verify_published, "coco": verify_coco, "yolo": verify_yolo,
    "yolo_detect": verify_yolo_detect, "yolo_pose": verify_yolo_pose, "semantic": verify_semantic,
    "webdataset": verify_webdataset, "huggingface": verify_huggingface, "nerfstudio": verify_nerfstudio,
    "colmap": verify_colmap, "ply": verify_ply, "rgbd": verify_rgbd, "bop": verify_bop,
    "rerun": verify_rerun,
}  # fmt: skip
needs_rerun = pytest.mark.skipif(find_spec("rerun") is None, reason="the extra `rerun` installs Rerun")
every_format = pytest.mark.parametrize(
    "format_name", [pytest.param(name, marks=needs_rerun if name == "rerun" else ()) for name in VERIFY]
)
WITH_POINTS = {"webdataset", "huggingface", "nerfstudio", "colmap", "ply", "rgbd", "bop", "rerun"}
WITH_DEPTHS = WITH_POINTS - {"colmap"}
WITH_MASKS = set(VERIFY) - {"yolo_detect", "yolo_pose", "nerfstudio", "colmap", "rgbd"}
FIFTY = {
    "plan.sets": 5, "plan.rotations": 2, "plan.frames": 5, "camera.width": 160, "camera.height": 120,
    "camera.fx": 105.0, "camera.fy": 106.0, "camera.cx": 78.9, "camera.cy": 60.35,
}  # fmt: skip


@pytest.fixture(scope="module")
def exported(rendered, tmp_path_factory):
    """The folder of an export of the rendered set by the name of the format; to be read, not changed."""
    folder, made = tmp_path_factory.mktemp("exports"), {}

    def export(name):
        if name not in made:
            made[name] = export_dataset(rendered.folder, name, folder / name).folder
        return made[name]

    return export


def check(figures, name, frames):
    """Enough is compared, and within the limits."""
    assert figures.points >= 1000 * frames or name not in WITH_POINTS
    assert figures.depths >= 1000 * frames or name not in WITH_DEPTHS
    assert figures.masks >= 6 * frames or name not in WITH_MASKS
    assert figures.points + figures.masks > 0
    assert figures.largest_px <= LARGEST_PX
    # The published code of distances has steps of 8.5 mm.
    assert figures.largest_mm <= (4.3 if name == "published" else LARGEST_MM)


def test_every_format_is_verified():
    # The depth of a depth camera is read back in test_depth_camera.py; all else of its format is as of rgbd.
    # Bands are read back in test_band_outputs.py.
    formats = set(FORMATS) - {"rgbd_sensor", "envi", "npy"}
    assert set(VERIFY) == formats
    assert set(FAULTS) == formats - {"rerun"}


@every_format
def test_what_is_read_back_is_the_data_set(format_name, rendered, exported):
    figures = VERIFY[format_name](rendered, exported(format_name))
    check(figures, format_name, len(rendered.indices()))


@pytest.mark.long  # it tests the readers of these tests
@pytest.mark.parametrize(
    ("format_name", "fault"), [(name, fault) for name, faults in FAULTS.items() for fault in faults]
)
def test_planted_fault_is_found(format_name, fault, rendered, exported, tmp_path):
    copy = shutil.copytree(exported(format_name), tmp_path / "copy")
    FAULTS[format_name][fault](copy)
    with pytest.raises(AssertionError, match=MESSAGES[fault.split()[-1]]):
        VERIFY[format_name](rendered, copy)


MESSAGES = {
    "mask": "a mask differs", "class": "the class differs|the class of an organ differs|a mask differs",
    "box": "a point is elsewhere", "keypoint": "a point is elsewhere|visibility differs",
    "pose": "elsewhere|behind the camera", "camera": "elsewhere|behind the camera",
    "object": "a corner of its box is elsewhere", "depth": "a depth differs|a point is elsewhere",
    "distance": "a depth differs",
}  # fmt: skip
"""By the last word of a fault."""


def invert_pose(recording, frame):
    _, pose = recording.camera(frame)
    inverse = np.linalg.inv(pose)
    recording.columns["/world/camera", "Transform3D:mat3x3", frame] = [inverse[:3, :3].T.ravel()]
    recording.columns["/world/camera", "Transform3D:translation", frame] = [inverse[:3, 3]]


def change_buffer(name, component, change):
    def plant(recording, frame):
        content = np.ascontiguousarray(change(recording.image(name, frame))).view(np.uint8)
        recording.columns[f"{IMAGE}/{name}", f"{component}:buffer", frame] = [content.ravel()]

    return plant


@needs_rerun
@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (invert_pose, "elsewhere|behind the camera"),
        (change_buffer("depth", "DepthImage", scale), "a depth differs"),
        (change_buffer("classes", "SegmentationImage", shift_fruit), "a mask differs"),
    ],
    ids=["inverted pose", "scaled depth", "shifted mask"],
)
def test_planted_fault_of_a_recording_is_found(plant, message, rendered, exported):
    recordings = [Recording(path) for path in sorted(exported("rerun").rglob("*.rrd"))]
    plant(recordings[0], recordings[0].frames[0])
    with pytest.raises(AssertionError, match=message):
        compare_recordings(rendered, recordings)


@pytest.mark.long
def test_fifty_frames_of_ten_scenes(tmp_path):
    """`--log-cli-level=INFO` shows the figures of each format."""
    dataset = make_rendered_set(tmp_path / "set", None, FIFTY)
    assert len(dataset.indices()) == 50
    for name, verify in VERIFY.items():
        if name == "rerun" and find_spec("rerun") is None:
            continue
        figures = verify(dataset, export_dataset(dataset.folder, name, tmp_path / name).folder)
        logging.getLogger(__name__).info("%s: %s", name, figures)
        check(figures, name, 50)
