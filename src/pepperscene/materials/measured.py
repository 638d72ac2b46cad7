"""Surfaces whose colour is a user's measured curve, beside those that pigments give."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from pepperscene.cultivar import STATE_PER_SD, Cultivar, MeasuredCurve, PigmentPath
from pepperscene.materials.leaf import mean_gloss, under_cuticle
from pepperscene.materials.surface import Surface
from pepperscene.spectra import Spectrum
from pepperscene.spectra.measured import check_energy, read_measured
from pepperscene.spectra.spectrum import FloatArray

_STATES: Final = np.linspace(0.0, 1.0, 13)  # every half of a standard deviation


def curve_notes(cultivar: Cultivar, first_nm: float, last_nm: float) -> tuple[str, ...]:
    """Sentences on the measured curves of a cultivar in a range of wavelengths, nm.

    One for each curve with its range, and whether its end values are used outside of it; and one for each
    that is darker than the gloss of its cuticle somewhere, so that it cannot be reproduced there.

    Raises:
        InputError: as `measured_surface`.
    """
    notes, sheets = [], {kind.surface for kind in cultivar.kinds.values() if kind.form in ("blade", "flower")}
    for name, curve in cultivar.spectra.items():
        front, file = _read(curve, is_sheet=name in sheets)[0], curve.file.name
        low, high = front.range_nm
        extended = f"; the cameras see {first_nm:g} to {last_nm:g} nm, and its end values hold outside"
        is_covered = low <= first_nm and last_nm <= high
        notes.append(
            f"{name}: {file} is measured from {low:g} to {high:g} nm{'' if is_covered else extended}"
        )
        gloss, nm = mean_gloss(cultivar.pigments[name], 0), front.wavelength_nm
        dark = nm[(front.values.mean(axis=0) < gloss) & (first_nm <= nm) & (nm <= last_nm)]
        if curve.gloss and dark.size:
            notes.append(
                f"{name}: {file} is below {gloss:.3f}, the gloss of the cuticle, between {dark[0]:g} and "
                f"{dark[-1]:g} nm, where organs are brighter than measured; set gloss = false"
            )
    return tuple(notes)


def measured_surface(surface: Surface, curve: MeasuredCurve, path: PigmentPath) -> Surface:
    """The surface with a measured curve instead of the colour of its pigments.

    Relief and residue stay. States are standard deviations from the mean of the organs (see `STATE_PER_SD`),
    from pale to dark; the texture, such as veins, varies as organs do and has the mean 0. A measured surface
    does not age, and its contents are not known.

    Raises:
        InputError: as `read_measured`, or reflectance and transmittance sum to more than 1.
    """
    spectra = _read(curve, is_sheet=bool(surface.transmittance.any()))
    samples = np.stack([spectrum.at(surface.wavelength_nm) for spectrum in spectra], axis=1)
    cuticle = path if curve.gloss else path.model_copy(update={"ior": 1.0})
    upper, lower, transmittance = under_cuticle(cuticle, *_varied(samples, curve.spread).swapaxes(0, 1))
    pattern = surface.pattern
    if pattern is not None:
        pattern = (pattern - pattern.mean(dtype=float)).astype(np.float32)
    return replace(
        surface,
        reflectance=np.stack([upper, lower], axis=1),
        transmittance=transmittance,
        ior=cuticle.ior,
        first_state=0.0,
        ageing_order=None,
        pattern=pattern,
        contents={},
    )


def _read(curve: MeasuredCurve, *, is_sheet: bool) -> tuple[Spectrum, Spectrum, Spectrum]:
    """Samples `(k, n)` of front, back and transmittance, which is 0 of what is no sheet."""
    through = curve.transmittance or ("transmittance",)
    columns = (curve.reflectance, curve.reflectance_below or curve.reflectance, through)
    front, back, transmittance = (
        read_measured(curve.file, names, unit=curve.unit, wavelength_unit=curve.wavelength_unit)
        for names in (columns if is_sheet else columns[:1] * 3)
    )
    if not is_sheet:
        return front, back, transmittance.times(0.0)
    for side in (front, back):
        check_energy(curve.file, side, transmittance, through)
    return front, back, transmittance


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
