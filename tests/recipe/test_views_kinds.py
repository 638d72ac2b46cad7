"""Views of every kind give the poses that their tables state, and follow their files."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.camera_views import CameraViews
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe

PLAN = "plan = { sets = 1, rotations = 1, frames = 3 }\n"
ROW = "cultivar = 'kaite_february'\nrow = { plants_front = 1, plants_back = 0 }\n"
# The columns are right (+x), down (-z) and forward (+y) of a camera in the aisle at -y.
FACING_ROW = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture
def cameras(tmp_path):
    """The cameras of the first frames of a recipe, without a scene."""

    def make(text, plan="plan = { sets = 1, rotations = 1 }\n"):
        path = tmp_path / "mine.toml"
        path.write_text(f"extends = 'barth2018'\n{plan}{text}\n")
        resolved = resolve_recipe(path)
        views = CameraViews(FrameSetups(resolved))
        return [views.camera(resolved.recipe.plan.frame(i)) for i in range(resolved.recipe.plan.frames)]

    return make


def facing(azimuth_deg, pitch_deg):
    """Camera axes in the world: right, down and forward as columns."""
    turned = Rotation.from_euler("z", azimuth_deg, degrees=True).as_matrix() @ FACING_ROW
    return turned @ Rotation.from_euler("x", pitch_deg, degrees=True).as_matrix()


def test_an_arc_keeps_its_distance_and_faces_the_plant(cameras):
    found = cameras(
        "[views]\nkind = 'arc'\ndistance_mm = 500\nazimuth_deg = [-30, 30]\n"
        "height_mm = [1000, 1400]\npitch_deg = 10",
        PLAN,
    )
    for camera, azimuth, height in zip(found, (-30, 0, 30), (1.0, 1.2, 1.4), strict=True):
        angle = np.radians(azimuth)
        np.testing.assert_allclose(
            camera.pose[:3, 3], [0.5 * np.sin(angle), -0.5 * np.cos(angle), height], atol=1e-12
        )
        np.testing.assert_allclose(camera.pose[:3, :3], facing(azimuth, 10), atol=1e-12)


def test_a_grid_has_all_combinations_the_last_list_fastest(cameras):
    found = cameras(
        "[views]\nkind = 'grid'\nx_mm = [-100, 100]\ndistance_mm = [300, 400]\n"
        "height_mm = [900]\nazimuth_deg = [0, 20]"
    )
    assert len(found) == 8
    places = [
        (x + d * np.sin(np.radians(a)), -d * np.cos(np.radians(a)), 0.9)
        for x in (-0.1, 0.1) for d in (0.3, 0.4) for a in (0, 20)
    ]  # fmt: skip
    np.testing.assert_allclose([camera.pose[:3, 3] for camera in found], places, atol=1e-12)


def test_a_protocol_has_every_azimuth_at_every_distance(cameras):
    found = cameras(
        "[views]\nkind = 'protocol'\ndistance_mm = [500, 300]\nazimuth_deg = [-45, 0, 45]\n"
        "height_mm = 1500\npitch_deg = 20"
    )
    distances = [np.linalg.norm(camera.pose[:2, 3]) for camera in found]
    np.testing.assert_allclose(distances, [0.5] * 3 + [0.3] * 3)
    np.testing.assert_allclose(found[4].pose[:3, :3], facing(0, 20), atol=1e-12)


def test_a_path_at_a_frame_rate_moves_at_its_speed(cameras):
    found = cameras(
        "[views]\nkind = 'path'\npoints_mm = [[-500, -600, 1000], [0, -600, 1000], [500, -600, 1000]]\n"
        "speed_mm_s = 200\nframe_rate_hz = 4\npitch_deg = 5"
    )
    assert len(found) == 21
    for index, camera in enumerate(found):
        np.testing.assert_allclose(camera.pose[:3, 3], [-0.5 + 0.05 * index, -0.6, 1.0], atol=1e-6)
        np.testing.assert_allclose(camera.pose[:3, :3], facing(0, 5), atol=1e-9)
        np.testing.assert_allclose(camera.motion.velocity_m_s, [0.2, 0, 0], atol=1e-3)


def test_a_path_looks_at_its_point(cameras):
    found = cameras(
        "[views]\nkind = 'path'\npoints_mm = [[-500, -600, 1000], [500, -700, 1200]]\nspeed_mm_s = 200\n"
        "look_at_mm = [0, 0, 1100]",
        PLAN,
    )
    for camera in found:
        direction = np.array([0, 0, 1.1]) - camera.pose[:3, 3]
        np.testing.assert_allclose(camera.pose[:3, 2], direction / np.linalg.norm(direction), atol=1e-9)


POSES = np.stack([np.eye(4)] * 3)
POSES[:, :3, :3] = [facing(*angles) for angles in ((0, 0), (15, -5), (-20, 10))]
POSES[:, :3, 3] = [[0.1, -0.5, 1.2], [0.2, -0.55, 1.25], [0.35, -0.6, 1.2]]


def write_tum(folder):
    (folder / "poses.txt").write_text("\n".join(rows_of_poses(" ", 0.5)) + "\n")
    return "poses.txt"


def rows_of_poses(separator, *before):
    """Lines with the numbers of positions and quaternions."""
    quaternions = Rotation.from_matrix(POSES[:, :3, :3]).as_quat()
    numbers = np.concatenate([POSES[:, :3, 3], quaternions], axis=1).tolist()
    return [
        separator.join(map(repr, [*(step * i for step in before), *row])) for i, row in enumerate(numbers)
    ]


def write_csv(folder):
    (folder / "poses.csv").write_text("\n".join(["x_m,y_m,z_m,qx,qy,qz,qw", *rows_of_poses(",")]) + "\n")
    return "poses.csv"


def write_nerfstudio(folder):
    # Camera axes right, up, backwards.
    frames = [
        {"file_path": f"{index}.png", "transform_matrix": (pose @ np.diag([1.0, -1, -1, 1])).tolist()}
        for index, pose in enumerate(POSES)
    ]
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return "transforms.json"


def write_colmap(folder):
    lines = []
    for index, pose in enumerate(POSES):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3].T).as_quat()
        translation = -pose[:3, :3].T @ pose[:3, 3]
        numbers = " ".join(repr(float(value)) for value in (w, x, y, z, *translation))
        lines += [f"{index + 1} {numbers} 1 {index}.png", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    return "images.txt"


@pytest.mark.parametrize("write", [write_tum, write_csv, write_nerfstudio, write_colmap])
def test_poses_of_every_file_format_are_those_of_the_file(cameras, tmp_path, write):
    found = cameras(f"[views]\nkind = 'poses'\nfile = '{write(tmp_path)}'")
    np.testing.assert_allclose([camera.pose for camera in found], POSES, atol=1e-9)
    if write is write_tum:
        # Between half-second steps.
        middle = (POSES[2, :3, 3] - POSES[0, :3, 3]) / 1.0
        np.testing.assert_allclose(found[1].motion.velocity_m_s, middle, atol=0.02)


def test_a_changed_file_of_poses_gives_other_poses_and_another_identity(cameras, tmp_path):
    text = f"[views]\nkind = 'poses'\nfile = '{write_csv(tmp_path)}'"
    before = cameras(text)[0].pose
    digest = load_recipe(tmp_path / "mine.toml").sha256()
    file = tmp_path / "poses.csv"
    file.write_text(file.read_text().replace("0.1,", "0.7,", 1))
    os.utime(file, ns=(0, 1))  # also within the resolution of the clock
    after = cameras(text)[0].pose
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], [0.6, 0, 0], atol=1e-12)
    assert load_recipe(tmp_path / "mine.toml").sha256() != digest


BASE = (
    "camera.gain = { low = 1, high = 2 }\n[twins]\n'camera.bits' = [8, 10]\n[[rig]]\n"
    "name = 'right'\nposition_mm = [50, 0, 0]"
)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("high = 2 }", "high = 3 }"),
        ("high = 2 }", "high = 2, scale = 'log' }"),
        ("high = 2 }", "high = 2, per = 'set' }"),
        ("high = 2 }", "high = 2, draw = 'a' }"),
        ("high = 2 }", "high = 2, reversed = true }"),
        ("{ low = 1, high = 2 }", "{ mean = 1.5, sd = 0.1 }"),
        ("{ low = 1, high = 2 }", "{ 1 = 0.5, 2 = 0.5 }"),
        ("{ low = 1, high = 2 }", "{ in_turn = [1, 2] }"),
        ("{ low = 1, high = 2 }", "1.5"),
        ("[8, 10]", "[8, 12]"),
        ("[8, 10]", "[8, 10, 12]"),
        ("'right'", "'left'"),
        ("[50, 0, 0]", "[51, 0, 0]"),
        ("[50, 0, 0]", "[50, 0, 0]\nrotation_deg = [0, 1, 0]"),
        ("[50, 0, 0]", "[50, 0, 0]\nfocus_mm = 500"),
    ],
)
def test_every_variation_twin_and_camera_of_the_rig_changes_the_identity(tmp_path, old, new):
    assert old in BASE
    digests = []
    for text in (BASE, BASE.replace(old, new)):
        (tmp_path / "mine.toml").write_text(f"extends = 'barth2018'\n{text}\n")
        digests.append(load_recipe(tmp_path / "mine.toml").sha256())
    assert digests[0] != digests[1]


FUNCTION = """
import numpy as np
def poses(scene, rng):
    assert len(scene.mesh.faces) > 1000
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = rng.uniform(0, 1, (3, 3))
    return poses
"""


@pytest.fixture
def with_function(tmp_path, fake_renderer):
    def make(text):
        (tmp_path / "views.py").write_text(text)
        path = tmp_path / "mine.toml"
        path.write_text(f"extends = 'barth2018'\n{PLAN}{ROW}[views]\nkind = 'function'\nfile = 'views.py'\n")
        return FrameRenderer(path, fake_renderer, allow_code=True)

    return make


def test_a_function_gives_the_poses_of_its_scene(with_function):
    renderer = with_function(FUNCTION)
    digest = renderer.recipe.sha256()
    specs = [renderer.recipe.plan.frame(index) for index in range(3)]
    poses = [renderer.camera(spec).pose for spec in specs]
    assert len({pose[0, 3] for pose in poses}) == 3
    again = with_function(FUNCTION)
    np.testing.assert_array_equal([again.camera(spec).pose for spec in reversed(specs)][::-1], poses)
    # The file can change while a notebook runs.
    changed = with_function(FUNCTION.replace("uniform(0, 1", "uniform(2, 3"))
    np.testing.assert_allclose(changed.camera(specs[0]).pose[:3, 3] - poses[0][:3, 3], 2.0)
    assert changed.recipe.sha256() != digest


@pytest.mark.skipif(os.name != "posix", reason="other systems have text as file names")
def test_recipes_in_folders_whose_names_are_not_utf_8(tmp_path):
    digests = set()
    for name in (b"plain", b"caf\xe9", "\u00e9".encode()):
        folder = tmp_path / os.fsdecode(name)
        folder.mkdir()
        (folder / "poses.csv").write_text(
            "t_s,x_m,y_m,z_m,yaw_deg,pitch_deg\n0,0,-0.8,1,0,0\n1,0,-0.8,1.1,0,0\n"
        )
        cultivar = "extends = 'kaite'\nname = 'Mine'\nspecies = 'Capsicum annuum'\nsource = 'chosen'\n"
        (folder / "mine_plant.toml").write_text(cultivar)
        text = "extends = 'barth2018'\nname = 'mine'\ncultivar = 'mine_plant.toml'\n[views]\n"
        (folder / "mine.toml").write_text(text + "kind = 'poses'\nfile = 'poses.csv'\n")
        resolved = resolve_recipe(folder / "mine.toml")
        views = CameraViews(FrameSetups(resolved))
        np.testing.assert_allclose(views.camera(resolved.recipe.plan.frame(1)).pose[:3, 3], [0.0, -0.8, 1.1])
        assert resolved.cultivar.name == "Mine"
        digests.add(resolved.recipe.sha256())
    # Folders are not part of a recipe's identity.
    assert len(digests) == 1
