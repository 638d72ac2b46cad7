"""Modules of tests/laws and tests/render can import each other's helpers."""

from __future__ import annotations

import sys
from pathlib import Path

_TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(folder) for folder in (_TESTS / "laws", _TESTS / "render") if str(folder) not in sys.path]
