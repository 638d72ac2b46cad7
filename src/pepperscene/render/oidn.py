"""The one door to Open Image Denoise, whose Python package imports PyTorch wherever that is installed."""

from __future__ import annotations

import sys
import threading
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Final

_TORCH: Final = "torch"
_FLAG: Final = "TORCH_AVAILABLE"
_one_at_a_time = threading.RLock()


@cache
def open_image_denoise() -> ModuleType:
    """The package `pyoidn`, imported when first asked for.

    PyTorch takes a second and 180 MB, and arrays of NumPy do not need it. The package only tries whether it
    is there, and imports it again where it is used; so it is kept from it, and told what it would have found.
    """
    with _one_at_a_time:
        if "pyoidn" in sys.modules or _TORCH in sys.modules or find_spec(_TORCH) is None:
            import pyoidn

            return pyoidn
        modules: dict[str, Any] = sys.modules
        modules[_TORCH] = None  # what the import system takes for "not there"
        try:
            import pyoidn
        finally:
            del modules[_TORCH]
        for name, module in list(modules.items()):
            if name.startswith("pyoidn.") and hasattr(module, _FLAG):
                setattr(module, _FLAG, True)
        return pyoidn
