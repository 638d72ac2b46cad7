"""Which LLVM is taken, and what is said where none will do; fakes stand for other machines."""

from __future__ import annotations

import functools
import os
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from pepperscene.errors import SetupError
from pepperscene.render import variant
from pepperscene.render.variant import LLVM_VARIABLE, OLDEST_LLVM, choose_variant, find_llvm, llvm_version

WANTED = "PEPPERSCENE_VARIANT"


@pytest.fixture(autouse=True)
def bare_machine(monkeypatch, tmp_path):
    """A machine whose only library folder is `tmp_path`; what the choice sets is taken back afterwards."""
    for name in (LLVM_VARIABLE, WANTED):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(variant, "_LLVM_PACKAGE", "no-such-package")
    monkeypatch.setattr(variant, "_SYSTEM_FOLDERS", (str(tmp_path),))


def library(folder: Path, name: str) -> Path:
    path = folder / name
    path.touch()
    return path


@pytest.fixture
def backends(monkeypatch):
    """The backends that the machine seems to have; a set to change."""
    present = {"llvm"}

    def runs(name, found):
        return name.split("_")[0] in present and (found is not None or name.startswith("cuda"))

    monkeypatch.setattr(variant, "_runs", runs)
    return present


# --- versions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-14.so.1", 14),
        ("libLLVM-15.so.1", 15),
        ("libLLVM-17.so", 17),
        ("libLLVM.so.23.1", 23),
        ("libLLVM.so.18.1", 18),
        ("libLLVM-19.1.so", 19),
        ("libLLVM.20.dylib", 20),
        ("libLLVM-14.0.6.so", 14),
    ],
)
def test_the_name_tells_the_version(tmp_path, name, version):
    assert llvm_version(library(tmp_path, name)) == version


def test_a_link_is_as_old_as_what_it_leads_to(tmp_path):
    (tmp_path / "libLLVM.so").symlink_to(library(tmp_path, "libLLVM.so.23.1"))
    (tmp_path / "libLLVM-99.so").symlink_to(library(tmp_path, "libLLVM-15.so.1"))
    assert llvm_version(tmp_path / "libLLVM.so") == 23
    assert llvm_version(tmp_path / "libLLVM-99.so") == 15


def test_what_is_no_library_has_no_version(tmp_path):
    assert llvm_version(library(tmp_path, "libLLVM.so")) is None
    assert llvm_version(tmp_path / "missing.so") is None


@pytest.mark.parametrize(
    ("answer", "version"), [("print(21)", 21), ("print('?')", None), ("raise OSError", None)]
)
def test_a_library_without_a_telling_name_is_asked_in_a_child(monkeypatch, tmp_path, answer, version):
    monkeypatch.setattr(variant, "_ASK_VERSION", answer)
    assert llvm_version(library(tmp_path, "compiler.so")) == version


# --- which library ----------------------------------------------------------------------------------------


def test_the_newest_of_the_system_is_taken(tmp_path):
    for name in ("libLLVM-14.so.1", "libLLVM-9.so", "libLLVM.so.18.1", "libLLVM.so.20.1", "libLLVM-15.so.1"):
        library(tmp_path, name)
    assert find_llvm() == tmp_path / "libLLVM.so.20.1"


@pytest.mark.parametrize(
    "names", [[], ["libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM-16.so"], ["libLLVM-21.a"]]
)
def test_no_library_rather_than_one_that_aborts(tmp_path, names):
    for name in names:
        library(tmp_path, name)
    assert find_llvm() is None


def test_the_installed_package_goes_before_the_system(monkeypatch, tmp_path):
    library(tmp_path, "libLLVM.so.30.1")
    packaged = library(tmp_path, "libLLVM.so.23.1")
    monkeypatch.setattr(variant, "_packaged", lambda: [packaged])
    assert find_llvm() == packaged


def test_the_environment_goes_before_all(monkeypatch, tmp_path):
    library(tmp_path, "libLLVM.so.30.1")
    named = library(tmp_path, "libLLVM.so.17.1")
    monkeypatch.setenv(LLVM_VARIABLE, str(named))
    assert find_llvm() == named


def test_a_named_library_that_is_missing_is_not_replaced_by_another(monkeypatch, tmp_path):
    library(tmp_path, "libLLVM.so.23.1")
    missing = tmp_path / "libLLVM.so.22"
    monkeypatch.setenv(LLVM_VARIABLE, str(missing))
    with pytest.raises(SetupError, match="no such file") as told:
        find_llvm()
    assert LLVM_VARIABLE in str(told.value)
    assert str(missing) in str(told.value)
    with pytest.raises(SetupError, match="no such file"):
        choose_variant()


@pytest.mark.parametrize(
    ("name", "told"),
    [("libLLVM-14.so.1", "version 14"), ("libLLVM-15.so.1", "version 15"), ("x.so", "unknown version")],
)
def test_a_named_library_that_would_abort_is_refused(monkeypatch, tmp_path, name, told):
    monkeypatch.setenv(LLVM_VARIABLE, str(library(tmp_path, name)))
    with pytest.raises(SetupError, match=told):
        find_llvm()


def test_a_folder_is_no_library(monkeypatch, tmp_path):
    monkeypatch.setenv(LLVM_VARIABLE, str(tmp_path))
    with pytest.raises(SetupError, match="no such file"):
        find_llvm()


# --- which variant ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("wanted", ["scalar_rgb", "llvm_ad_rgb", "cuda_ad_spectral ", "LLVM_AD_SPECTRAL"])
def test_an_unsupported_variant_is_refused_by_name(monkeypatch, backends, wanted):
    allowed = "cuda_ad_spectral, llvm_ad_spectral"
    with pytest.raises(SetupError, match=allowed) as told:
        choose_variant(wanted)
    assert repr(wanted) in str(told.value)
    monkeypatch.setenv(WANTED, wanted)
    with pytest.raises(SetupError, match=allowed):
        choose_variant()


def test_the_gpu_is_best_and_the_processor_next(backends, tmp_path):
    library(tmp_path, "libLLVM.so.23.1")
    assert choose_variant() == "llvm_ad_spectral"
    backends.add("cuda")
    assert choose_variant() == "cuda_ad_spectral"
    assert choose_variant("llvm_ad_spectral") == "llvm_ad_spectral"


def test_the_environment_can_ask_for_the_processor(monkeypatch, backends, tmp_path):
    library(tmp_path, "libLLVM.so.23.1")
    backends.add("cuda")
    monkeypatch.setenv(WANTED, "llvm_ad_spectral")
    assert choose_variant() == "llvm_ad_spectral"
    # What the caller says goes before the environment.
    assert choose_variant("cuda_ad_spectral") == "cuda_ad_spectral"


def test_the_chosen_library_is_handed_to_drjit(backends, tmp_path):
    chosen = library(tmp_path, "libLLVM.so.23.1")
    choose_variant()
    assert os.environ[LLVM_VARIABLE] == str(chosen)


def test_without_any_the_message_says_what_to_install(monkeypatch, backends):
    monkeypatch.setattr(variant, "_LLVM_PACKAGE", "karellen-llvm-core")
    monkeypatch.setattr(variant, "_packaged", list)
    with pytest.raises(SetupError, match=r"pip install karellen-llvm-core") as told:
        choose_variant()
    assert f"LLVM {OLDEST_LLVM} or newer" in str(told.value)
    assert LLVM_VARIABLE in str(told.value)


def test_a_gpu_that_is_not_there_is_not_replaced(backends, tmp_path):
    library(tmp_path, "libLLVM.so.23.1")
    with pytest.raises(SetupError, match="CUDA GPU"):
        choose_variant("cuda_ad_spectral")


def test_a_drjit_that_runs_an_older_llvm_is_not_trusted(monkeypatch, tmp_path):
    # As when a caller imported Dr.Jit first, and it took the system's library.
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
    with pytest.raises(SetupError, match="no usable renderer"):
        choose_variant()


# --- a start in another thread ------------------------------------------------------------------------------


@pytest.fixture
def not_started(monkeypatch):
    """As in a process that has not asked for the renderer yet."""
    monkeypatch.setattr(variant, "_started", functools.cache(variant._started.__wrapped__))
    monkeypatch.setattr(variant, "kernel", functools.cache(variant.mitsuba_modules.__wrapped__))


def test_a_start_that_failed_elsewhere_fails_again_where_the_renderer_is_needed(monkeypatch, not_started):
    def refuse(wanted=None):
        raise SetupError("there is none")

    monkeypatch.setattr(variant, "choose_variant", refuse)
    for _ in range(2):
        with pytest.raises(SetupError, match="there is none"):
            variant.mitsuba_modules()


def test_the_renderer_starts_once_however_many_ask(monkeypatch, not_started):
    asked, begun = [], threading.Barrier(4)

    def slowly(wanted=None):
        asked.append(threading.get_ident())
        time.sleep(0.05)
        return "llvm_ad_spectral"

    monkeypatch.setattr(variant, "choose_variant", slowly)
    monkeypatch.setitem(sys.modules, "drjit", types.ModuleType("drjit"))
    mitsuba = types.ModuleType("mitsuba")
    mitsuba.set_variant = mitsuba.set_log_level = lambda _: None
    mitsuba.LogLevel = types.SimpleNamespace(Error=0)
    monkeypatch.setitem(sys.modules, "mitsuba", mitsuba)

    def ask():
        begun.wait()
        assert variant.mitsuba_modules()[0] is mitsuba

    askers = [threading.Thread(target=ask) for _ in range(4)]
    for thread in askers:
        thread.start()
    for thread in askers:
        thread.join()
    assert len(asked) == 1
