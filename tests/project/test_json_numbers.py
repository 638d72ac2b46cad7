"""JSON that is written or printed has no number that JSON does not have: encoders refuse nan and inf."""

from __future__ import annotations

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "pepperscene"

NOT_WRITTEN = {
    "document.py": "quotes keys in messages",
    "render/doctor.py": "between two processes of this program",
    "bench/frames_child.py": "between two processes of this program",
    "bench/profile.py": "between two processes of this program",
    "bench/measure.py": "between two processes of this program",
    "building/viewpoints/table.py": "of settings, for a digest",
    "export/yolo.py": "quotes names",
    "export/bop.py": "compared with a recorded recipe",
    "export/huggingface.py": "names of columns; values are encoded without nan",
    "recipe/recipe.py": "of a recipe, whose numbers are finite, for a digest",
    "recipe/resolve/resolved.py": "of a recipe, whose numbers are finite, for a digest",
    "recipe/resolve/frame_setups.py": "of a recipe, whose numbers are finite, as a key",
    "dataset/store/manifest.py": "of values of a recipe, whose numbers are finite",
    "review/check/one_frame.py": "of digests and rows of tables, for a digest",
    "recipe/variation/varied.py": "of outcomes, as a key",
}
"""Modules whose JSON text is no file and no output."""


def test_encoders_refuse_what_json_does_not_have():
    lenient, exempt = [], set()
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            if node.func.attr not in ("dump", "dumps", "JSONEncoder"):
                continue
            if "json" not in ast.unparse(node.func.value):
                continue
            strict = any(
                keyword.arg == "allow_nan" and ast.unparse(keyword.value) == "False"
                for keyword in node.keywords
            )
            if strict:
                continue
            if name in NOT_WRITTEN:
                exempt.add(name)
            else:
                lenient.append(f"{name}:{node.lineno}")
    assert lenient == []
    assert exempt == NOT_WRITTEN.keys()
