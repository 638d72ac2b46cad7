"""Choice of LLVM and of the variant, and the errors if there is none; empty files replace libraries."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path

import pytest

from pepperscene.errors import SetupError
from pepperscene.render import variant
from pepperscene.render.variant import (
    LLVM_VARIABLE,
    OLDEST_LLVM,
    LlvmExaminationError,
    choose_variant,
    find_llvm,
    llvm_version,
)

VARIANT_VARIABLE = "PEPPERSCENE_VARIANT"


@pytest.fixture(autouse=True)
def bare_machine(monkeypatch, tmp_path):
    """A machine whose only library folder is `tmp_path`; environment changes are undone afterwards."""
    for name in (LLVM_VARIABLE, VARIANT_VARIABLE):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(variant, "_LLVM_PACKAGE", "no-such-package")
    monkeypatch.setattr(variant, "_SYSTEM_FOLDERS", (str(tmp_path),))


def library(folder: Path, name: str) -> Path:
    path = folder / name
    path.touch()
    return path


@pytest.fixture
def backends(monkeypatch):
    """The machine's backends; a set that tests change."""
    present = {"llvm"}

    def can_run(name, library):
        return name.split("_")[0] in present and (library is not None or name.startswith("cuda"))

    monkeypatch.setattr(variant, "_can_run", can_run)
    return present


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", 15),
        ("libLLVM.so.23.1", 23),
        ("libLLVM-19.1.so", 19),
        ("libLLVM.20.dylib", 20),
        ("libLLVM-14.0.6.so", 14),
    ],
)
def test_version_from_the_file_name(tmp_path, name, version):
    assert llvm_version(library(tmp_path, name)) == version


def test_version_of_a_link_is_that_of_its_target(tmp_path):
    (tmp_path / "libLLVM.so").symlink_to(library(tmp_path, "libLLVM.so.23.1"))
    (tmp_path / "libLLVM-99.so").symlink_to(library(tmp_path, "libLLVM-15.so.1"))
    assert llvm_version(tmp_path / "libLLVM.so") == 23
    assert llvm_version(tmp_path / "libLLVM-99.so") == 15


def test_version_from_a_child_process_if_the_name_has_none(monkeypatch, tmp_path):
    assert llvm_version(library(tmp_path, "libLLVM.so")) is None  # an empty file
    for code, version in (("print(21)", 21), ("print('?')", None), ("raise OSError", None)):
        monkeypatch.setattr(variant, "_PRINT_LLVM_VERSION", code)
        assert llvm_version(library(tmp_path, "compiler.so")) == version


def python_with(monkeypatch, tmp_path, limit):
    """Child processes of this test run under a limit of the shell."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\n{limit}\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))


@pytest.mark.skipif(sys.platform != "linux", reason="address space is limited on Linux only")
def test_a_version_that_could_not_be_asked_for_is_not_reported_as_old(monkeypatch, tmp_path):
    compiler = library(tmp_path, "libLLVM.so")
    python_with(monkeypatch, tmp_path, "ulimit -v 8000")
    with pytest.raises(LlvmExaminationError, match=r"could not run, because of: ."):
        llvm_version(compiler)
    # Found in the system's folders: none to use, and the cause is the message.
    assert find_llvm() is None
    with pytest.raises(SetupError, match=r"could not run, because of: .") as error:
        choose_variant("llvm_ad_spectral")
    assert "or newer" not in str(error.value)
    monkeypatch.setenv(LLVM_VARIABLE, str(compiler))
    with pytest.raises(LlvmExaminationError, match="could not run"):
        find_llvm()


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise MemoryError", "MemoryError"),
        ("import os; os._exit(3)", "exit code 3"),
        ("raise OSError('x.so: failed to map segment from shared object')", "failed to map segment"),
        ("while True: pass", "did not end within 0.5 s"),
    ],
)
def test_reasons_of_an_unknown_version(monkeypatch, tmp_path, code, reason):
    monkeypatch.setattr(variant, "_PRINT_LLVM_VERSION", code)
    monkeypatch.setattr(variant, "_TIME_LIMIT_S", 0.5)
    with pytest.raises(LlvmExaminationError, match=reason):
        llvm_version(library(tmp_path, "compiler.so"))


def test_a_library_that_cannot_be_examined_does_not_hide_another(monkeypatch, tmp_path):
    monkeypatch.setattr(variant, "_PRINT_LLVM_VERSION", "raise MemoryError")
    library(tmp_path, "libLLVM.so")
    assert find_llvm() is None
    usable = library(tmp_path, "libLLVM.so.20.1")
    assert find_llvm() == usable


def test_finds_the_newest_library_of_the_system_and_none_that_aborts(tmp_path):
    for name in ("libLLVM-14.so.1", "libLLVM-9.so", "libLLVM-16.so", "libLLVM-21.a"):
        library(tmp_path, name)
    assert find_llvm() is None
    for name in ("libLLVM.so.18.1", "libLLVM.so.20.1"):
        library(tmp_path, name)
    assert find_llvm() == tmp_path / "libLLVM.so.20.1"


def test_environment_precedes_the_package_which_precedes_the_system(monkeypatch, tmp_path):
    library(tmp_path, "libLLVM.so.30.1")
    packaged = library(tmp_path, "libLLVM.so.23.1")
    monkeypatch.setattr(variant, "_packaged_libraries", lambda: [packaged])
    assert find_llvm() == packaged
    named = library(tmp_path, "libLLVM.so.17.1")
    monkeypatch.setenv(LLVM_VARIABLE, str(named))
    assert find_llvm() == named


@pytest.mark.parametrize("is_folder", [False, True])
def test_raises_on_a_missing_library_in_the_environment(monkeypatch, tmp_path, is_folder):
    library(tmp_path, "libLLVM.so.23.1")
    missing = tmp_path if is_folder else tmp_path / "libLLVM.so.22"
    monkeypatch.setenv(LLVM_VARIABLE, str(missing))
    with pytest.raises(SetupError, match="no such file") as error:
        find_llvm()
    assert LLVM_VARIABLE in str(error.value)
    assert str(missing) in str(error.value)
    with pytest.raises(SetupError, match="no such file"):
        choose_variant()


@pytest.mark.parametrize(
    ("name", "version"),
    [("libLLVM-15.so.1", "version 15"), ("x.so", "unknown version")],
)
def test_raises_on_an_unsuitable_library_in_the_environment(monkeypatch, tmp_path, name, version):
    monkeypatch.setenv(LLVM_VARIABLE, str(library(tmp_path, name)))
    with pytest.raises(SetupError, match=version):
        find_llvm()


@pytest.mark.parametrize("wanted", ["scalar_rgb", "LLVM_AD_SPECTRAL"])
def test_raises_on_an_unsupported_variant(monkeypatch, backends, wanted):
    allowed = "llvm_ad_spectral, cuda_ad_spectral"
    with pytest.raises(SetupError, match=allowed) as error:
        choose_variant(wanted)
    assert repr(wanted) in str(error.value)
    monkeypatch.setenv(VARIANT_VARIABLE, wanted)
    with pytest.raises(SetupError, match=allowed):
        choose_variant()


def test_a_gpu_is_used_on_request_only(monkeypatch, backends, tmp_path):
    chosen = library(tmp_path, "libLLVM.so.23.1")
    with pytest.raises(SetupError, match="CUDA GPU"):
        choose_variant("cuda_ad_spectral")
    backends.add("cuda")
    assert choose_variant() == "llvm_ad_spectral"
    assert os.environ[LLVM_VARIABLE] == str(chosen)
    assert choose_variant("cuda_ad_spectral") == "cuda_ad_spectral"
    monkeypatch.setenv(VARIANT_VARIABLE, "cuda_ad_spectral")
    assert choose_variant() == "cuda_ad_spectral"
    assert choose_variant("llvm_ad_spectral") == "llvm_ad_spectral"
    # Without LLVM the message says how to use the GPU; it is not chosen silently.
    (tmp_path / "libLLVM.so.23.1").unlink()
    monkeypatch.delenv(VARIANT_VARIABLE)
    monkeypatch.delenv(LLVM_VARIABLE)
    with pytest.raises(SetupError, match="PEPPERSCENE_VARIANT=cuda_ad_spectral"):
        choose_variant()


def test_error_without_a_library_says_what_to_install(monkeypatch, backends):
    monkeypatch.setattr(variant, "_LLVM_PACKAGE", "karellen-llvm-core")
    monkeypatch.setattr(variant, "_packaged_libraries", list)
    with pytest.raises(SetupError, match=r"pip install karellen-llvm-core") as error:
        choose_variant()
    assert f"LLVM {OLDEST_LLVM} or newer" in str(error.value)
    assert LLVM_VARIABLE in str(error.value)


def test_raises_if_drjit_already_loaded_an_older_llvm(monkeypatch, tmp_path):
    # As when a caller imported Dr.Jit first, which loaded the system's library.
    class Detail:
        @staticmethod
        def llvm_version():
            return (15, 0, 7)

    class FakeDrJit:
        JitBackend = type("JitBackend", (), {"LLVM": 1, "CUDA": 2})
        detail = Detail
        loaded = True

        @classmethod
        def has_backend(cls, backend):
            return backend == 1 and cls.loaded

    library(tmp_path, "libLLVM.so.23.1")
    monkeypatch.setitem(sys.modules, "drjit", FakeDrJit)
    with pytest.raises(SetupError, match="LLVM 15"):
        choose_variant()
    monkeypatch.setattr(Detail, "llvm_version", staticmethod(lambda: (23, 1, 0)))
    assert choose_variant() == "llvm_ad_spectral"
    monkeypatch.setattr(FakeDrJit, "loaded", False)
    with pytest.raises(SetupError, match=r"Dr\.Jit cannot load the LLVM library '.*23\.1'"):
        choose_variant()


def test_failed_start_raises_again_on_the_next_call(monkeypatch):
    def fail(wanted=None):
        raise SetupError("there is none")

    monkeypatch.setattr(variant, "choose_variant", fail)
    start = functools.cache(variant.mitsuba_modules.__wrapped__)
    for _ in range(2):
        with pytest.raises(SetupError, match="there is none"):
            start()
