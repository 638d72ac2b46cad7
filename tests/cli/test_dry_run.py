"""Dry runs of `build`, and what it says about selected frames."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from pepperscene.camera.pose_files.formats import read_poses

SMALL = (
    "--set", "plan.sets=1", "--set", "plan.rotations=2", "--set", "plan.frames=2", "--set",
    "row={plants_front=1, plants_back=0}", "--set", "cultivar=kaite_february",
)  # fmt: skip
DRY = ("build", "barth2018", "--dry-run", *SMALL)
LABELS = ("--outputs", "class,distance")
RANDOM = ("--set", 'views={kind="random", target="fruit", distance_mm=[200, 400]}', "--set", "plan.frames=3")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_build_is_described_and_nothing_is_written(command, here):
    result = command("build", "demo", "--dry-run", "--no-probe", "--out", "set")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert lines[0] == "demo, seed 2018"
    assert lines[1].startswith("frames    10,500 = 6 sets x 7 rotations x 250 views; 6 selected: 110, 2290, ")
    assert lines[2].startswith("views     arc: distance 400 mm")
    assert lines[3].startswith("camera    main: ")
    assert "800 x 600 pixels" in lines[3]
    assert lines[4:] == ["varies    nothing", "estimate  none without a probe frame"]
    assert list(here.iterdir()) == []


def test_a_probe_of_the_first_named_frame_gives_time_memory_and_disk_space(command, here):
    result = command(*DRY, *LABELS, "--frames", "1:4")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == "note: frame 1 is rendered to estimate the cost\n"
    assert "3 selected: 1, 2, 3" in result.stdout
    assert "estimate  from frame 1 (standard; class, distance), on this machine" in result.stdout
    assert [line.split()[0] for line in result.stdout.splitlines()[-3:]] == ["time", "memory", "disk"]
    assert "2 x " in result.stdout.splitlines()[-3]
    assert list(here.iterdir()) == []


def test_json_has_the_plan_and_the_estimate(command, here):
    varied = ("--set", "daylight.illuminance_lx={uniform=[1000, 2000], per='scene'}")
    result = command(*DRY, *LABELS, *varied, "--seed", 5, "--json", "--drawing", "plan.png")
    content = json.loads(result.stdout)
    assert (content["name"], content["seed"], content["frames"]["total"]) == ("barth2018", 5, 4)
    assert content["varied"][0] == {
        "key": "daylight.illuminance_lx", "per": "scene", "values": "1000 to 2000, uniform", "draw": None,
        "reversed": False,
    }  # fmt: skip
    assert content["estimate"]["disk_bytes"] == 4 * content["estimate"]["frame_bytes"] > 0
    assert content["files"] == ["plan.png"]


def test_the_drawing_and_the_poses_are_written(command, here):
    result = command(*DRY, "--no-probe", "--drawing", ".", "--poses", "poses.csv")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.splitlines()[-2:] == ["barth2018_plan.png", "poses.csv"]
    assert sorted(path.name for path in here.iterdir()) == ["barth2018_plan.png", "poses.csv"]
    with Image.open("barth2018_plan.png") as image:
        assert image.format == "PNG"
    # The ends of the arc, 0.4 m from the middle plant.
    positions = read_poses("poses.csv").poses[:, :3, 3]
    assert len(positions) == 4
    np.testing.assert_allclose(np.linalg.norm(positions[:, :2], axis=1), 0.4, atol=1e-9)


def test_plants_that_vary_per_frame_give_a_warning(command, here):
    result = command(*DRY, "--set", "row.spacing_mm={uniform=[150, 300], per='frame'}", "--no-probe")
    assert result.stderr == (
        "note: row.spacing_mm varies per frame, so that each frame needs plants and a scene of its own\n"
    )
    assert "of 4 scenes" in result.stdout


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("--drawing: 'plan.jpg' must end in .png", ("--drawing", "plan.jpg")),
        ("--poses: 'poses.xyz' must end in .json", ("--poses", "poses.xyz")),
        (
            "--poses: views of the kind random depend on the plants",
            (*RANDOM, "--poses", "p.csv", "--no-probe"),
        ),
        ("--workers: must be between 1 and", ("--workers", "0")),
        ("views.pitch_deg", ("--set", "views.pitch_deg=120")),
        ("camera.baseline_mm", ("--outputs", "stereo")),
        ("is not a folder", ("--drawing", "pyproject/plan.png")),
    ],
)
def test_bad_input_gives_one_sentence_and_no_file(rejects, here, message, arguments):
    (here / "pyproject").write_text("a file", encoding="utf-8")
    rejects(message, *DRY, "--drawing", "plan.png", *arguments)
    assert [path.name for path in here.iterdir()] == ["pyproject"]


def test_options_of_a_dry_run_need_one(rejects, here):
    for option in ("--drawing=plan.png", "--poses=poses.csv", "--no-probe"):
        name = option.partition("=")[0]
        rejects(f"{name}: applies only with --dry-run", "build", "demo", "--out", "set", option)
    rejects("--out: is required without --dry-run", "build", "demo")
    assert list(here.iterdir()) == []


@pytest.mark.slow
def test_mitsuba_is_not_imported_without_a_probe(here):
    words = ["pepperscene", "build", "barth2018", "--dry-run", "--no-probe", "--poses", "poses.json"]
    code = (
        "import sys\nfrom pepperscene.cli import main\n"
        f"sys.argv = {words}\n"
        "try: main()\nexcept SystemExit as end: assert not end.code\n"
        "print(sorted({'mitsuba', 'drjit', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_build_says_how_many_frames_a_recipe_selects(command, tmp_path):
    selected = (*SMALL, *LABELS, "--set", "plan.select=[1, 2]")
    lines = command("build", "barth2018", "--out", tmp_path / "set", *selected).stderr.splitlines()
    assert lines[0] == "note: 2 of 4 frames selected"
    assert [line.split()[:2] for line in lines[1:]] == [["frame", "000001"], ["frame", "000002"]]
    # Named frames and JSON need no note.
    for more in (("--frames", "1:3"), ("--set", "plan.select=[1, 2]", "--json")):
        result = command("build", "barth2018", "--out", tmp_path / more[0], *SMALL, *LABELS, *more)
        assert "selected" not in result.stderr + result.stdout
