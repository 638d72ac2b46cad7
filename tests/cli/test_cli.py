"""The command line: imports, listings, plants, builds, reports, errors and exit codes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import types
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import pepperscene
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import EXIT_BAD_INPUT
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.shipped import shipped_folder
from pepperscene.version import __version__

HEAVY = {"mitsuba", "drjit", "colour", "scipy", "trimesh", "skimage", "OpenEXR", "PIL", "torch", "matplotlib"}
ONE_PLANT = ("--set", "row={plants_front=1, plants_back=0}")


def test_public_names_exist_and_hide_no_package():
    stub = Path(pepperscene.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    listed = set(re.findall(r" as (\w+)$", stub, re.MULTILINE))
    assert set(pepperscene.__all__) == listed <= set(dir(pepperscene))
    for name in listed:
        assert not isinstance(getattr(pepperscene, name), types.ModuleType), name
    # A function of the same name as a package would be replaced when the package is imported.
    packages = {path.parent.name for path in Path(pepperscene.__file__).parent.glob("*/__init__.py")}
    assert not packages & listed
    with pytest.raises(AttributeError, match="nonsense"):
        pepperscene.nonsense  # noqa: B018


def test_imports_help_and_public_names_are_light():
    code = (
        "import sys, pepperscene\n"
        "def loaded(*names): print(*sorted({*names} & {*sys.modules}), flush=True)\n"
        f"loaded(*{HEAVY}, 'numpy', 'pydantic')\n"
        "from pepperscene.cli import main\nsys.argv = ['pepperscene', '--help']\n"
        "try: main()\nexcept SystemExit as end: assert not end.code\n"
        f"loaded(*{HEAVY})\n"
        "for name in pepperscene.__all__: getattr(pepperscene, name)\n"
        "loaded('mitsuba', 'drjit')"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    first, *_, second, third = result.stdout.splitlines()
    assert (first, second, third) == ("", "", "")


def test_python_dash_m_prints_the_version():
    text = subprocess.check_output([sys.executable, "-m", "pepperscene", "--version"], text=True)
    assert text == f"pepperscene {__version__}\n"


def test_shipped_recipes_and_cultivars_are_listed(command):
    for name, folder, line, parts in (
        ("recipes", "recipes", "barth2018", ["10,500 frames"]),
        ("cultivars", "plants", "kaite", ["Capsicum annuum", "40 nodes"]),
    ):
        lines = command(name).stdout.splitlines()
        names = [path.stem for path in sorted(shipped_folder(folder).glob("*.toml"))]
        assert [one.split()[0] for one in lines] == names
        assert all(part in lines[names.index(line)] for part in parts)


@pytest.mark.long
def test_plant_writes_a_mesh_and_a_picture(command, tmp_path):
    out = tmp_path / "new" / "plant.glb"
    result = command("plant", "kaite_february", "--seed", 3, "--out", out, "--detail", 0.4)
    assert result.exit_code == 0, result.stderr
    assert result.stdout.splitlines()[-2:] == [str(out), str(out.with_suffix(".png"))]
    assert {path.name for path in out.parent.iterdir()} == {"plant.glb", "plant.png"}
    with Image.open(out.with_suffix(".png")) as picture:
        assert picture.mode == "RGB"
    # The printed numbers are those of the file.
    read = trimesh.load_scene(out)
    kinds = Counter(name.rsplit("_", 3)[0] for name in read.geometry)
    printed = dict(
        line.split()[::-1]
        for line in result.stdout.splitlines()
        if line.startswith("  ") and len(line.split()) == 2
    )
    assert {kind: int(count) for kind, count in printed.items()} == kinds
    assert kinds["node"] == load_cultivar("kaite_february").stem.parts
    assert f"{sum(kinds.values())} organs" in result.stdout
    assert f"{sum(len(one.faces) for one in read.geometry.values()):,} triangles" in result.stdout
    assert "fruit still touch" in result.stdout


def test_build_then_report(command, tmp_path):
    arguments = ("build", "--out", tmp_path / "set", "--frames", "6137:6138", *ONE_PLANT)
    result = command(*arguments, "--outputs", "class,distance")
    assert result.exit_code == 0, result.stderr
    assert "006137" in result.stderr
    assert "1 frame built" in result.stdout
    assert (tmp_path / "set" / "class" / "006137.png").is_file()
    again = command(*arguments, "--outputs", "distance,class")
    assert "0 frames built, 1 already there" in again.stdout
    result = command("report", tmp_path / "set")
    assert result.exit_code == 0
    assert "1 of 1 frames shown" in result.stdout
    assert (tmp_path / "set" / "index.html").is_file()


def test_render_prints_the_written_files(command, tmp_path):
    arguments = ("render", "demo", "--out", tmp_path / "one", "--outputs", "distance,class,raw", *ONE_PLANT)
    result = command(*arguments, "--set", "camera.flash=none", "--set", "developing.white_balance=daylight")
    assert result.exit_code == 0, result.stderr
    names = ["raw.png", "class.png", "distance.exr", "frame.json"]
    assert result.stdout.splitlines() == [str(tmp_path / "one" / name) for name in names]
    metadata = json.loads((tmp_path / "one" / "frame.json").read_text())
    assert metadata["index"] == min(load_recipe("demo").plan.select)
    assert metadata["camera"]["flash"] is None
    assert metadata["recipe"]["row"]["plants_back"] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("render", "--out", "one", "--outputs", "smell"), "'smell'"),
        (("render", "--out", "one", "--frame", "10500"), "--frame"),
        (("render", "--out", "/dev/null/one"), "/dev/null"),
        (("render", "--out", "one", "--set", "camera.sensor=pinhole"), "--set: camera.sensor = 'pinhole': "),
        (("render", "--out", "one", "--set", "camera"), "KEY=VALUE"),
        (("build", "--out", "set", "--set", "camera.gain=-1"), "--set: camera.gain = -1: must be"),
        (("build", "nothing", "--out", "set"), "barth2018, barth2018_robot, demo"),
        (("build", "--out", "set", "--outputs", ","), "at least one output"),
        (("build", "--out", "set", "--frames", "7"), "A:B"),
        (("build", "--out", "set", "--quality", "best"), "draft, standard, reference"),
        (("build", "--out", "set", "--seed", "-3"), "--seed"),
        (("build", "--out", "/dev/null/set", "--frames", "0:1"), "/dev/null"),
        (("report", "set"), "no data set"),
        (("plant", "nothing", "--out", "a.glb"), "kaite"),
        (("plant", "kaite", "--out", "a.fbx"), "must end in .glb, .obj, .ply or .stl"),
        (("plant", "kaite", "--out", "q" * 400 + ".glb"), "cannot be"),
        (("plant", "kaite", "--out", "a.glb", "--seed", "-1"), "--seed"),
        (("plant", "kaite", "--out", "a.glb", "--detail", "nan"), "--detail"),
        (("plant", "kaite", "--out", "a.glb", "--share", "0.5"), "--share: needs `until`"),
        (("scene", "--out", "a.obj"), "must end in .glb, .usd, .usda, .usdc or .sdf"),
        (("scene", "--out", "a.glb", "--frame", "10500"), "--frame"),
        (("scene", "nothing", "--out", "a.glb"), "barth2018, barth2018_robot, demo"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(rejects, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    rejects(message, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_usage_errors_have_exit_code_2(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in (
        "build",
        "render --out x --frame x",
        "build --out",
        "plant kaite",
        "plant --out a.glb",
        "nonsense",
    ):
        result = command(*words.split())
        assert result.exit_code == EXIT_BAD_INPUT
        assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_plants_of_the_same_seed_and_stage_are_the_same_file(command, tmp_path):
    """A stage that is interpolated with itself is the same, apart from rounding."""
    files, sizes = [], []
    for more in ((), ("--until", "kaite_february", "--share", 0.3), ("--seed", 1), ()):
        arguments = (
            "plant",
            "kaite_february",
            "--out",
            tmp_path / "plant.obj",
            "--detail",
            0.3,
            "--no-picture",
        )
        assert command(*arguments, *more).exit_code == 0
        files.append({path.name: path.read_bytes() for path in tmp_path.iterdir()})
        lines = (tmp_path / "plant.obj").read_text().splitlines()
        sizes.append(
            np.ptp([list(map(float, line.split()[1:4])) for line in lines if line[:2] == "v "], axis=0)
        )
    assert set(files[0]) == {"plant.obj", "plant.mtl"}
    assert files[0] == files[3] != files[2]
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=1e-4)


def test_interrupt_gives_one_line_and_exit_code_130(command, tmp_path, monkeypatch):
    def interrupt(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["pepperscene.building.execution.build"], "build", interrupt)
    result = command("build", "--out", tmp_path / "set")
    assert result.exit_code == 130
    assert "interrupted" in result.stderr


@pytest.mark.parametrize("healthy", [True, False])
def test_doctor_prints_findings(command, monkeypatch, healthy):
    from pepperscene.render import doctor

    check = doctor.Check("LLVM", "version 7", healthy, "" if healthy else "install a newer one")
    monkeypatch.setattr(doctor, "diagnose", lambda: doctor.Diagnosis((check,)))
    result = command("doctor")
    assert result.exit_code == (0 if healthy else EXIT_BAD_INPUT)
    assert "version 7" in result.stdout
    assert ("install a newer one" in result.stdout) is not healthy
