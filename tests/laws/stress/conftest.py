"""The stress tests share the small bodies of the laws and the greenhouse of the renderer's tests."""

from __future__ import annotations

import sys
from pathlib import Path

_TESTS = Path(__file__).parents[2]
sys.path[:0] = [str(folder) for folder in (_TESTS / "laws", _TESTS / "render") if str(folder) not in sys.path]
