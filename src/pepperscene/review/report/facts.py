"""What a data set is, in a few terms at the top of its report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pepperscene.dataset.store.recorded_values import is_varied
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.review.report.markup import Html, element, joined


def facts_html(info: Mapping[str, Any]) -> Html:
    """Quality, seed, plan and others as a list of terms, from the content of a `dataset.json`."""
    recipe = info["recipe"]
    items = {
        "Quality": info["quality"],
        "Seed": recipe["seed"],
        "Plan": _describe_plan(recipe["plan"]),
        "Rows": _describe_rows(info),
        "Exposure": _describe_exposure(info),
        "Daylight": _describe_daylight(info),
        "Version": info["version"],
        "Recipe SHA-256": info["recipe_sha256"][:12] + "…",
    }
    return joined(
        element("div", element("dt", key), element("dd", str(value))) for key, value in items.items()
    )


def _describe_rows(info: Mapping[str, Any]) -> str:
    plants, spacing = "{plants_front} + {plants_back} plants", "{spacing_mm:g} mm apart"
    if is_varied(info, "row.plants_front", "row.plants_back"):
        plants = "varied number of plants"
    if is_varied(info, "row.spacing_mm"):
        spacing = "varied spacing"
    return f"{plants}, {spacing}".format(**info["recipe"]["row"])


def _describe_exposure(info: Mapping[str, Any]) -> str:
    if is_varied(info, "camera.exposure_us"):
        return "varied"
    exposure = info["recipe"]["camera"]["exposure_us"]
    return "automatic" if exposure == AUTO else f"{exposure:g} µs"


def _describe_daylight(info: Mapping[str, Any]) -> str:
    if is_varied(info, "daylight.illuminance_lx"):
        return "varied"
    daylight = info["recipe"]["daylight"] or {"illuminance_lx": 0}
    return f"{daylight['illuminance_lx']:,.0f} lx"


def _describe_plan(plan: Mapping[str, Any]) -> str:
    factors = ["{sets} sets", "{rotations} rotations", "{frames} steps"]
    factors += [f"{{{name}}} {name}" for name in ("twins", "cameras") if plan.get(name, 1) > 1]
    return " × ".join(factors).format(**plan)
