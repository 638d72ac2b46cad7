"""An early start of the renderer changes the time of a first picture and nothing else."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import Developing, load_flash, load_lens, load_sensor
from pepperscene.camera.camera import Camera
from pepperscene.render import QUALITIES
from pepperscene.render import renderer as early

PARTS = ("kernel", "begin_denoising", "reference_correction")


@pytest.fixture
def camera():
    flash = load_flash("led_matrix_200klx")
    return Camera(load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re"), flash=flash)


@pytest.fixture
def called(monkeypatch):
    """The parts that were begun, in order."""
    found = []
    for name in PARTS:
        monkeypatch.setattr(early, name, lambda *_, name=name: found.append(name))
    return found


def test_what_a_picture_needs_is_begun(camera, called):
    early.warm_up(camera, QUALITIES["standard"]).join()
    assert called == list(PARTS)


def test_nothing_is_begun_that_is_not_needed(camera, called):
    early.warm_up(camera, QUALITIES["reference"]).join()
    assert "begin_denoising" not in called
    called.clear()
    grey = Camera(camera.lens, load_sensor("onsemi_mt9v024_mono"), flash=camera.flash)
    early.warm_up(grey, QUALITIES["draft"]).join()
    assert "reference_correction" not in called
    told = replace(camera, developing=Developing(colour_matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1))))
    early.warm_up(told, QUALITIES["draft"]).join()
    assert "reference_correction" not in called


def test_what_fails_early_leaves_the_rest_alone(camera, called, monkeypatch):
    def fail(*_):
        raise OSError("not here")

    monkeypatch.setattr(early, "kernel", fail)
    monkeypatch.setattr(early, "begin_denoising", fail)
    early.warm_up(camera, QUALITIES["standard"]).join()
    assert called == ["reference_correction"]


def test_a_denoiser_that_began_early_makes_the_same_picture():
    ask = (
        "import sys, numpy as np\n"
        "from pepperscene.render.transport.denoise import _filtered, begin\n"
        "rng = np.random.default_rng(1)\n"
        "light, albedo, normal = (rng.random((40, 56, 3), np.float32) for _ in range(3))\n"
        "if 'early' in sys.argv: begin()\n"
        "sys.stdout.buffer.write(_filtered(light, albedo, normal).tobytes())\n"
    )
    late, early_one = (
        subprocess.run([sys.executable, "-c", ask, when], check=True, capture_output=True).stdout
        for when in ("late", "early")
    )
    assert late == early_one
    assert np.frombuffer(late, np.float32).std() > 0.0


BEGIN = (
    "from pepperscene.camera import Camera, load_lens, load_sensor\n"
    "from pepperscene.render import QUALITIES, begin\n"
    "camera = Camera(load_lens('lensagon_cmfa0420nd'), load_sensor('ueye_ui5250re'))\n"
    "started = begin(camera, QUALITIES['standard'])\n"
)


def test_a_renderer_that_began_early_renders_from_the_main_thread():
    # In a process of its own; the machine's real library.
    ask = (
        "started.join()\n"
        "from pepperscene.render.variant import kernel\n"
        "mi, dr = kernel()\n"
        "assert mi.variant() in ('llvm_ad_spectral', 'cuda_ad_spectral')\n"
        "assert dr.sum(mi.Float([1.0, 2.0, 3.0]) * 2.0)[0] == 12.0\n"
    )
    subprocess.run([sys.executable, "-c", BEGIN + ask], check=True)


def test_a_process_may_end_while_the_renderer_begins():
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + "raise SystemExit(3)"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (3, "")
