"""A data set and a folder of photographs whose texts, names and numbers try to become HTML, CSS or script."""

from __future__ import annotations

import json

import numpy as np
from data_sets import RandomImages, make_small_set
from PIL import Image

from pepperscene.atomic import canonical_json
from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.store.frame_json import checksum_of

TEXT = (
    "javascript:window.attacked=1//\"'><img src=http://attacker.invalid/x onerror=window.attacked=1>"
    "</title></style></script></td></p></table></svg><script>window.attacked=1</script>"
    "<script src=http://attacker.invalid/y></script><svg onload=window.attacked=1>"
    "<style>* { display: none }</style><b style='color: red' onclick=x>"
    "${name} $name $$ {name} %(name)s &lt;b&gt; &quot; -->"
)
"""Ends every element and attribute that it could be in, and tries templates and formats."""

FILE_NAME = (
    "\"'><img src=x onerror=window.attacked=1><svg onload=window.attacked=1> ${name} $name {name} &lt;"
)
"""As far as file names can: without slashes."""

NUMBERS = (
    *(("frame", *path.split(".")) for path in (
        "set", "rotation", "step", "index", "camera.pose.2.3", "sampling.error_codes", "sampling.noise_codes",
        "sampling.samples_per_pixel", "instances.1.class", "instances.1.plant", "class_pixels.leaf",
        "contacts.fruit_touching", "outputs.class.bytes",
    )),
    *(("info", *path.split(".")) for path in (
        "recipe_sha256", "recipe.seed", "recipe.plan.sets", "recipe.plan.rotations", "recipe.plan.frames",
        "recipe.row.plants_front", "recipe.row.spacing_mm", "recipe.camera.exposure_us",
        "recipe.daylight.illuminance_lx", "recipe.daylight",
    )),
)  # fmt: skip
"""Fields of a frame's JSON and of `dataset.json` that the page shows and that are no free text."""

_CHECKED = ("format", "sha256", "checksum", "recipe_sha256")
"""Texts that must have one form; others are free."""


def make_plain_set(parent):
    """A data set of nine frames that has all fields that a page shows."""
    folder = make_small_set(parent / "plain").folder
    for index in range(9):
        changes = {
            "sampling": {"error_codes": 1.5, "noise_codes": 9.0, "samples_per_pixel": 8.0},
            "contacts": {"fruit_touching": 1, "blades_touching": 2},
        }
        edit_frame(folder, index, lambda content, changes=changes: content | changes)
    return folder


def make_photographs(parent, name, image_name):
    """A folder of two photographs with masks."""
    folder = parent / name
    for number, picture in enumerate(RandomImages(name="random", items=(0, 1))):
        mask = np.array(CLASS_COLOURS, np.uint8)[picture.classes % 255]
        for kind, pixels in (("images", picture.colour), ("masks", mask)):
            path = folder / kind / f"{number}{image_name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(pixels).save(path)
    return folder


def make_hostile(folder):
    """Replace every free text in `dataset.json`, frames, harvest and manifest of a data set by `TEXT`."""
    edit_json(folder / "dataset.json", with_hostile_texts)
    for index in range(9):
        edit_json(folder / "harvest" / f"{index:06d}.json", with_hostile_texts)
        edit_frame(folder, index, with_hostile_texts)
    make_manifest_hostile(folder)


def make_manifest_hostile(folder):
    """Replace all texts in the manifest, except the checksums of the frames."""
    import pyarrow
    from pyarrow import parquet

    from pepperscene.dataset.store.dataset import open_dataset

    table = open_dataset(folder).manifest()
    for column, name in enumerate(table.column_names):
        if pyarrow.types.is_string(table.schema.field(name).type) and name != "checksum":
            texts = pyarrow.array([f"{TEXT}{row}" for row in range(len(table))], pyarrow.string())
            table = table.set_column(column, table.schema.field(name), texts)
    parquet.write_table(table, folder / "manifest.parquet", write_page_checksum=True)


def with_hostile_texts(value, key=""):
    """A JSON value with `TEXT` instead of every free text."""
    if isinstance(value, dict):
        return {name: with_hostile_texts(item, name) for name, item in value.items()}
    if isinstance(value, list):
        return [with_hostile_texts(item) for item in value]
    return TEXT if isinstance(value, str) and key not in _CHECKED else value


def set_number(folder, field, value):
    """Set one of `NUMBERS` in the first frame or in `dataset.json`."""
    file, *path = field

    def change(content):
        *parents, last = path
        inner = content
        for name in parents:
            inner = inner[int(name) if isinstance(inner, list) else name]
        inner[int(last) if isinstance(inner, list) else last] = value
        return content

    if file == "frame":
        edit_frame(folder, 0, change)
    else:
        edit_json(folder / "dataset.json", change)


def edit_json(path, change):
    path.write_bytes(canonical_json(change(json.loads(path.read_bytes()))))


def edit_frame(folder, index, change):
    """Change a frame's JSON, and its checksum with it, so that the frame counts as intact."""

    def with_checksum(content):
        content = change(content)
        content.pop("checksum")
        return {**content, "checksum": checksum_of(content)}

    edit_json(folder / "frames" / f"{index:06d}.json", with_checksum)
