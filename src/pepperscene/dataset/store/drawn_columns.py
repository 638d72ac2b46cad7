"""Columns of the manifest that depend on the recipe: drawn values, what frames share, and exposures."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, Final

from pepperscene.dataset.store.recorded_values import as_mapping, listed_values
from pepperscene.outputs import OUTPUTS

DRAWN: Final = "drawn."
"""Prefix of the names of columns of drawn values; the dotted key follows."""

_SHARED: Final[Mapping[str, str]] = {"moment": "int64", "twin": "int32", "rig_camera": "string"}
_EXPOSURE: Final[Mapping[str, str]] = {"exposure_us": "double", "gain": "double"}
_KINDS: Final[Mapping[str, str]] = {"number": "double", "integer": "double", "date": "string"}
_AUTO: Final = "auto"


def drawn_columns(info: Mapping[str, Any]) -> dict[str, str]:
    """Further columns of a data set's manifest and their types; none for a recipe without variation.

    They follow from the recipe alone, so that they do not depend on which frames exist.

    Args:
        info: the content of `dataset.json`, not validated.
    """
    recipe = as_mapping(info.get("recipe"))
    variation, twins = as_mapping(recipe.get("variation")), as_mapping(recipe.get("twins"))
    rig = recipe.get("rig")
    columns: dict[str, str] = {}
    if twins or rig:
        columns["moment"] = _SHARED["moment"]
    if twins:
        columns["twin"] = _SHARED["twin"]
    if rig:
        columns["rig_camera"] = _SHARED["rig_camera"]
    # A twin's value takes the place of a drawn one.
    kinds = {name: _recorded_kind(as_mapping(identity)) for name, identity in variation.items()}
    kinds |= {name: _common_kind(values) for name, values in twins.items()}
    columns |= {f"{DRAWN}{name}": kinds[name] for name in sorted(kinds)}
    return {**columns, **(_EXPOSURE if _has_exposures(recipe, kinds) else {})}


def drawn_row(metadata: Mapping[str, Any], outputs: Iterable[str]) -> dict[str, Any]:
    """The values of a frame's JSON for all columns that `drawn_columns` can name, for any recipe."""
    row: dict[str, Any] = {name: metadata[name] for name in _SHARED if name in metadata}
    for name, value in as_mapping(metadata.get("drawn")).items():
        row[f"{DRAWN}{name}"] = json.dumps(value) if isinstance(value, list) else value
    # Without traced light, automatic exposure does not choose one, and no output depends on it.
    if any(OUTPUTS[name].traced for name in outputs if name in OUTPUTS):
        camera = as_mapping(metadata.get("camera")) | as_mapping(metadata.get("auto_exposure"))
        seconds = camera.get("exposure_s")
        if isinstance(seconds, int | float) and not isinstance(seconds, bool):
            row["exposure_us"] = seconds * 1e6
        row["gain"] = camera.get("gain")
    return row


def _has_exposures(recipe: Mapping[str, Any], varied: Iterable[str]) -> bool:
    """Whether exposure time or gain differ between frames."""
    rig = recipe.get("rig")
    cameras = [as_mapping(as_mapping(entry).get("camera")) for entry in rig] if isinstance(rig, list) else []
    is_auto = as_mapping(recipe.get("camera")).get("exposure_us") == _AUTO
    differs = {f"camera.{name}" for name in _EXPOSURE} & set(varied)
    return bool(is_auto or differs or any(_EXPOSURE.keys() & camera.keys() for camera in cameras))


def _recorded_kind(identity: Mapping[str, Any]) -> str:
    """The type of a varied value's column, from its record in `dataset.json`."""
    if "in_turn" in identity or "outcomes" in identity:
        return _common_kind(listed_values(identity))
    return _KINDS.get(str(identity.get("kind")), "string")


def _common_kind(values: Any) -> str:
    """The type of a column that holds each of some values; text if they have none in common."""
    kinds = {type(value) for value in values} if isinstance(values, list | tuple) else set()
    if kinds == {bool}:
        return "bool"
    return "double" if kinds and kinds <= {int, float} else "string"
