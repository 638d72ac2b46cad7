"""Everything that a single frame can be wrong in, each of its files read once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.check import findings as told
from pepperscene.dataset.check.edges import CHANCE, Match, match
from pepperscene.dataset.check.findings import Finding
from pepperscene.dataset.check.images import flat, picture_faults, tone, value_faults
from pepperscene.dataset.check.labels import harvest_faults, label_faults
from pepperscene.dataset.recipe.plan import Plan, frame_seed
from pepperscene.dataset.store.dataset import CHECKSUM, FRAMES, Dataset, checksum_of, file_name
from pepperscene.dataset.store.images import read_image
from pepperscene.dataset.store.manifest import frame_row
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS
from pepperscene.truth import class_pixel_counts

_JOURNALS: Final = ("render_s", "write_s", "worker")
"""Of the manifest's columns those that do not come out of the frame."""


@dataclass(frozen=True)
class FrameTraits:
    """What of a frame is compared with other frames, the manifest and the recipe.

    Digests are of 64 bits, and 0 where there is nothing to compare: of a million frames, two that differ have
    the same one with a probability of 3e-8.

    Attributes:
        index: of the frame.
        scene: its set and rotation as one number, or None where the JSON does not say.
        picture: digest of its first traced image that is not flat.
        content: digest of all its files, unless all images are flat.
        view: digest of pose and seed.
        row: digest of what the manifest must say of it.
        shares: of the eight classes, or None without a class image.
        mean: grey value of the photograph, or None without one.
        saturated: share of its pixels.
    """

    index: int
    scene: int | None = None
    picture: int = 0
    content: int = 0
    view: int = 0
    row: int = 0
    shares: tuple[float, ...] | None = None
    mean: float | None = None
    saturated: float = 0.0


def traits_of(
    index: int, facts: Mapping[str, Any], digests: Mapping[str, str], images: Mapping[str, Any]
) -> FrameTraits:
    """What of a frame is compared with others.

    Args:
        index: of the frame.
        facts: its JSON.
        digests: SHA-256 of its files by output name.
        images: by output name, those that could be read.
    """
    # A frame of flat images (all sky, no light) may look like another one.
    varied = [name for name, image in images.items() if OUTPUTS[name].is_image and not flat(image)]
    traced = next((name for name in varied if OUTPUTS[name].traced), None)
    light = tone(images["colour"]) if "colour" in images else None
    pose, seed = told.pose(facts), facts.get("seed")
    outputs = {name: one for name, one in told.table(facts, "outputs").items() if name in OUTPUTS}
    return FrameTraits(
        index,
        scene=_scene(facts.get("set"), facts.get("rotation")),
        picture=_digest(np.ascontiguousarray(images[traced]).data) if traced else 0,
        content=_digest(json.dumps(digests, sort_keys=True).encode()) if varied else 0,
        view=0 if pose is None or seed is None else _digest(json.dumps([pose.tolist(), seed]).encode()),
        row=_row_digest(facts, outputs),
        shares=_shares(images.get("class")),
        mean=light.mean if light else None,
        saturated=light.saturated if light else 0.0,
    )


def _scene(group: Any, rotation: Any) -> int | None:
    known = isinstance(group, int) and isinstance(rotation, int)
    # The recipe allows at most 1000 rotations.
    return group * 1000 + rotation if known else None


def _shares(classes: NDArray[np.uint8] | None) -> tuple[float, ...] | None:
    if classes is None or classes.max() >= len(OrganClass):
        return None
    return tuple(count / classes.size for count in class_pixel_counts(classes).values())


def _row_digest(facts: Mapping[str, Any], outputs: dict[str, Any]) -> int:
    rest = {key: value for key, value in facts.items() if key not in (CHECKSUM, "outputs")}
    try:
        return manifest_digest(frame_row(rest, outputs, str(facts.get(CHECKSUM))))
    except (AttributeError, IndexError, KeyError, TypeError):
        # Such JSON is damaged, and told so.
        return 0


def manifest_digest(row: Mapping[str, Any]) -> int:
    """Digest of what a row of the manifest says of a frame, without what only the journal knows."""
    known = {name: value for name, value in row.items() if value is not None and name not in _JOURNALS}
    return _digest(json.dumps(known, sort_keys=True, default=str).encode())


def _digest(content: bytes | memoryview) -> int:
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest())


PICTURES: Final = ("colour", "colour_stereo")


@dataclass(frozen=True)
class FrameExamination:
    """A frame, examined by itself.

    Attributes:
        findings: its faults.
        traits: what is compared with others.
        harvested: whether its JSON names the output harvest.
    """

    findings: tuple[Finding, ...]
    traits: FrameTraits
    harvested: bool = False


def examine_frame(dataset: Dataset, index: int) -> FrameExamination:
    """Examine one frame of a data set by itself."""
    where = f"{FRAMES}/{dataset.frame_path(index).name}"
    try:
        facts = dataset.metadata(index)
    except InputError as fault:
        return FrameExamination((Finding("damaged", index, where, _reason(fault)),), FrameTraits(index))
    findings = [Finding(kind, index, where, what) for kind, what in _facts_faults(dataset, facts, index)]

    # Files first: what of them is there, and is it what was written?
    digests: dict[str, str] = {}
    images: dict[str, Any] = {}
    for output, entry in told.table(facts, "outputs").items():
        name = file_name(index, output) if output in OUTPUTS else where
        for kind, what in _file_faults(dataset, index, output, entry, digests, images):
            findings.append(Finding(kind, index, name, what))
    for output, what in _misshapen(images, facts):
        findings.append(Finding("shape", index, file_name(index, output), what))
        del images[output]

    # Then what they show, as far as it can be read.
    for kind, output, what in _content_faults(images, facts):
        findings.append(Finding(kind, index, file_name(index, output), what))
    harvested = "harvest" in told.table(facts, "outputs")
    return FrameExamination(tuple(findings), traits_of(index, facts, digests, images), harvested)


def _facts_faults(dataset: Dataset, facts: dict[str, Any], index: int) -> Iterator[tuple[str, str]]:
    """Kind and description of what is wrong with a frame's JSON in itself."""
    if CHECKSUM not in facts:
        yield "damaged", "has no checksum"
    elif facts[CHECKSUM] != checksum_of(facts):
        yield "damaged", "is not what was written: its checksum is another"
    if not isinstance(facts.get("outputs"), dict) or not facts["outputs"]:
        yield "damaged", "names no outputs"
    recipe = told.table(dataset.info, "recipe")
    expected: dict[str, Any] = {"index": index}
    try:
        plan = Plan.model_validate(recipe["plan"])
        shot = plan.frame(index)
        expected |= {"set": shot.set, "rotation": shot.rotation, "step": shot.step}
        expected |= {"recipe_seed": recipe["seed"], "seed": frame_seed(recipe["seed"], index)}
    except KeyError:
        # A damaged dataset.json is told once, not with every frame.
        pass
    except (ValueError, TypeError):
        yield "contradiction", "lies outside the plan of dataset.json"
    for key, value in expected.items():
        if facts.get(key) != value:
            yield "contradiction", f"says {key} = {facts.get(key)!r}, by its place in the plan it is {value}"


def _file_faults(
    dataset: Dataset, index: int, output: str, entry: Any, digests: dict[str, str], images: dict[str, Any]
) -> Iterator[tuple[str, str]]:
    """Read one file into `digests` and `images`, and tell what is wrong with it."""
    if output not in OUTPUTS:
        yield "contradiction", f"names the output {output!r}, which there is not"
        return
    path = dataset.folder / file_name(index, output)
    try:
        digests[output], size = _read_digest(path)
    except FileNotFoundError:
        yield "missing", "is not there"
        return
    except OSError as fault:
        yield "unreadable", f"cannot be read ({fault.strerror})"
        return
    said = entry if isinstance(entry, dict) else {}
    if said.get("file") != file_name(index, output):
        yield "contradiction", f"is called {said.get('file')!r} in the frame's JSON"
    if said.get("bytes") != size:
        yield "checksum", f"has {size} bytes, the frame's JSON says {said.get('bytes')}"
        return
    if said.get("sha256") != digests[output]:
        yield "checksum", "has other content than was written: its checksum is another"
        return
    # What a damaged file shows says nothing of what was rendered.
    try:
        images[output] = read_image(path)
    except InputError as fault:
        yield "unreadable", _reason(fault)


def _misshapen(images: Mapping[str, Any], facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Output and description of images of the wrong type, or of another size than the camera's."""
    size = told.number(facts, "height"), told.number(facts, "width")
    found = []
    for output, image in images.items():
        wanted = OUTPUTS[output]
        if not wanted.fits(image):
            is_array = hasattr(image, "dtype")
            what = f"{image.shape} {image.dtype}" if is_array else type(image).__name__
            found.append((output, f"is {what}, not {wanted.shape} {wanted.dtype}"))
        elif wanted.is_image:
            each = told.number(facts, "binning", 1) if output == "raw" else 1
            if image.shape[:2] != (size[0] * each, size[1] * each):
                held = f"{image.shape[1]}x{image.shape[0]}"
                found.append((output, f"has {held} pixels, the camera {size[1] * each}x{size[0] * each}"))
    return found


def _content_faults(images: Mapping[str, Any], facts: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Kind, output and description of what is wrong with what images show."""
    good = "colour" in images
    for output in PICTURES:
        if output in images:
            for kind, what in picture_faults(images[output]):
                good = good and output != "colour"
                yield kind, output, what
    yield from label_faults(images, facts)
    yield from value_faults(images, facts)
    yield from harvest_faults(images, facts)
    labels = next((name for name in ("instance", "class") if name in images), None)
    # A picture that shows nothing has been told as such.
    if good and labels is not None:
        found = match(images["colour"], images[labels])
        if found is not None and not found.fits:
            yield "edges", labels, _misfit(found)


def _misfit(found: Match) -> str:
    if found.height < CHANCE:
        return "fits the photograph at no shift: mirrored, or another frame's"
    where = f"its {found.quarter} quarter lies" if found.quarter else "lies"
    return (
        f"{where} {found.right_px:+d} px to the right of and {found.down_px:+d} px below "
        f"the photograph's edges ({found.height:.0f} standard deviations above other shifts)"
    )


def _read_digest(path: Path) -> tuple[str, int]:
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256")
        return found.hexdigest(), file.tell()


def _reason(fault: InputError) -> str:
    return fault.problem
