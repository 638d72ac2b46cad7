"""A validated recipe, and the identity of the data set that it defines."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, PrivateAttr

from pepperscene import atomic
from pepperscene.camera import Developing
from pepperscene.camera.isp.processor import TONE_CURVES, load_processor, read_tone_curve
from pepperscene.camera.lamps.photometric_files import ENDINGS
from pepperscene.document import Document, read_toml
from pepperscene.materials.stand import STAND_COLOURS
from pepperscene.recipe import tables
from pepperscene.recipe.camera_tables import (
    AUTO,
    MAX_CAMERAS,
    AutoExposureTable,
    CameraTable,
    DepthCameraTable,
    RigCamera,
    Twins,
)
from pepperscene.recipe.plan import Plan, check_seed
from pepperscene.recipe.variation.varied import Varied
from pepperscene.recipe.views_tables import ViewsTable
from pepperscene.scene import Daylight, DoubleRow, Greenhouse, Stand, Twine
from pepperscene.spectra import read_spectra
from pepperscene.spectra.files import curve_file, find_material, spectra_file
from pepperscene.units import NONE, TABLE_CONFIG, Name

_REFERENCE: Final = "file"
"""Key whose value is the path of a CSV file of spectra, relative to the file that holds it."""

_POSES: Final = "poses"
_CALIBRATIONS: Final = "calibrations"
_COLOURS: Final = "colours"
_ISPS: Final = "isps"
_TONES: Final = "tones"

FILE_FOLDERS: Final[Mapping[tuple[str, ...], str | None]] = {
    ("cultivar",): None,
    ("growth", "until"): None,
    ("camera", "sensor"): "sensors",
    ("camera", "lens"): "lenses",
    ("camera", "flash"): "flashes",
    ("camera", "filter"): "filters",
    ("camera", "calibration"): _CALIBRATIONS,
    ("depth_camera", "sensor"): "sensors",
    ("depth_camera", "lens"): "lenses",
    ("depth_camera", "filter"): "filters",
    ("depth_camera", "calibration"): _CALIBRATIONS,
    ("depth_camera", "projector"): "projectors",
    ("daylight", "cover"): "covers",
    ("skin_texture",): "skins",
    ("lamps", "lamp"): "lamps",
    ("views", "file"): _POSES,
    ("developing", "isp", "preset"): _ISPS,
    ("developing", "isp", "tone_curve"): _TONES,
    ("stand", "pot_colour"): _COLOURS,
    ("stand", "backdrop_colour"): _COLOURS,
}
"""Keys whose values name files, and the folder of the shipped ones; None for cultivars."""


def curve_keys(tables: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Keys of the files of measured curves in a recipe's tables, whose values may be of a wrong type."""
    override, twins = tables.get("override"), tables.get("twins")
    curves = override.get("spectra") if isinstance(override, dict) else None
    names = [*curves] if isinstance(curves, dict) else []
    dotted = [key.split(".") for key in twins] if isinstance(twins, dict) else []
    names += [key[2] for key in dotted if key[:2] + key[3:] == ["override", "spectra", _REFERENCE]]
    return tuple(("override", "spectra", name, _REFERENCE) for name in dict.fromkeys(names))


class Recipe(Document):
    """A recipe fully defines a data set: with the package version it determines every byte of a frame.

    Attributes:
        name: of the data set.
        seed: of all random numbers.
        cultivar: shipped name or path.
        plan, row, views, camera, developing: the tables.
        auto_exposure: for an exposure of "auto"; None for its defaults.
        depth_camera: a further stereo depth camera, or None.
        white_reference: of the output `reflectance`, or None for its defaults.
        override: values of the cultivar file that this recipe changes.
        rig: further cameras that move with `camera`.
        twins: values by dotted key, one for each twin: frames that differ in these values only.
        daylight: or None for a night scene.
        lamps: of the scene and the main camera.
        twine: or None for none.
        skin_texture: shipped name or path of the fine texture of skins, for close views, or "none".
        growth: a stage between two cultivar files, or None for the cultivar as in its file.
        greenhouse: surroundings of an irregular row, or None for evenly spaced, upright plants alone.
        stand: pot, backdrop and charts of a single plant, or None.
        expect: expected statistics of the finished data set, or None; see `pepperscene check`.
    """

    model_config = TABLE_CONFIG

    name: Name
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)]
    cultivar: Name
    plan: Plan
    row: DoubleRow
    views: ViewsTable
    camera: CameraTable
    developing: Developing = Developing()
    daylight: Daylight | None = None
    twine: Twine | None = None
    skin_texture: Name = NONE
    growth: tables.GrowthTable | None = None
    greenhouse: Greenhouse | None = None
    stand: Stand | None = None
    expect: tables.ExpectTable | None = None
    auto_exposure: AutoExposureTable | None = None
    depth_camera: DepthCameraTable | None = None
    white_reference: tables.WhiteReferenceTable | None = None
    override: dict[str, Any] = Field(default_factory=dict)
    rig: Annotated[tuple[RigCamera, ...], Field(max_length=MAX_CAMERAS - 1)] = ()
    twins: Twins = Field(default_factory=dict)
    lamps: tuple[tables.LampTable, ...] = ()
    _variation: tuple[Varied, ...] = PrivateAttr(())

    @property
    def variation(self) -> tuple[Varied, ...]:
        """The values that are drawn for each set, scene or frame; fields hold typical values for them."""
        return self._variation

    @property
    def exposure_control(self) -> AutoExposureTable | None:
        """What automatic exposure aims at; None if the exposure is given."""
        return self.metering if self.camera.exposure_s == AUTO else None

    @property
    def metering(self) -> AutoExposureTable:
        """What automatic exposure aims at, whether or not the exposure is given."""
        return self.auto_exposure or AutoExposureTable()

    def with_variation(self, variation: tuple[Varied, ...]) -> Recipe:
        """The recipe with these varied values."""
        recipe = self.model_copy()
        recipe._variation = variation  # a private attribute, as it is no key of the file
        return recipe

    def with_seed(self, seed: int | None) -> Recipe:
        """The recipe with another seed, or itself if that is None; errors as in `check_seed`."""
        return self if seed is None else self.model_copy(update={"seed": check_seed(seed)})

    def identity(self) -> dict[str, Any]:
        """All values that frames depend on and that are no defaults, and the files that the recipe names.

        Paths are reduced to names, so that the identity is the same on every machine. `plan.select` and
        `expect` are left out, because they change no frame.

        Returns:
            Ready for JSON: the recipe's values under `recipe`, and under `files` a `name` and a `sha256` of
                each file: the cultivar, those that it extends, its scans, devices, the cover, their spectra,
                and files of poses.

        Raises:
            InputError: one of these files is missing or cannot be read.
        """
        recipe = self.model_dump(
            mode="json", exclude={"plan": {"select"}, "expect": True}, exclude_defaults=True
        )
        if self.variation:
            recipe["variation"] = {varied.name: varied.identity() for varied in self.variation}

        files: dict[str, dict[str, str]] = {}
        for dotted, folder in FILE_FOLDERS.items():
            for number, name in enumerate(self._names(dotted)):
                is_short = folder is not None and dotted[0] != "depth_camera"
                part = dotted[-1] if is_short else ".".join(dotted)
                if number:
                    part = f"{part}.{Path(name).stem}"
                    # Files of the same name in different folders.
                    part += f".{number}" if part in files else ""
                files |= _fingerprints(part, folder, name)
        for key in curve_keys({"override": self.override, "twins": self.twins}):
            for number, file in enumerate(map(Path, self._names(key))):
                files[f"{'.'.join(key)}.{number}"] = _fingerprint(file, atomic.digest(file, "spectra"))
        return {"recipe": _without_folders(recipe), "files": files}

    def _names(self, key: tuple[str, ...]) -> list[str]:
        """All names of files that a key can have in any frame; the recipe's own comes first."""
        value: Any = self
        for part in key:
            value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
        lamps = [lamp.lamp for lamp in self.lamps] if key[0] == "lamps" else []
        dotted = ".".join(key)
        varied = [name for v in self.variation if v.name == dotted for name in v.extremes]
        rig = [camera.camera.get(key[1]) for camera in self.rig if key[0] == "camera"]
        names = dict.fromkeys([*lamps, value, *varied, *self.twins.get(dotted, ()), *rig])
        return [name for name in names if isinstance(name, str) and name != NONE]

    def sha256(self) -> str:
        """SHA-256 of the identity as canonical JSON, hexadecimal."""
        return digest(self.identity())


def _without_folders(value: Any) -> Any:
    """Nested values with paths of files reduced to the files' names."""
    if isinstance(value, dict):
        return {_without_folders(key): _without_folders(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_folders(item) for item in value]
    return Path(value).stem if isinstance(value, str) and os.path.isabs(value) else value


def _fingerprints(part: str, folder: str | None, name: str) -> dict[str, dict[str, str]]:
    """Names and digests of a file that a recipe names, and of those that it refers to."""
    if folder is None:
        return _cultivar_fingerprints(part, name)
    path = Path(name)
    if folder == _CALIBRATIONS:
        from pepperscene.camera.optics.calibration import read_calibration

        return {part: _fingerprint(path, read_calibration(path).to_json())}
    if folder == _COLOURS:
        file = None if name in STAND_COLOURS else spectra_file(name)
        return {} if file is None else {part: _fingerprint(file, _spectra_values(file))}
    if folder == _ISPS:
        return {part: _fingerprint(find_material(folder, name), load_processor(name).to_metadata())}
    if folder == _TONES:
        return {} if name in TONE_CURVES else {part: _fingerprint(path, read_tone_curve(name))}
    if folder == _POSES:
        return {part: {"name": path.stem, "sha256": atomic.digest(path, "mesh")}}
    return _material_fingerprints(part, find_material(folder, name))


def _material_fingerprints(part: str, file: Path) -> dict[str, dict[str, str]]:
    """Name and digest of a material file, under `part`, and of the spectra files that it refers to.

    Only values count: comments, layout and folders do not. A spectrum's key ends with those of the tables
    that name it ("sensor.quantum_efficiency").
    """
    if file.suffix.lower() in ENDINGS:
        return {part: {"name": file.stem, "sha256": atomic.digest(file, "spectra")}}
    content = read_toml(file)
    fingerprints = {part: _fingerprint(file, content)}
    for table, reference in _references(content):
        if reference.lower().endswith(ENDINGS):
            fingerprints |= _material_fingerprints(".".join((part, *table)), file.parent / reference)
            continue
        path = curve_file(file, reference)
        fingerprints[".".join((part, *table))] = _fingerprint(path, _spectra_values(path))
    return fingerprints


def _spectra_values(path: Path) -> dict[str, Any]:
    curves = read_spectra(path)
    return {name: [c.wavelength_nm.tolist(), c.values.tolist()] for name, c in curves.items()}


def _cultivar_fingerprints(part: str, cultivar: str) -> dict[str, dict[str, str]]:
    """Name and digest of a cultivar's file, under `part`, and of those it extends and its scans, numbered."""
    from pepperscene.cultivar import cultivar_files

    fingerprints: dict[str, dict[str, str]] = {}
    for number, file in enumerate(cultivar_files(cultivar)):
        key = f"{part}.{number}" if number else part
        if file.suffix == ".toml":
            fingerprints[key] = _fingerprint(file, read_toml(file))
        else:
            fingerprints[key] = {"name": file.stem, "sha256": atomic.digest(file, "mesh")}
    return fingerprints


def _fingerprint(file: Path, values: Any) -> dict[str, str]:
    return {"name": file.stem, "sha256": digest(values)}


def _references(table: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the keys of each table that refers to a file, and the path."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        if key == _REFERENCE and isinstance(value, str):
            yield above, value
        else:
            yield from _references(value, (*above, str(key)))


def digest(values: Any) -> str:
    """SHA-256 of values as canonical JSON, hexadecimal."""
    text = json.dumps(values, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()
