"""Where tuned numbers come from: which program, when, to which patches, how sure; in words and as JSON."""

from __future__ import annotations

import datetime
import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.tuning.fit.result import FitResult
    from pepperscene.tuning.parameters.parameter import Parameter


FORMAT: Final = "pepperscene tuning 1"


@dataclass(frozen=True)
class RunInfo:
    """When something was tuned, to what, and how it was asked for.

    Attributes:
        when: the date.
        patches: name of the set.
        sha256: of all its pixels and spectra.
        members: sha256 of each patch and each spectrum, by name.
        options: what else was asked for (seed, starts, ...), ready for JSON.
        version: of this package.
    """

    when: datetime.date
    patches: str
    sha256: str
    members: Mapping[str, str]
    options: Mapping[str, Any] = field(default_factory=dict)
    version: str = __version__

    @classmethod
    def of(cls, patches: PatchSet, when: datetime.date, options: Mapping[str, Any] | None = None) -> RunInfo:
        """The occasion on which something is tuned to these patches."""
        members = dict(_digests(patches))
        joined = "".join(f"{name}\0{digest}\n" for name, digest in sorted(members.items()))
        whole = hashlib.sha256(joined.encode()).hexdigest()
        return cls(when, patches.name, whole, members, dict(options or {}))

    def told(self) -> str:
        """By which program, when and to what, as the beginning of a sentence."""
        return (
            f"Tuned by pepperscene {self.version} on {self.when.isoformat()} to the patches "
            f"{self.patches!r} (sha256 of their pixels {self.sha256})"
        )


def entries(fit: FitResult, parameter: Parameter) -> Iterator[tuple[str, float, float, float]]:
    """Label, value, standard deviation and former value of each entry of a fitted parameter."""
    name = parameter.name
    rows = zip(
        parameter.labels,
        np.atleast_1d(fit.values[name]),
        np.atleast_1d(fit.sd[name]),
        np.atleast_1d(parameter.default),
        strict=True,
    )
    for label, value, sd, before in rows:
        yield f"{name} ({label})" if label else name, float(value), float(sd), float(before)


def values_told(fit: FitResult, parameter: Parameter) -> str:
    """Each entry of a parameter with its spread and what it was before."""
    unit = f" {parameter.unit}" if parameter.unit and parameter.unit != "1" else ""
    told = [
        f"{label} {with_spread(value, sd)}{unit} (was {plain(before, sd)})".strip()
        for label, (_, value, sd, before) in zip(parameter.labels, entries(fit, parameter), strict=True)
    ]
    return f"{parameter.name} {', '.join(told)}"


def colours_told(fit: FitResult) -> str:
    """How far the model's mean colours were from the patches', and are now."""
    kinds = [
        f"{name} {kind.delta_e_before:.2f} before, {kind.delta_e_after:.2f} after"
        for name, kind in fit.kinds.items()
    ]
    spectra = [
        f"{name} RMSE {one.rmse_before:.4f} before, {one.rmse_after:.4f} after"
        for name, one in fit.spectra.items()
    ]
    colours = [f"CIEDE2000 of mean colours: {'; '.join(kinds)}"] if kinds else []
    return ". ".join([*colours, *([f"Reflectance: {'; '.join(spectra)}"] if spectra else [])])


def with_spread(value: float, sd: float) -> str:
    """A value and its standard deviation, to the deviation's second digit."""
    return f"{plain(value, sd)} ± {plain(sd, sd)}"


def plain(value: float, sd: float) -> str:
    """A value, to the second digit of its standard deviation; to four digits where there is none."""
    if not (math.isfinite(sd) and sd > 0.0) or not math.isfinite(value):
        return f"{value:.4g}"
    places = 1 - math.floor(math.log10(sd))
    # A spread far above the value still shows the value.
    if value:
        places = max(places, -math.floor(math.log10(abs(value))))
    return f"{round(value, places):.{max(min(places, 12), 0)}f}"


def as_json(
    fit: FitResult, occasion: RunInfo, verification: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Everything that was found, ready for JSON; what is not a finite number becomes null."""
    tuned = fit.tuned
    told = {
        "format": FORMAT,
        "version": occasion.version,
        "date": occasion.when.isoformat(),
        "options": dict(occasion.options),
        "patches": {
            "name": occasion.patches, "sha256": occasion.sha256, "members": dict(occasion.members)
        },
        "parameters": [_parameter(fit, one) for one in fit.parameters],
        "entries": [label for one in fit.parameters for label, *_ in entries(fit, one)],
        "correlation": fit.correlation,
        "undetermined": list(fit.undetermined),
        "kinds": {name: _kind(one) for name, one in fit.kinds.items()},
        "spectra": {name: _spectrum(one) for name, one in fit.spectra.items()},
        "starts": [
            {"values": one.values, "cost": one.cost, "evaluations": one.evaluations, "message": one.message}
            for one in fit.starts
        ],
        "chi_squared": fit.chi_squared,
        "data": fit.data,
        "leftover": dict(fit.leftover),
        "verdict": list(fit.diagnostics),
        "verification": verification,
        "tuned": {
            "pigments": {
                name: path.model_dump(mode="json") for name, path in sorted(tuned.pigments.items())
            },
            "flash_power": tuned.flash_power,
            "flash_nodes_nm": tuned.flash_nodes_nm,
            "flash_spectrum": tuned.flash_spectrum,
            "exposure": tuned.exposure,
            "gains": tuned.gains,
            "matrix": tuned.matrix,
        },
    }  # fmt: skip
    return {key: finite(value) for key, value in told.items()}


def finite(value: Any) -> Any:
    """The value with Python's own numbers, and None for those that JSON does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return finite(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _parameter(fit: FitResult, parameter: Parameter) -> dict[str, Any]:
    name = parameter.name
    return {
        "name": name,
        "unit": parameter.unit,
        "group": parameter.group,
        "labels": parameter.labels,
        "before": parameter.default,
        "value": fit.values[name],
        "sd": fit.sd[name],
        "gained": fit.gained[name],
        "bounds": [
            {"mean": law.mean, "sd": law.sd, "low": law.low, "high": law.high,
             "source": law.source, "chosen": law.chosen}
            for law in parameter.prior
        ],
    }  # fmt: skip


def _kind(one: Any) -> dict[str, Any]:
    moments = {
        name: {"mean_lab": getattr(one, name)[0], "sd_lab": getattr(one, name)[1]}
        for name in ("target", "before", "after")
    }
    return {**moments, "delta_e_before": one.delta_e_before, "delta_e_after": one.delta_e_after}


def _spectrum(one: Any) -> dict[str, Any]:
    names = ("wavelength_nm", "target", "before", "after", "rmse_before", "rmse_after")
    return {name: getattr(one, name) for name in names}


def _digests(patches: PatchSet) -> Iterator[tuple[str, str]]:
    """SHA-256 of the numbers of each patch and spectrum, the same on every machine."""
    for patch in patches.patches:
        yield patch.name, _sha256(np.asarray(patch.linear, "<f8"), np.asarray(patch.codes, "u1"))
    for one in patches.spectra:
        yield (
            one.name,
            _sha256(np.asarray(one.spectrum.wavelength_nm, "<f8"), np.asarray(one.spectrum.values, "<f8")),
        )


def _sha256(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
