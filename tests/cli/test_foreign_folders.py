"""The current folder is a stranger's: modules, plugins and settings that it holds are not used."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import pepperscene
from pepperscene.bench.measure import measure_variant
from pepperscene.cli import datasets
from pepperscene.errors import SetupError
from pepperscene.render import doctor
from pepperscene.render.variant import llvm_version, mitsuba_modules

MODULES = (
    "PIL", "_typing", "antigravity", "colour", "ctypes", "dask", "drjit", "json", "lazy_loader", "matplotlib",
    "mitsuba", "numba", "numpy", "pepperscene", "pyarrow", "pydantic", "pyoidn", "rerun", "rich", "scipy",
    "sitecustomize", "tomlkit", "torch", "trimesh", "typer", "usercustomize", "yaml",
)  # fmt: skip
INSTALLED = (sys.executable, "-P", "-c", "from pepperscene.__main__ import main; main()")
"""As the installed program `pepperscene`, whose search path begins with the folder of the program."""
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(pepperscene.__file__).parents[1])}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a module of each name that leaves a file, and a package likewise."""
    trap = f"open({str(tmp_path / 'marker')!r}, 'a').close()\n"
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(trap)
    (tmp_path / "distributed").mkdir()
    (tmp_path / "distributed" / "__init__.py").write_text(trap)
    (tmp_path / "evil.pth").write_text(f"import os; {trap}")
    (tmp_path / "pyvenv.cfg").write_text("home = .\n")
    monkeypatch.chdir(tmp_path)
    # `python -m pytest` puts its first folder in place of the current one.
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    monkeypatch.setenv("PYTHONPATH", ENVIRONMENT["PYTHONPATH"])
    return tmp_path


def ran(folder):
    return (folder / "marker").exists()


def test_doctor_runs_no_module_and_no_plugin_of_the_folder(folder):
    """Mitsuba would look for its plugins in the current folder first."""
    (folder / "plugins").mkdir()
    for name in ("diffuse", "sphere", "constant", "perspective", "path", "independent"):
        (folder / "plugins" / f"{name}.so").write_bytes(b"not a library")
    result = subprocess.run([*INSTALLED, "doctor"], env=ENVIRONMENT, capture_output=True, text=True)
    assert not ran(folder)
    assert result.returncode == 0, result.stdout
    assert "This machine can render." in result.stdout


def test_mitsuba_has_no_plugin_folder_but_its_own(folder):
    """Also in another thread."""
    mi = mitsuba_modules()[0]
    resolver = mi.file_resolver()
    folders = [Path(str(resolver[number])) for number in range(len(resolver))]
    assert folders == [Path(mi.__file__).parent]


def test_python_m_takes_the_folder_off_the_search_path(folder):
    """The package itself and what its `__init__` imports come before that."""
    for name in ("pepperscene", "lazy_loader"):
        (folder / f"{name}.py").unlink()
    command = [sys.executable, "-m", "pepperscene", "recipes"]
    result = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "barth2018" in result.stdout
    assert not ran(folder)


def test_the_viewer_is_not_taken_from_the_folder(folder, monkeypatch):
    monkeypatch.setattr("pepperscene.export.export_dataset", lambda *_args, **_kwargs: None)
    with suppress(SetupError):
        datasets._view_in_rerun(folder, None)
    assert not ran(folder)


def test_the_question_for_the_version_of_llvm_runs_no_module_of_the_folder(folder):
    (folder / "libunknown.so").write_bytes(b"not a library")
    assert llvm_version(folder / "libunknown.so") is None
    assert not ran(folder)


def test_benchmarks_and_checks_of_the_installation_run_no_module_of_the_folder(folder, tmp_path):
    assert doctor._run_child("import ctypes, json, antigravity_is_missing").code == 1
    with pytest.raises(SetupError, match="no_scene"):
        measure_variant("llvm_ad_spectral", "no_scene", (8, 6), 1, tmp_path)
    assert not ran(folder)


@pytest.mark.parametrize("name", ["matplotlibrc", ".numba_config.yaml"])
def test_settings_of_libraries_in_the_folder_are_refused(folder, rejects, name):
    """Matplotlib can start TeX, and Numba loads compiled code from a folder that its settings name."""
    (folder / name).write_text("text.usetex: True\n" if name == "matplotlibrc" else "cache_dir: here\n")
    for arguments in (
        ("build", "demo", "--dry-run", "--no-probe", "--drawing", "plan.png"),
        ("recipes",),
        ("check", "."),
    ):
        rejects(f"{name}: is in the current folder, where ", *arguments)
    assert not (folder / "plan.png").exists()
    assert not (folder / "here").exists()
