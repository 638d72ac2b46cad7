"""The report's web page: one file with its pictures inside."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.display import VIRIDIS, View
from pepperscene.dataset.sheet import TITLES


def page(
    about: Mapping[str, Any],
    every: Sequence[Mapping[str, Any]],
    views: Sequence[View],
    near_m: float,
    far_m: float,
) -> str:
    """The page as HTML.

    Args:
        about: the data set's `dataset.json`.
        every: the facts of all frames that are there; the class table is of these.
        views: the frames that are shown.
        near_m: distance shown brightest.
        far_m: distance shown darkest.
    """
    template = resources.files("pepperscene.dataset").joinpath("page.html").read_text(encoding="utf-8")
    recipe = about["recipe"]
    total = recipe["plan"]["sets"] * recipe["plan"]["rotations"] * recipe["plan"]["frames"]
    shown = f"; {len(views)} of them are shown" if len(views) < len(every) else ""
    return Template(template).substitute(
        name=escape(str(recipe["name"])),
        cultivar=escape(str(recipe["cultivar"])),
        summary=f"{len(every):,} of {total:,} planned frames are built{shown}.",
        facts=_facts(about),
        classes=_class_table(every),
        ramp=", ".join(reversed(VIRIDIS)),
        near=f"{near_m:.2f} m",
        far=f"{far_m:.2f} m",
        frames="\n".join(_card(view) for view in views),
    )


def _facts(about: Mapping[str, Any]) -> str:
    recipe = about["recipe"]
    light = recipe["daylight"] or {"illuminance_lx": 0}
    items = {
        "Quality": about["quality"],
        "Seed": recipe["seed"],
        "Plan": "{sets} sets × {rotations} rotations × {frames} steps".format(**recipe["plan"]),
        "Rows": "{plants_front} + {plants_back} plants, {spacing_mm:g} mm apart".format(**recipe["row"]),
        "Exposure": f"{recipe['camera']['exposure_us']:g} µs",
        "Daylight": f"{light['illuminance_lx']:,.0f} lx",
        "Version": about["version"],
        "Recipe SHA-256": about["recipe_sha256"][:16] + "…",
    }
    return "".join(f"<div><dt>{k}</dt><dd>{escape(str(v))}</dd></div>" for k, v in items.items())


def _class_table(every: Sequence[Mapping[str, Any]]) -> str:
    """Share of each class over all pixels of all frames that have labels."""
    counted = [facts["class_pixels"] for facts in every if "class_pixels" in facts]
    if not counted:
        return "<p>No frame has class labels yet.</p>"
    pixels = {c: sum(one[c.name.lower()] for one in counted) for c in OrganClass}
    shares = {c: pixels[c] / max(1, sum(pixels.values())) for c in OrganClass}
    widest = max(shares.values())
    rows = "".join(
        f'<tr><td><i style="background:{_hex(c)}"></i>{c.name.lower()}</td><td>{int(c)}</td>'
        f"<td>{100 * share:.2f} %</td>"
        '<td class="bar">'
        f'<b style="width:{100 * share / max(widest, 1e-9):.1f}%;background:{_hex(c)}"></b></td></tr>'
        for c, share in shares.items()
    )
    head = '<tr><th>Class</th><th>Id</th><th>Pixels</th><th class="bar"></th></tr>'
    plural = "" if len(counted) == 1 else "s"
    return f"<table>{head}{rows}</table><p>Share of all pixels in {len(counted):,} frame{plural}.</p>"


def _card(view: View) -> str:
    facts = view.facts
    where = f"set {facts['set']} · rotation {facts['rotation']} · step {facts['step']}"
    figures = "".join(
        f'<button type="button"><img src="{_embedded(name, picture)}" class="{name}"'
        f' alt="{TITLES[name]} of frame {view.index}"'
        f' width="{picture.shape[1]}" height="{picture.shape[0]}"><span>{TITLES[name]}</span></button>'
        for name, picture in view.pictures.items()
    )
    return (
        f"<article><header><h3>Frame {view.index:06d}</h3><p>{where}</p></header>"
        f'<div class="pictures">{figures}</div>{_stack(facts)}<p class="told">{_told(facts)}</p></article>'
    )


def _stack(facts: Mapping[str, Any]) -> str:
    """The frame's class shares as one bar."""
    pixels = facts.get("class_pixels")
    if not pixels:
        return ""
    total = max(1, sum(pixels.values()))
    parts = "".join(
        f'<b style="width:{100 * pixels[c.name.lower()] / total:.3f}%;background:{_hex(c)}"'
        f' title="{c.name.lower()} {100 * pixels[c.name.lower()] / total:.1f} %"></b>'
        for c in OrganClass
    )
    return f'<div class="stack">{parts}</div>'


def _told(facts: Mapping[str, Any]) -> str:
    parts = []
    pose = facts.get("camera", {}).get("pose")
    if pose:
        x, y, z = (row[3] for row in pose[:3])
        parts.append(f"Camera at x {x:.3f} m, y {y:.3f} m, height {z:.3f} m")
    instances = facts.get("instances") or {}
    if instances:
        # Greenhouse and far rows belong to no plant.
        classes = [item["class"] for item in instances.values() if item["plant"] >= 0]
        fruit, leaves = classes.count(OrganClass.PEPPER), classes.count(OrganClass.LEAF)
        parts.append(f"{len(classes)} organs in view, {leaves} leaves and {fruit} fruit among them")
    contacts = facts.get("contacts")
    if contacts:
        touching = contacts["fruit_touching"] + contacts["blades_touching"]
        parts.append(f"{touching} of the scene's fruit and leaves touch what they should not")
    return escape(". ".join(parts) + "." if parts else "")


def _embedded(name: str, picture: NDArray[np.uint8]) -> str:
    """A picture as a data address: photographs as JPEG, all else without loss."""
    from PIL import Image

    kind, options = ("JPEG", {"quality": 90}) if name == "colour" else ("PNG", {"compress_level": 9})
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format=kind, **options)
    return f"data:image/{kind.lower()};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _hex(organ_class: OrganClass) -> str:
    return "#{:02x}{:02x}{:02x}".format(*CLASS_COLOURS[organ_class])
