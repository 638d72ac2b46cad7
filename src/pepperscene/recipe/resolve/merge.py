"""Merging the tables of recipe files that extend each other, and single changes above them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pepperscene.recipe.camera_tables import LENS_KEYS, SIZE_KEYS
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.variation.extract import OVERRIDE, table_model
from pepperscene.units import NONE, table_fields

_SELECT: Final = "select"

_REPLACED: Final = (
    *((keys, tuple(key for other in LENS_KEYS if other != keys for key in other)) for keys in LENS_KEYS),
    (("calibration",), SIZE_KEYS),
)
"""Keys of [camera] and [depth_camera], and their alternatives, which a layer with one of these keys does not
inherit. So a recipe can give `hfov_deg` although the one that it extends has a `lens`."""

_CAMERAS: Final = ("camera", "depth_camera")


def merge_layer(base: Mapping[str, Any], over: Mapping[str, Any], *, is_file: bool = True) -> dict[str, Any]:
    """The tables of `base` with the values of `over`.

    Tables are merged key by key; lists and varied values are replaced as a whole. Views of another kind
    replace the table as a whole. A file with other numbers of frames, other views, twins or a rig has other
    frames, so it does not inherit a selection; a single changed value of the views keeps it.
    """
    base = dict(base)
    if _has_other_frames(base, over, is_file) and isinstance(base.get("plan"), dict):
        base["plan"] = {key: value for key, value in base["plan"].items() if key != _SELECT}
    if _has_other_kind(base, over) or "frame_rate_hz" in _table(over, "views"):
        # The number of frames can follow from the new views.
        base["plan"] = {key: value for key, value in _table(base, "plan").items() if key != "frames"}
    if _has_other_kind(base, over):
        del base["views"]
    return merge_tables(_without_replaced(base, over), over, Recipe)


def _without_replaced(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """The lower layers' table without keys of the camera for which the layer `over` has an alternative."""
    for name in _CAMERAS:
        inherited, camera = base.get(name), over.get(name)
        if isinstance(inherited, dict) and isinstance(camera, dict):
            given = {key for key, value in camera.items() if value != NONE}
            replaced = {key for keys, others in _REPLACED if given & set(keys) for key in others}
            base = {**base, name: {key: value for key, value in inherited.items() if key not in replaced}}
    return base


def _has_other_frames(base: Mapping[str, Any], over: Mapping[str, Any], is_file: bool) -> bool:
    numbers = _table(over, "plan").keys() - {_SELECT}
    is_changed = bool(numbers) or _has_other_kind(base, over) or bool({"twins", "rig"} & over.keys())
    return is_changed or (is_file and "views" in over)


def _has_other_kind(base: Mapping[str, Any], over: Mapping[str, Any]) -> bool:
    kind = _table(over, "views").get("kind")
    return "views" in base and kind is not None and kind != _table(base, "views").get("kind")


def _table(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = tables.get(name)
    return value if isinstance(value, dict) else {}


def merge_tables(base: Mapping[str, Any], over: Mapping[str, Any], model: Any) -> dict[str, Any]:
    """Replace the values of `base` by those of `over`, table by table of a model."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if not (isinstance(value, dict) and isinstance(below, dict)):
            merged[key] = value
        elif key == OVERRIDE and model is Recipe:
            merged[key] = _merge_override(below, value)
        else:
            annotation = None if model is None else table_fields(model).get(key)
            inner = table_model(annotation, {**below, **value})
            is_table = inner is not None or key in _FREE_TABLES
            merged[key] = merge_tables(below, value, inner) if is_table else value
    return merged


_FREE_TABLES: Final = {"share", "twins", "views"}
"""Tables that are merged although no single model has their keys. Where any other value is expected, a table
is a varied value."""


def _merge_override(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge changes of the cultivar; a varied value replaces what is below it, and is replaced as a whole."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = value
        if isinstance(value, dict) and isinstance(below, dict) and "per" not in {*value, *below}:
            merged[key] = _merge_override(below, value)
    return merged


def has_field(tables: Mapping[str, Any], key: tuple[str, ...]) -> bool:
    """Whether the models of a recipe with these tables have a dotted key."""
    model: Any = Recipe
    for depth, part in enumerate(key):
        if key[0] == OVERRIDE and depth:
            # The keys of cultivar files are checked when one is loaded.
            return True
        if model is None or part not in table_fields(model):
            return False
        tables = _table(tables, part)
        model = table_model(table_fields(model)[part], tables)
    return True
