"""The wheel in an environment of its own, without the checkout: a first use, in an empty folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Callable
from pathlib import Path

import pytest

from pepperscene.version import __version__

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., subprocess.CompletedProcess[str]]

_WITHOUT_EXTRA = "import sys; sys.modules['rerun'] = None\n"
"""Line of a .pth file that makes an environment one without the extra `rerun`."""


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment that holds the wheel, and sees the dependencies of this one."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=os.name != "nt")
    scheme = {"base": str(folder), "platbase": str(folder)}
    packages = Path(sysconfig.get_path("purelib", "venv", scheme))
    # The files of this line's folder that name further folders, such as the checkout, are not read.
    (packages / "dependencies.pth").write_text(f"{sysconfig.get_path('purelib')}\n", encoding="utf-8")
    (packages / "without_extra.pth").write_text(_WITHOUT_EXTRA, encoding="utf-8")
    scripts = Path(sysconfig.get_path("scripts", "venv", scheme))
    command = (
        sys.executable, "-m", "pip", "--python", str(scripts / "python"), "--disable-pip-version-check",
        "install", "--quiet", "--no-index", "--no-deps", "--ignore-installed", str(wheel),
    )  # fmt: skip
    done = subprocess.run(
        command, env=_clean_environment(scripts), capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return scripts


def _clean_environment(scripts: Path) -> dict[str, str]:
    """Environment variables without those that lead to the checkout."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return {**kept, "PATH": os.pathsep.join((str(scripts), os.environ["PATH"])), "PEPPERSCENE_PROCESSES": "1"}


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which all commands run."""
    return tmp_path_factory.mktemp("empty")


@pytest.fixture(scope="module")
def run(environment: Path, empty: Path) -> Run:
    """Run a program of the environment in the empty folder."""

    def in_environment(program: str, *arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [str(environment / program), *arguments],
            cwd=empty,
            env=_clean_environment(environment),
            capture_output=True,
            text=True,
            timeout=600,
        )
        assert done.returncode == code, done.stdout + done.stderr
        # The libraries are those of the tests, which may be installed in a folder of the checkout.
        assert str(ROOT / "src") not in done.stdout + done.stderr
        return done

    return in_environment


@pytest.fixture(scope="module")
def data_set(run: Run) -> str:
    """Name of a data set of one small frame."""
    one_plant = ("--set", "row={plants_front=1, plants_back=0}")
    small = ("--set", "camera.width=160", "--set", "camera.height=120")
    outputs = ("--outputs", "colour,class,instance,harvest")
    run("pepperscene", "build", "demo", "--out", "set", "--frames", "0:1", "--quality", "draft",
        *outputs, *one_plant, *small)  # fmt: skip
    return "set"


def test_nothing_comes_from_the_checkout(run: Run, environment: Path) -> None:
    lines = "import json, sys, pepperscene; print(json.dumps([pepperscene.__file__, *sys.path]))"
    file, *paths = json.loads(run("python", "-c", lines).stdout)
    assert Path(file).is_relative_to(environment.parent)
    assert not [path for path in paths if path and Path(path) == ROOT / "src"]
    assert run("pepperscene", "--version").stdout == f"pepperscene {__version__}\n"


def test_the_installation_is_complete(run: Run) -> None:
    assert __version__ in run("pepperscene", "doctor").stdout
    for command, folder in (("recipes", "recipes"), ("cultivars", "plants")):
        names = run("pepperscene", command).stdout
        assert "demo" in names or "kaite" in names
        assert len(names.splitlines()) >= len(list((ROOT / folder).glob("*.toml")))


def test_a_data_set_is_built_checked_and_reported(run: Run, data_set: str, empty: Path) -> None:
    assert "1 frame, no faults" in run("pepperscene", "check", data_set).stdout
    run("pepperscene", "report", data_set)
    page = (empty / data_set / "index.html").read_text(encoding="utf-8")
    assert "<script" in page
    assert "demo" in page
    lines = (
        "from pepperscene import open_dataset\n"
        f"data = open_dataset({data_set!r})\n"
        "print(data.image(0, 'colour').shape, sorted(set(data.image(0, 'class').flat))[:1])\n"
    )
    assert run("python", "-c", lines).stdout.startswith("(120, 160, 3)")


def test_a_data_set_is_exported(run: Run, data_set: str, empty: Path) -> None:
    run("pepperscene", "export", data_set, "--format", "semantic", "--out", "masks")
    assert len(list((empty / "masks").rglob("*.png"))) == 2
    pytest.importorskip("pycocotools")
    run("pepperscene", "export", data_set, "--format", "coco", "--out", "coco")
    file = empty / "coco" / "annotations" / "instances_train.json"
    annotations = json.loads(file.read_text(encoding="utf-8"))
    assert len(annotations["images"]) == 1
    assert annotations["annotations"]


def test_a_missing_extra_is_one_sentence(run: Run, data_set: str) -> None:
    done = run("pepperscene", "view", data_set, "--program", "rerun", code=2)
    assert "pip install 'pepperscene[rerun]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr
