"""The page on device files: its examples load, and it lists every key and every shipped device."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from pepperscene.camera import (
    Filter,
    Flash,
    Lens,
    Projector,
    Sensor,
    load_filter,
    load_flash,
    load_lens,
    load_projector,
    load_sensor,
)
from pepperscene.camera.optics.flash import FlashDocument
from pepperscene.camera.optics.lens import LensDocument
from pepperscene.camera.optics.projector import ProjectorDocument
from pepperscene.camera.sensor.sensor_files import FilterDocument, SensorDocument
from pepperscene.scene.cover import Cover, CoverDocument, load_cover
from pepperscene.shipped import shipped_folder

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "devices.md").read_text(encoding="utf-8")
DEVICES = {
    "Sensor": (load_sensor, Sensor, SensorDocument, "sensors"),
    "Lens": (load_lens, Lens, LensDocument, "lenses"),
    "Flash": (load_flash, Flash, FlashDocument, "flashes"),
    "Filter": (load_filter, Filter, FilterDocument, "filters"),
    "Projector": (load_projector, Projector, ProjectorDocument, "projectors"),
    "Cover": (load_cover, Cover, CoverDocument, "covers"),
}
each_device = pytest.mark.parametrize("title", DEVICES)


def section(title: str) -> str:
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


def block(text: str, language: str) -> str:
    (content,) = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return content


@each_device
def test_example_loads(title, tmp_path):
    load, kind, _, _ = DEVICES[title]
    (tmp_path / "curves.csv").write_text(block(TEXT, "text"), encoding="utf-8")
    (tmp_path / "mine.toml").write_text(block(section(title), "toml"), encoding="utf-8")
    device = load(tmp_path / "mine.toml")
    assert isinstance(device, kind)
    assert device.name.startswith("my ")


def keys(model: type[BaseModel]) -> set[str]:
    """Keys of a file of this model, those of its tables included."""
    names = set(model.model_fields)
    for name, field in model.model_fields.items():
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                names |= {f"{name}.{key}" for key in keys(kind)}
    return names


@each_device
def test_page_lists_every_key(title):
    text = TEXT.split("\n## Sensor\n")[0] + section(title)  # keys of all files, and those of this device
    for key in keys(DEVICES[title][2]):
        table, _, last = key.rpartition(".")
        rows = [row for row in text.splitlines() if row.startswith("|") and f"`{last}`" in row]
        rows += [row for row in text.splitlines() if row.startswith(f"| `[{last}]`")]
        assert [row for row in rows if not table or f"`[{table}]`" in row], key


@each_device
def test_page_lists_every_shipped_device(title):
    folder = DEVICES[title][3]
    (row,) = (row for row in TEXT.splitlines() if re.match(rf"\| .+ \| `{folder}` \|", row))
    listed = set(re.findall(r"`(\w+)`", row.split("|")[3]))
    assert listed == {path.stem for path in (shipped_folder("materials") / folder).glob("*.toml")}
