"""`pepperscene doctor` reports problems in plain words, even if native libraries abort."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pepperscene.render.doctor import Check, Diagnosis, diagnose
from pepperscene.render.variant import LLVM_VARIABLE, OLDEST_LLVM


def line_of(diagnosis: Diagnosis, what: str) -> Check:
    (line,) = [line for line in diagnosis.lines if line.what == what]
    return line


def test_this_machine_passes_all_checks():
    diagnosis = diagnose()
    assert diagnosis.healthy, [line for line in diagnosis.lines if not line.good]
    assert line_of(diagnosis, "variant").found.endswith("_ad_spectral")
    assert not any(line.advice for line in diagnosis.lines)


def test_invalid_llvm_file_is_reported_and_not_loaded(monkeypatch, tmp_path):
    library = tmp_path / "libLLVM.so"
    library.write_bytes(b"this is no library")
    monkeypatch.setenv(LLVM_VARIABLE, str(library))
    diagnosis = diagnose(test_code="raise SystemExit('must not run')")
    assert not diagnosis.healthy
    llvm = line_of(diagnosis, "LLVM")
    assert str(library) in llvm.found
    assert LLVM_VARIABLE in llvm.advice
    assert line_of(diagnosis, "test render").found == "skipped"


def test_old_llvm_is_rejected_by_its_file_name(monkeypatch, tmp_path):
    library = tmp_path / f"libLLVM-{OLDEST_LLVM - 1}.so.1"
    library.touch()
    monkeypatch.setenv(LLVM_VARIABLE, str(library))
    llvm = line_of(diagnose(), "LLVM")
    assert not llvm.good
    assert f"version {OLDEST_LLVM - 1}" in llvm.found


def test_crash_of_the_test_render_is_reported():
    code = (
        "import os, sys\n"
        'print(\'{"variant": "llvm_ad_spectral"}\', flush=True)\n'
        "print('LLVM ERROR: Cannot select', file=sys.stderr, flush=True)\n"
        "os.abort()\n"
    )
    diagnosis = diagnose(test_code=code)
    render = line_of(diagnosis, "test render")
    assert not diagnosis.healthy
    assert "crashed (SIGABRT)" in render.found
    assert "LLVM ERROR: Cannot select" in render.found
    assert render.advice
    # Results printed before the crash are kept.
    assert line_of(diagnosis, "variant").found == "llvm_ad_spectral"


def test_hanging_test_render_is_killed_and_reported():
    diagnosis = diagnose(test_code="import time; time.sleep(60)", time_limit_s=0.5)
    assert not diagnosis.healthy
    assert "no answer" in line_of(diagnosis, "variant").found


def test_a_process_that_cannot_start_is_reported_as_such(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "missing"))
    diagnosis = diagnose()
    assert not diagnosis.healthy
    for what in ("variant", "denoiser"):
        line = line_of(diagnosis, what)
        assert "could not run, because of: No such file" in line.found
        assert "memory" in line.advice
        assert "LLVM" not in line.advice


def test_a_lack_of_memory_is_not_reported_as_a_wrong_library():
    variant = line_of(diagnose(test_code="raise MemoryError"), "variant")
    assert "MemoryError" in variant.found
    assert "LLVM" not in variant.advice


@pytest.mark.parametrize(
    ("backend", "has_gpu", "furnace", "found"),
    [
        ("llvm", "false", 0.9, "no usable CUDA GPU; using the CPU"),
        ("llvm", "true", 0.5, "CUDA, not in use; PEPPERSCENE_VARIANT=cuda_ad_spectral renders with it"),
        ("cuda", "true", 0.5, "CUDA, in use"),
    ],
)
def test_a_wrong_image_and_a_gpu_are_reported(backend, has_gpu, furnace, found):
    code = f'print(\'{{"variant": "{backend}_ad_spectral", "cuda": {has_gpu}, "furnace": {furnace}}}\')'
    diagnosis = diagnose(test_code=code)
    gpu = line_of(diagnosis, "GPU")
    assert gpu.good
    assert gpu.found == found
    assert line_of(diagnosis, "test render").good == (furnace == 0.5)


def test_missing_variant_is_reported_with_advice(monkeypatch):
    # An unsupported variant simulates a machine without any.
    monkeypatch.setenv("PEPPERSCENE_VARIANT", "scalar_rgb")
    variant = line_of(diagnose(), "variant")
    assert not variant.good
    assert "scalar_rgb" in variant.advice


@pytest.mark.long
def test_command_reports_problems_and_exits_with_2(tmp_path):
    library = tmp_path / "libLLVM-15.so"
    library.touch()
    process = subprocess.run(
        [sys.executable, "-m", "pepperscene", "doctor"],
        env={**os.environ, LLVM_VARIABLE: str(library)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 2
    assert str(library) in process.stdout
    assert "Traceback" not in process.stdout + process.stderr
