"""The door to Open Image Denoise keeps PyTorch out, and harms nobody who wants it."""

import importlib.util
import subprocess
import sys

import pytest

DENOISE = (
    "import sys, numpy as np\n"
    "from pepperscene.render.transport.denoise import open_image_denoise\n"
    "grey = np.full((8, 8, 3), 0.5, np.float32)\n"
    "oidn = open_image_denoise()\n"
    "found = oidn.denoise(grey, grey, grey, hdr=True)\n"
    "assert found.shape == grey.shape and np.isfinite(found).all()\n"
)
needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="PyTorch is not installed")


def run(script):
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)


def test_denoising_imports_no_torch():
    run(DENOISE + "assert 'torch' not in sys.modules and open_image_denoise() is oidn\n")


@needs_torch
def test_who_imports_torch_later_has_it_and_denoises_tensors():
    run(
        DENOISE + "import torch\n"
        "same = torch.from_numpy(grey)\n"
        "tensor = oidn.denoise(same, same, same, hdr=True)\n"
        "assert np.array_equal(tensor.numpy(), found)\n"
        "oidn.utils.require_torch()\n"
    )


@needs_torch
def test_torch_that_is_there_already_stays():
    run("import torch\nbefore = torch\n" + DENOISE + "import torch\nassert torch is before\n")


def test_a_denoiser_that_cannot_be_imported_says_so_and_leaves_nothing_behind():
    run(
        "import sys\n"
        "from pepperscene.render.transport.denoise import open_image_denoise\n"
        "sys.modules['pyoidn'] = None\n"
        "try:\n    open_image_denoise()\n"
        "except ImportError:\n    pass\n"
        "else:\n    raise SystemExit('no error')\n"
        "assert 'torch' not in sys.modules\n"
    )
