"""The file of a tuned flash, with its spectrum: what the renderer saw while it was tuned."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.camera import Flash, load_flash
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, read_provenance
from pepperscene.spectra.files import find_material
from pepperscene.spectra.lights import illuminance
from pepperscene.tuning.output.provenance import RunInfo, values_told
from pepperscene.tuning.output.toml_text import document, rounded

if TYPE_CHECKING:
    from pepperscene.tuning.fit.result import FitResult


COLUMN: Final = "relative_power"
_FOLDER: Final = "flashes"


def tuned_spectrum(spectrum: Spectrum, nodes_nm: ArrayLike, factors: ArrayLike) -> Spectrum:
    """The spectrum times factors that are linear between nodes and held beyond them.

    It is told at every whole nanometre, where the renderer reads it, and at all nodes of both.
    """
    low, high = spectrum.range_nm
    nodes = np.asarray(nodes_nm, float)
    whole = np.arange(np.ceil(low), np.floor(high) + 1.0)
    nm = np.union1d(np.union1d(spectrum.wavelength_nm, whole), nodes[(nodes >= low) & (nodes <= high)])
    # What only rounding tells apart from a whole nanometre would be a second row of the same.
    nm = np.unique(nm.round(6))
    factor = np.interp(nm, nodes, np.asarray(factors, float)) if nodes.size else np.ones(nm.size)
    held = Spectrum(spectrum.wavelength_nm, spectrum.values, "hold")
    values = np.array([rounded(value) for value in held.at(nm) * factor])
    return Spectrum(nm, values, spectrum.outside)


@dataclass(frozen=True, eq=False)
class FlashFiles:
    """A tuned flash and the texts of its files by name: its own, its spectrum, and where that comes from."""

    flash: Flash
    texts: dict[str, str]


def flash_files(wanted: str, fit: FitResult, occasion: RunInfo, stem: str) -> FlashFiles:
    """The flash of a recipe as it was tuned.

    Args:
        wanted: the flash that was tuned: shipped name or path.
        fit: that tuned it.
        occasion: when and to what.
        stem: of the flash's file.

    Raises:
        InputError: the flash cannot be read.
    """
    path = find_material(_FOLDER, wanted)
    flash = load_flash(wanted)
    spectrum = tuned_spectrum(flash.spectrum, fit.tuned.flash_nodes_nm, fit.tuned.flash_spectrum)
    how = f"{occasion.told()}: {'; '.join(_values(fit))}"

    # Whichever way the strength is told, the light itself is the old one's times power times factors.
    tables: dict[str, Any] = dict(read_toml(path))
    if flash.illuminance_lx is not None:
        share = illuminance(spectrum) / illuminance(flash.spectrum)
        strength, told = "illuminance_lx", flash.illuminance_lx
    else:
        share = float(spectrum.integral()) / float(flash.spectrum.integral())
        assert flash.irradiance_W_m2 is not None  # exactly one is given
        strength, told = "irradiance_W_m2", flash.irradiance_W_m2
    tables[strength] = told * fit.tuned.flash_power * share
    tables["name"] = f"{flash.name}, tuned"
    file = f"{stem}_spectrum"
    tables["spectrum"] = {"file": f"{file}.csv", "column": COLUMN}
    sources = dict(tables["sources"])
    note = f"{told:g} times power and the change of the spectrum"
    sources[strength] = f"{how}; {note}. Before that: {sources[strength]}"
    sources["spectrum"] = f"{how}; see {file}.toml. Before that: {sources['spectrum']}"
    tables["sources"] = sources
    texts = {
        f"{stem}.toml": document(tables, head=f"The flash {path.stem}, tuned to measured colour.\n{how}."),
        f"{file}.csv": _csv(spectrum),
        f"{file}.toml": document(_provenance(path, tables["licence"], how)),
    }
    changed: dict[str, Any] = {"name": tables["name"], "spectrum": spectrum, strength: tables[strength]}
    return FlashFiles(dataclasses.replace(flash, **changed), texts)


def is_tuned(fit: FitResult) -> bool:
    """Whether the flash is another one than before."""
    factors = np.asarray(fit.tuned.flash_spectrum, float)
    return abs(fit.tuned.flash_power - 1.0) > 1e-12 or bool((np.abs(factors - 1.0) > 1e-12).any())


def _values(fit: FitResult) -> list[str]:
    return [values_told(fit, one) for one in fit.parameters if one.name.startswith("flash.")]


def _csv(spectrum: Spectrum) -> str:
    rows = zip(spectrum.wavelength_nm.tolist(), spectrum.values.tolist(), strict=True)
    return f"wavelength_nm,{COLUMN}\n" + "".join(f"{nm:.12g},{value!r}\n" for nm, value in rows)


def _provenance(flash: Path, licence: str, how: str) -> dict[str, Any]:
    """Where the spectrum comes from: the licence is that of the one that was tuned, where that is known."""
    told, source, unit = read_toml(flash)["spectrum"], "", "relative"
    for candidate in (flash.parent / told["file"], Path(str(told["file"]).removesuffix(".csv"))):
        try:
            known = read_provenance(candidate)
        except InputError:
            continue
        licence, source, unit = known.licence, f" Before that: {known.source}", known.unit
        break
    return {
        "title": f"Spectrum of the flash {flash.stem}, tuned to measured colour",
        "kind": "MODEL",
        "unit": unit,
        "source": f"{how}.{source}",
        "licence": licence,
        "note": f"The spectrum {told['file']}, column {told['column']}, times factors "
        "that are linear between nodes over the range that the sensor sees",
    }
