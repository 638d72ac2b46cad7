"""TOML files of the tuned cultivar and flash: they extend the originals and state what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash, load_flash
from pepperscene.cultivar import Cultivar, PigmentPath, Pigments
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.materials.leaf import gloss_lobes
from pepperscene.spectra import read_provenance
from pepperscene.spectra.files import find_material
from pepperscene.tuning.least_squares import FitResult
from pepperscene.tuning.report import RunInfo, describe_colours, describe_values, toml_text
from pepperscene.tuning.tuned import round_for_file, tuned_flash

_TOLERANCE: Final = 1e-6
"""Chosen: largest change of a content when a knot is removed, relative to its range along the path."""
_SAME: Final = 1e-9  # chosen: relative difference below which a path has not changed
_COLUMN: Final = "relative_power"


def changed_paths(cultivar: Cultivar, pigments: Mapping[str, PigmentPath]) -> dict[str, PigmentPath]:
    """Paths that differ from the cultivar's, by surface, in the cultivar's order."""
    return {
        name: pigments[name]
        for name, path in cultivar.pigments.items()
        if name in pigments and not _same_path(path, pigments[name])
    }


def cultivar_text(
    cultivar: Cultivar, extends: str, pigments: Mapping[str, PigmentPath], fit: FitResult, run: RunInfo
) -> str:
    """Return the TOML of a cultivar with changed pigment paths, which extends the cultivar's file."""
    surfaces = " and ".join(pigments)
    tables = {
        "extends": extends,
        "name": f"{cultivar.name}, tuned",
        "source": f"{cultivar.source}; the pigments of {surfaces}: tuned, see their sources",
        "pigments": {
            name: _path_table(name, path, cultivar.pigments[name], fit, run)
            for name, path in pigments.items()
        },
    }
    head = (
        f"{cultivar.name} with the pigments of {surfaces} tuned to measured colour; all else is inherited.\n"
        f"{run.summary()}.\n{describe_colours(fit)}."
    )
    return toml_text(tables, head, depth=2)


def _path_table(
    surface: str, path: PigmentPath, original: PigmentPath, fit: FitResult, run: RunInfo
) -> dict[str, Any]:
    """A pigment path as in cultivar files."""
    fitted = [parameter for parameter in fit.parameters if parameter.name.partition(".")[0] == surface]
    source = f"{run.summary()}: {'; '.join(describe_values(fit, parameter) for parameter in fitted)}"
    if original.source.strip():
        source += f". Before tuning: {original.source}"
    table: dict[str, Any] = {"source": source}
    for key in ("chosen", "as_printed", "used"):
        if text := getattr(original, key).strip():
            table[key] = f"Before tuning: {text}"
    if path.flesh_reflectance is not None:
        table["flesh_reflectance"] = path.flesh_reflectance
    simple = simplify_path(path)
    table |= {"ior": path.ior, "roughness": path.roughness}
    if path.wide_roughness is not None:
        table |= {"wide_roughness": path.wide_roughness, "wide_share": path.wide_share}
    table |= {"start": _contents(simple.start), "end": _contents(simple.end)}
    if simple.path:
        table["path"] = [[state, _contents(pigments)] for state, pigments in simple.path]
    if simple.ageing:
        table["ageing"] = [[fraction, _contents(pigments)] for fraction, pigments in simple.ageing]
    return table


def _contents(pigments: Pigments) -> dict[str, float]:
    """Contents that differ from the defaults of files."""
    fields = Pigments.model_fields
    contents = {name: round_for_file(getattr(pigments, name)) for name in fields}
    return {n: v for n, v in contents.items() if fields[n].is_required() or v != fields[n].default}


def _same_path(first: PigmentPath, second: PigmentPath) -> bool:
    """Whether two paths have the same contents at every state, flesh and cuticle."""
    if bool(first.ageing) != bool(second.ageing):
        return False
    states = sorted({state for path in (first, second) for state, _ in path.knots})
    a, b = (np.array(list(path.at(states).values())) for path in (first, second))
    if not np.allclose(a, b, rtol=_SAME, atol=_SAME * max(float(np.abs(a).max()), 1e-300) * 1e-3):
        return False
    a, b = (
        np.array(
            [path.flesh_reflectance or 0.0, path.ior, *np.ravel([gloss_lobes(path, side) for side in (0, 1)])]
        )
        for path in (first, second)
    )
    return a.size == b.size and np.allclose(a, b, rtol=_SAME, atol=0.0)


def simplify_path(path: PigmentPath) -> PigmentPath:
    """Return the path with the fewest of its knots that keep every content to a millionth of its range.

    The knots of `ageing`, which no fit changes, stay.
    """
    knots = [(state, pigments) for state, pigments in path.knots if state >= 0.0]
    states = np.array([state for state, _ in knots])
    contents = np.array([[getattr(at, name) for name in Pigments.model_fields] for _, at in knots])
    tolerance = _TOLERANCE * np.ptp(contents, axis=0) + 1e-12 * np.abs(contents).max(axis=0)
    kept = _fewest_knots(states, contents, tolerance)
    return path.model_copy(update={"path": tuple(knots[i] for i in kept[1:-1])})


def _fewest_knots(
    states: NDArray[np.float64], contents: NDArray[np.float64], tolerance: NDArray[np.float64]
) -> Sequence[int]:
    """Indices of the fewest knots, including the ends, that keep all contents within the tolerance.

    A segment from knot i to knot j is allowed if the line between them is close enough to all knots in
    between. The fewest segments from the first to the last knot are a shortest path (Imai & Iri 1988).
    """

    def allowed(i: int, j: int) -> bool:
        weight = ((states[i + 1 : j] - states[i]) / (states[j] - states[i]))[:, None]
        line = contents[i] + weight * (contents[j] - contents[i])
        return bool((np.abs(line - contents[i + 1 : j]) <= tolerance).all())

    count = len(states)
    segments, previous = [0, *[count] * (count - 1)], [0] * count
    for j in range(1, count):
        for i in range(j):
            if segments[i] + 1 < segments[j] and allowed(i, j):
                segments[j], previous[j] = segments[i] + 1, i
    kept = [count - 1]
    while kept[-1]:
        kept.append(previous[kept[-1]])
    return kept[::-1]


def flash_files(name: str, fit: FitResult, run: RunInfo, stem: str) -> tuple[Flash, dict[str, str]]:
    """Return the tuned flash, and the texts of its files by name: flash (`stem`), spectrum, provenance."""
    path = find_material("flashes", name)
    original = load_flash(name)
    flash = tuned_flash(original, fit.tuned_parts)
    fitted = [
        describe_values(fit, parameter) for parameter in fit.parameters if parameter.name.startswith("flash.")
    ]
    tuned = f"{run.summary()}: {'; '.join(fitted)}"

    key = "illuminance_lx" if original.illuminance_lx is not None else "irradiance_W_m2"
    spectrum = f"{stem}_spectrum"
    tables: dict[str, Any] = dict(read_toml(path))
    tables |= {key: getattr(flash, key), "name": f"{original.name}, tuned"}
    tables["spectrum"] = {"file": f"{spectrum}.csv", "column": _COLUMN}
    sources = dict(tables["sources"])
    factors = f"{getattr(original, key):g} times power and the change of the spectrum"
    sources[key] = f"{tuned}; {factors}. Before tuning: {sources[key]}"
    sources["spectrum"] = f"{tuned}; see {spectrum}.toml. Before tuning: {sources['spectrum']}"
    tables["sources"] = sources
    rows = zip(flash.spectrum.wavelength_nm.tolist(), flash.spectrum.values.tolist(), strict=True)
    texts = {
        f"{stem}.toml": toml_text(tables, f"The flash {path.stem}, tuned to measured colour.\n{tuned}."),
        f"{spectrum}.csv": f"wavelength_nm,{_COLUMN}\n"
        + "".join(f"{nm:.12g},{value!r}\n" for nm, value in rows),
        f"{spectrum}.toml": toml_text(_spectrum_provenance(path, tables["licence"], tuned)),
    }
    return flash, texts


def flash_changed(fit: FitResult) -> bool:
    """Whether a fit changed the flash."""
    factors = fit.tuned_parts.flash_factors
    return abs(fit.tuned_parts.flash_power - 1.0) > 1e-12 or bool((np.abs(factors - 1.0) > 1e-12).any())


def _spectrum_provenance(flash: Path, licence: str, tuned: str) -> dict[str, Any]:
    """Provenance of the tuned spectrum, with licence and source of the original where they are known."""
    original, source, unit = read_toml(flash)["spectrum"], "", "relative"
    for candidate in (flash.parent / original["file"], Path(str(original["file"]).removesuffix(".csv"))):
        try:
            known = read_provenance(candidate)
        except InputError:
            continue
        licence, source, unit = known.licence, f" Before tuning: {known.source}", known.unit
        break
    return {
        "title": f"Spectrum of the flash {flash.stem}, tuned to measured colour",
        "kind": "MODEL",
        "unit": unit,
        "source": f"{tuned}.{source}",
        "licence": licence,
        "note": f"The spectrum {original['file']}, column {original['column']}, times factors, "
        "linear between nodes, over the range of the sensor",
    }
