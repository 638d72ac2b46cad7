"""Surfaces whose colour is a user's measured curve, beside those that pigments give."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from pepperscene.cultivar import STATE_PER_SD, Cultivar, MeasuredCurve, PigmentPath
from pepperscene.cultivar.structure import FROM_PIGMENTS
from pepperscene.materials.leaf import leaf_optics, mean_gloss, under_cuticle
from pepperscene.materials.surface import Surface
from pepperscene.spectra import Spectrum, check_energy, read_measured
from pepperscene.spectra.spectrum import FloatArray

_STATES: Final = np.linspace(0.0, 1.0, 13)  # every half of a standard deviation
_MIDDLE: Final = np.array([0.5])


def check_curves(cultivar: Cultivar) -> None:
    """Read all measured curves of a cultivar.

    Raises:
        InputError: as `read_measured`, or reflectance and transmittance sum to more than 1.
    """
    for name, curve in cultivar.spectra.items():
        _samples(curve, is_sheet=name in _sheets(cultivar))


def curve_notes(cultivar: Cultivar, first_nm: float, last_nm: float) -> tuple[str, ...]:
    """Sentences on the measured curves of a cultivar in a range of wavelengths, nm.

    One for each curve with its range, and whether its end values are used outside of it; and one for each
    that is darker than the gloss of its cuticle somewhere, so that it cannot be reproduced there.
    """
    notes = []
    for name, curve in cultivar.spectra.items():
        front = _samples(curve, is_sheet=name in _sheets(cultivar))[0]
        low, high = front.range_nm
        note = f"{name}: {curve.file.name} is measured from {low:g} to {high:g} nm"
        if first_nm < low or last_nm > high:
            note += f"; the cameras see {first_nm:g} to {last_nm:g} nm, and its end values hold outside"
        notes.append(note)
        gloss, mean = mean_gloss(cultivar.pigments[name], 0), front.values.mean(axis=0)
        inside = (front.wavelength_nm >= first_nm) & (front.wavelength_nm <= last_nm)
        if curve.gloss and (mean[inside] < gloss).any():
            dark = front.wavelength_nm[inside & (mean < gloss)]
            notes.append(
                f"{name}: {curve.file.name} is below {gloss:.3f}, the gloss of the cuticle, at {dark.size} "
                f"wavelengths from {dark[0]:g} to {dark[-1]:g} nm; set gloss = false, or a smaller ior"
            )
    return tuple(notes)


def measured_surface(surface: Surface, curve: MeasuredCurve, path: PigmentPath) -> Surface:
    """The surface with a measured curve instead of the colour of its pigments.

    Relief, residue and texture stay. States are standard deviations from the mean of the organs (see
    `STATE_PER_SD`), from pale to dark; the texture, such as veins, varies as organs do and has the mean 0. A
    measured surface does not age, and its contents are not known.

    Args:
        surface: with the pigments' colour.
        curve: the measured one.
        path: pigments, whose cuticle it has.

    Raises:
        InputError: as `check_curves`.
    """
    nm, is_sheet = surface.wavelength_nm, bool(surface.transmittance.any())
    front, back, through = (
        None if samples is None else samples.at(nm) for samples in _samples(curve, is_sheet=is_sheet)
    )
    assert front is not None
    if back is None:
        back = front
    if through is None:
        known = leaf_optics(path, nm, _MIDDLE)[2] if is_sheet else np.zeros((1, nm.size))
        through = np.minimum(known, 1.0 - np.maximum(front, back))
    rows = _varied(np.stack([front, back, through], axis=1), curve.spread)
    cuticle = path if curve.gloss else path.model_copy(update={"ior": 1.0})
    upper, lower, transmittance = under_cuticle(cuticle, rows[:, 0], rows[:, 1], rows[:, 2])
    pattern = None if surface.pattern is None else surface.pattern - surface.pattern.mean(dtype=float)
    return replace(
        surface,
        reflectance=np.stack([upper, lower], axis=1),
        transmittance=transmittance,
        ior=cuticle.ior,
        first_state=0.0,
        ageing_order=None,
        pattern=None if pattern is None else pattern.astype(np.float32),
        contents={},
    )


def _sheets(cultivar: Cultivar) -> set[str]:
    """Surfaces that transmit light."""
    return {kind.surface for kind in cultivar.kinds.values() if kind.form in ("blade", "flower")}


def _samples(curve: MeasuredCurve, *, is_sheet: bool) -> tuple[Spectrum, Spectrum | None, Spectrum | None]:
    """Samples `(k, n)` of front, back and transmittance; None for what the file does not have."""

    def read(columns: tuple[str, ...]) -> Spectrum:
        return read_measured(curve.file, columns, unit=curve.unit, wavelength_unit=curve.wavelength_unit)

    front = read(curve.reflectance)
    below = None if curve.reflectance_below is None else read(curve.reflectance_below)
    columns = curve.transmittance or ("transmittance",)
    if not is_sheet or columns == (FROM_PIGMENTS,):
        return front, below, None
    through = read(columns)
    for side in (front, below):
        if side is not None:
            check_energy(curve.file, side, through, columns)
    return front, below, through


def _varied(samples: FloatArray, spread: float) -> FloatArray:
    """Curves `(s, 3, n)` at `_STATES`, of front, back and transmittance, from samples `(k, 3, n)`."""
    mean = samples.mean(axis=0)
    deviation = -spread * mean
    if len(samples) > 1:
        # The first principal component of all three together, times the samples' standard deviation.
        _, values, axes = np.linalg.svd((samples - mean).reshape(len(samples), -1), full_matrices=False)
        deviation = (values[0] / np.sqrt(len(samples) - 1) * axes[0]).reshape(mean.shape)
        deviation *= -1.0 if deviation[0].sum() > 0.0 else 1.0
    scores = (_STATES - 0.5) / STATE_PER_SD
    rows = np.clip(mean + scores[:, None, None] * deviation, 0.0, 1.0)
    # Organs far from the mean must not reflect and transmit more than all light.
    total = np.maximum(rows[:, 0], rows[:, 1]) + rows[:, 2]
    return np.asarray(rows / np.maximum(total, 1.0)[:, None])
