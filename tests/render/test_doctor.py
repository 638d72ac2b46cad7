"""The doctor tells what is wrong in words, whatever the native libraries do."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pepperscene.render.doctor import Check, Diagnosis, diagnose
from pepperscene.render.variant import LLVM_VARIABLE, OLDEST_LLVM


def _line(diagnosis: Diagnosis, what: str) -> Check:
    (line,) = [line for line in diagnosis.lines if line.what == what]
    return line


def _child(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


def test_this_machine_is_healthy() -> None:
    diagnosis = diagnose()
    assert diagnosis.healthy, [line for line in diagnosis.lines if not line.good]
    assert _line(diagnosis, "variant").found.endswith("_ad_spectral")
    assert not any(line.advice for line in diagnosis.lines)


def test_a_file_that_is_no_library_is_named_and_not_loaded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"this is no library")
    monkeypatch.setenv(LLVM_VARIABLE, str(fake))
    diagnosis = diagnose(smoke_command=_child("raise SystemExit('must not be run')"))
    assert not diagnosis.healthy
    llvm = _line(diagnosis, "LLVM")
    assert str(fake) in llvm.found
    assert LLVM_VARIABLE in llvm.advice
    assert _line(diagnosis, "smoke render").found == "not tried"


@pytest.mark.parametrize("version", [14, 15, OLDEST_LLVM - 1])
def test_an_llvm_known_to_abort_is_refused_by_its_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, version: int
) -> None:
    fake = tmp_path / f"libLLVM-{version}.so.1"
    fake.touch()
    monkeypatch.setenv(LLVM_VARIABLE, str(fake))
    llvm = _line(diagnose(), "LLVM")
    assert not llvm.good
    assert f"version {version}" in llvm.found


def test_a_crash_of_the_smoke_render_becomes_a_message() -> None:
    dying = (
        "import os, sys\n"
        'print(\'{"variant": "llvm_ad_spectral"}\', flush=True)\n'
        "print('LLVM ERROR: Cannot select', file=sys.stderr, flush=True)\n"
        "os.abort()\n"
    )
    diagnosis = diagnose(smoke_command=_child(dying))
    smoke = _line(diagnosis, "smoke render")
    assert not diagnosis.healthy
    assert "crashed (SIGABRT)" in smoke.found
    assert "LLVM ERROR: Cannot select" in smoke.found
    assert smoke.advice
    # What the child said before its end is kept.
    assert _line(diagnosis, "variant").found == "llvm_ad_spectral"


def test_a_crash_before_a_variant_is_chosen_becomes_a_message() -> None:
    diagnosis = diagnose(smoke_command=_child("import os; os.abort()"))
    variant = _line(diagnosis, "variant")
    assert not variant.good
    assert "SIGABRT" in variant.found


def test_a_smoke_render_that_hangs_is_given_up() -> None:
    diagnosis = diagnose(smoke_command=_child("import time; time.sleep(60)"), limit_s=0.5)
    assert not diagnosis.healthy
    assert "no answer" in _line(diagnosis, "variant").found


def test_a_wrong_picture_is_not_healthy() -> None:
    report = '{"variant": "llvm_ad_spectral", "cuda": false, "furnace": 0.9}'
    diagnosis = diagnose(smoke_command=_child(f"print('{report}')"))
    assert not diagnosis.healthy
    assert not _line(diagnosis, "smoke render").good


def test_no_usable_variant_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    # A variant that this machine lacks stands for a machine without any.
    monkeypatch.setenv("PEPPERSCENE_VARIANT", "scalar_rgb")
    variant = _line(diagnose(), "variant")
    assert not variant.good
    assert "scalar_rgb" in variant.advice


def test_the_command_tells_the_fault_and_leaves_with_exit_code_2(tmp_path: Path) -> None:
    fake = tmp_path / "libLLVM-15.so"
    fake.touch()
    done = subprocess.run(
        [sys.executable, "-m", "pepperscene", "doctor"],
        env={**os.environ, LLVM_VARIABLE: str(fake)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert str(fake) in done.stdout
    assert "Traceback" not in done.stdout + done.stderr
