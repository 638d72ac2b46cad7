"""Correct data sets of discs in front of each other, and consistent changes of their files."""

from __future__ import annotations

import json

import numpy as np
from data_sets import D435, set_without_plants
from stand_in import SceneStandIn

from pepperscene.atomic import digest, write_json
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.frame_json import checksum_of
from pepperscene.dataset.store.images import read_image, write_image
from pepperscene.frame import Frame
from pepperscene.outputs import METER_OUTPUTS, TRAIT_OUTPUTS
from pepperscene.review.check import check_dataset
from pepperscene.review.check.one_frame import FrameChecker
from pepperscene.truth import class_colour, distance_code
from pepperscene.truth.encodings import encode_rle

HEIGHT, WIDTH = 150, 200
FAR_M = 3.0
IMAGER_SHAPE = 48, 64


def draw_discs(height, width, rng, discs, radii=(5, 25), background=60.0):
    """Colours and numbers of discs, each in front of those before, each in its own colour."""
    rows, columns = np.mgrid[:height, :width]
    labels = np.zeros((height, width), np.uint16)
    colour = np.full((height, width, 3), background)
    for number in range(1, discs + 1):
        x, y, radius = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(*radii)
        inside = (columns - x) ** 2 + (rows - y) ** 2 < radius**2
        labels[inside] = number
        colour[inside] = rng.uniform(40, 200, 3)
    return colour, labels


class DiscRenderer(SceneStandIn):
    """Renders discs, with all outputs consistent."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        rng = np.random.default_rng([int(abs(camera.pose[0, 3]) * 1e9), int(camera.pose[2, 3] * 1e9)])
        noise = np.random.default_rng(seed)
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        grey, instance = draw_discs(HEIGHT, WIDTH, rng, 89, (4, 22), 30.0)
        grey += noise.normal(0, 6, grey.shape)
        hit = instance > 0
        classes = np.where(hit, 1 + instance % 7, 0).astype(np.uint8)
        distance = np.where(hit, FAR_M - 0.03 * instance + 0.0005 * columns, np.inf).astype(np.float32)

        direction = np.stack([columns - WIDTH / 2, rows - HEIGHT / 2, np.full_like(rows, 120)], -1)
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        world = direction @ camera.pose[:3, :3].T
        with np.errstate(invalid="ignore"):
            position = camera.pose[:3, 3] + distance[..., None] * world
        imager = noise.integers(0, 256, IMAGER_SHAPE).astype(np.uint8)
        images = {
            "colour": np.clip(grey, 0, 255).astype(np.uint8),
            "photo": np.clip(grey, 0, 255).astype(np.uint8),
            "colour_stereo": np.clip(np.roll(grey, 5, 1), 0, 255).astype(np.uint8),
            "raw": noise.integers(0, 1024, (2 * HEIGHT, 2 * WIDTH)).astype(np.uint16),
            "electrons": np.maximum(grey, 0).astype(np.float32),
            "class": classes,
            "class_colour": class_colour(classes),
            "instance": instance,
            "distance": distance,
            "distance_code": distance_code(distance),
            "depth_z": (distance * direction[..., 2]).astype(np.float32),
            "normal": np.where(hit[..., None], -world, 0).astype(np.float32),
            "position": np.where(hit[..., None], position, np.inf).astype(np.float32),
            "uv": np.where(hit[..., None], 0.5, -1.0).repeat(2, -1).astype(np.float32),
            "coverage": (classes[..., None] == np.arange(len(OrganClass))).astype(np.float16),
            "flow": np.stack([np.full(hit.shape, np.nan)] * 2 + [np.zeros(hit.shape)], -1).astype(np.float32),
            "stereo": np.stack([hit * 0 + 5, hit * 0, columns < WIDTH - 5], -1).astype(np.float32),
            "depth_sensor": np.where(hit, distance * direction[..., 2], np.nan).astype(np.float32),
            "depth_confidence": np.where(hit, 0.75, 0.0).astype(np.float32),
            "imager_left": imager,
            "imager_right": np.roll(imager, -5, 1),
            "harvest": {"format": "pepperscene harvest 1", "fruit": [], "graph": {"nodes": [], "edges": []}},
            "albedo": np.clip(grey / 255, 0, 1).astype(np.float16),
            **{name: np.where(hit, 0.5, np.nan).astype(np.float32) for name in TRAIT_OUTPUTS | METER_OUTPUTS},
        }  # fmt: skip
        if "amodal" in outputs:
            images["amodal"] = {"format": "pepperscene amodal 1", "organs": whole_discs(instance, classes)}
        metadata = {
            "camera": {**camera.to_metadata(), "width": WIDTH, "height": HEIGHT, "binning": 2, "bits": 10},
            "instances": instance_entries(instance, classes),
            "depth_camera": {"width": IMAGER_SHAPE[1], "height": IMAGER_SHAPE[0]},
        }
        return Frame({name: images[name] for name in outputs}, metadata)


def instance_entries(instance, classes):
    entries = {}
    for number in np.unique(instance[instance > 0]).tolist():
        rows, columns = np.nonzero(instance == number)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        entries[str(number)] = {
            "class": int(classes[rows[0], columns[0]]), "kind": "disc", "plant": 0, "phytomer": 1,
            "parent": 0, "pixels": len(rows), "box": [int(edge) for edge in box],
        }  # fmt: skip
    return entries


def whole_discs(instance, classes):
    """Amodal masks of discs that are where they are visible only."""
    organs = []
    for number, entry in instance_entries(instance, classes).items():
        pixels, box = entry["pixels"], entry["box"]
        organs.append({
            "instance": int(number), "class": entry["class"], "kind": entry["kind"], "box": box,
            "amodal_box": box, "visible_pixels": pixels, "amodal_pixels": pixels, "visible_fraction": 1.0,
            "truncated": False, "occluders": [], "amodal": encode_rle(instance == int(number)),
        })  # fmt: skip
    return organs


def make_disc_set(folder, outputs):
    """A correct data set of 6 frames."""
    changes = {"plan.rotations": 1, "plan.frames": 3, "camera.baseline_mm": 60.0, **D435}
    set_without_plants(folder, range(6), outputs, DiscRenderer, changes)
    expected = {"intensity": [60, 140], "frame_intensity": [50, 150], "share": {"leaf": [0.05, 0.25]}}
    change_expectations(folder, **expected, saturated=0.01)
    return folder


def change_expectations(folder, **changes):
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    info["expect"] = {**info.get("expect", {}), **changes}
    path.write_text(json.dumps({**info, "checksum": checksum_of(info)}))


def sign(folder, index, changes=None, tables=True):
    """Make a frame's JSON consistent with its files, as only an error of the renderer could."""
    dataset = open_dataset(folder)
    metadata = {**dataset.metadata(index), **(changes or {})}
    for name, entry in metadata["outputs"].items():
        path = folder / entry["file"]
        if path.is_file():
            metadata["outputs"][name] = {**entry, "bytes": path.stat().st_size, "sha256": digest(path)}
    metadata["checksum"] = checksum_of(metadata)
    write_json(dataset.frame_path(index), metadata)
    if tables:
        rewrite_manifest(folder)


def rewrite_manifest(folder):
    (folder / "manifest.parquet").unlink(missing_ok=True)
    open_dataset(folder).write_tables()


def change_image(folder, index, output, change, tables=True):
    """Replace an image of a frame, with a consistent JSON."""
    path = folder / open_dataset(folder).metadata(index)["outputs"][output]["file"]
    write_image(path, change(read_image(path).copy()), output)
    sign(folder, index, tables=tables)


def find(folder, **arguments):
    """Kind, frame and file of each finding."""
    findings = check_dataset(folder, workers=1, **arguments).findings
    return {(finding.kind, finding.index, finding.file) for finding in findings}


def find_in_frame(folder, index):
    """Kind, frame and file of the findings of a single frame, which takes a sixth of the time."""
    findings, _ = FrameChecker(open_dataset(folder)).check(index)
    return {(finding.kind, finding.index, finding.file) for finding in findings}


def kinds_of(findings):
    return {kind for kind, *_ in findings}
