"""What a data set's tables say of a frame and of the fruit in it: plain values, one row each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import FrameStatus
from pepperscene.frame import OUTPUTS

Row = dict[str, Any]
"""Values by column; what is missing is not known."""

_EDGES: Final = ("x0", "y0", "x1", "y1")

FRAME_COLUMNS: Final[Mapping[str, str]] = {
    "index": "int64",
    "set": "int32",
    "rotation": "int32",
    "step": "int32",
    "seed": "int64",
    "recipe_seed": "int64",
    **dict.fromkeys(("x_m", "y_m", "z_m"), "double"),
    "pose": "doubles",
    **{f"pixels_{one.name.lower()}": "int64" for one in OrganClass},
    "samples_per_pixel": "double",
    "error_codes": "double",
    "noise_codes": "double",
    "bytes": "int64",
    "render_s": "double",
    "write_s": "double",
    "worker": "string",
    "checksum": "string",
    **{f"{name}_sha256": "string" for name in OUTPUTS},
}
"""Columns of the manifest and their types in Parquet's words. Timings and the worker are the journal's, and
unknown where that is lost; all else can be read out of the frames again."""

FRUIT_COLUMNS: Final[Mapping[str, str]] = {
    "index": "int64",
    "instance": "int32",
    "plant": "int32",
    "phytomer": "int32",
    "kind": "string",
    **dict.fromkeys(("ripeness", "length_m", "diameter_m", "visible_fraction"), "double"),
    "visible_pixels": "int64",
    "amodal_pixels": "int64",
    "truncated": "bool",
    "occluders": "int32",
    **dict.fromkeys((f"foot_{axis}_m" for axis in "xyz"), "double"),
    **dict.fromkeys((f"along_{axis}" for axis in "xyz"), "double"),
    **dict.fromkeys((f"{kind}_{edge}" for kind in ("box", "amodal") for edge in _EDGES), "int32"),
    "peduncle": "int32",
    **dict.fromkeys((f"cut_{axis}_m" for axis in "xyz"), "double"),
    **dict.fromkeys(("cut_u", "cut_v"), "double"),
    "cut_visible": "bool",
    **dict.fromkeys((f"approach_{axis}" for axis in "xyz"), "double"),
}  # fmt: skip
"""Columns of `fruit.parquet`: one row for each fruit of each frame; lengths and directions in the camera."""


def row_of(standing: FrameStatus) -> Row:
    """A frame's row, as far as its files tell it."""
    facts, outputs = standing.facts, standing.outputs
    row: Row = {name: facts.get(name) for name in ("index", "set", "rotation", "step", "seed", "recipe_seed")}
    pose = facts.get("camera", {}).get("pose")
    if pose is not None:
        row |= {name: pose[axis][3] for axis, name in enumerate(("x_m", "y_m", "z_m"))}
        row["pose"] = [number for line in pose for number in line]
    row |= {f"pixels_{name}": count for name, count in facts.get("class_pixels", {}).items()}
    sampling = facts.get("sampling", {})
    row |= {name: sampling.get(name) for name in ("samples_per_pixel", "error_codes", "noise_codes")}
    row |= {f"{name}_sha256": entry["sha256"] for name, entry in outputs.items()}
    row["bytes"] = sum(entry["bytes"] for entry in outputs.values())
    row["checksum"] = standing.checksum
    return row


def fruit_rows(index: int, harvest: Mapping[str, Any]) -> Iterator[Row]:
    """The rows of a frame's fruit.

    Args:
        index: of the frame.
        harvest: the frame's output of that name.
    """
    for fruit in harvest["fruit"]:
        pose, stalk = fruit["pose"], fruit["peduncle"]
        row: Row = {name: fruit[name] for name in FRUIT_COLUMNS if name in fruit and name != "peduncle"}
        row |= {"index": index, "occluders": len(fruit["occluders"])}
        row |= {f"foot_{axis}_m": pose[place][3] for place, axis in enumerate("xyz")}
        row |= {f"along_{axis}": pose[place][2] for place, axis in enumerate("xyz")}
        for kind, key in (("box", "box"), ("amodal", "amodal_box")):
            row |= {f"{kind}_{edge}": at for edge, at in zip(_EDGES, fruit[key] or (), strict=False)}
        row |= _axes("approach_{}", (fruit["approach"] or {}).get("camera"))
        if stalk is not None:
            cut = stalk["cut"]
            row |= {
                "peduncle": stalk["instance"],
                "cut_visible": cut["visible"],
                **_axes("cut_{}_m", cut["camera_m"]),
            }
            if cut["px"] is not None:
                row |= {"cut_u": cut["px"][0], "cut_v": cut["px"][1]}
        yield row


def _axes(name: str, values: Any) -> Row:
    return {} if values is None else {name.format(axis): values[place] for place, axis in enumerate("xyz")}
