"""The kernel tables that an image is differentiated by, as functions of surfaces and flash.

Light that meets one surface is carried by channel, so the spectra of a surface and of the flash meet before
any ray is traced: with W_lc, the contribution of each wavelength of the flash to channel c, the kernel reads
the colours sum_l R_l W_lc / sum_l W_lc of each row and the flash's own colour sum_l W_lc. Light that meets
more is carried at single wavelengths and reads the spectra of surfaces and flash themselves.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.gradients.tunable import SurfaceTables, Tunable, Values
from pepperscene.render.kernel.camera import SpectralResponse

Array = NDArray[np.float64]
Tables = dict[str, Array]


class DiffTables:
    """The interface between derivatives by Dr.Jit and derivatives by NumPy.

    Args:
        tunable: the surfaces.
        response: of the camera; `flash.power` and `flash.spectrum` change its flash.
        nodes_nm: `(m,)` wavelengths of the flash's weights; empty without a flash.
        sun: `(n,)` irradiance of a sun that lights first hits by channel, or None.
    """

    def __init__(
        self, tunable: Tunable, response: SpectralResponse, nodes_nm: Array, sun: Array | None
    ) -> None:
        self._tunable, self._flash = tunable, response.flash
        self._electrons = response.electrons_per_joule * response.trapezoid_nm[:, None]
        # (n, m) hat functions of the weights.
        self._hats: Array | None = None
        if nodes_nm.size:
            rows = [np.interp(response.grid_nm, nodes_nm, hat) for hat in np.eye(nodes_nm.size)]
            self._hats = np.stack(rows, axis=1)
        self._sun = None if sun is None else _fractions(self._electrons * sun[:, None])

    def tables(self, values: Values) -> Tables:
        """The tables by name.

        Spectra `(r, n, 4)`, sides and openness as of `Optics`; with a flash also flash_optics `(r, c, 4)`,
        flash_colour `(c,)` and flash `(n,)`; with a direct sun also sun_optics `(r, c, 4)`.
        """
        result = _join_tables(self._tunable.tables(values))
        if self._sun is not None:
            result["sun_optics"] = _colours(result["spectra"], self._sun)
        if self._hats is None:
            return result
        power, curve, weights = self._flash_weights(values, self._hats)
        return result | {
            "flash_optics": _colours(result["spectra"], _fractions(weights)),
            "flash_colour": power * weights.sum(axis=0),
            "flash": power * curve,
        }

    def forward(self, values: Values, direction: Values) -> Tables:
        """Derivatives of the tables along a direction of the parameters."""
        result = _join_tables(self._tunable.forward(values, direction))
        if self._sun is not None:
            result["sun_optics"] = _colours(result["spectra"], self._sun)
        if self._hats is None:
            return result
        spectra = _join_tables(self._tunable.tables(values))["spectra"]
        power, curve, weights = self._flash_weights(values, self._hats)
        no_change = np.zeros(self._hats.shape[1])
        power_change = direction.get("flash.power", np.zeros(()))
        curve_change = self._flash * (self._hats @ direction.get("flash.spectrum", no_change))
        weight_changes = self._electrons * curve_change[:, None]
        total, fractions = weights.sum(axis=0), _fractions(weights)
        relative = weight_changes - fractions * weight_changes.sum(axis=0)
        fraction_changes = np.divide(relative, total, out=np.zeros_like(relative), where=total > 0.0)
        return result | {
            "flash_optics": _colours(result["spectra"], fractions) + _colours(spectra, fraction_changes),
            "flash_colour": power_change * total + power * weight_changes.sum(axis=0),
            "flash": power_change * curve + power * curve_change,
        }

    def backward(
        self, values: Values, cotangents: Mapping[str, Array], names: tuple[str, ...]
    ) -> dict[str, Array]:
        """Derivatives of a number with respect to parameters, from those with respect to the tables."""
        tables = self._tunable.tables(values)
        spectra, by_spectra = _join_tables(tables)["spectra"], cotangents["spectra"].copy()
        result: dict[str, Array] = {}
        if self._sun is not None:
            by_spectra += np.einsum("rcs,lc->rls", cotangents["sun_optics"], self._sun)
        if self._hats is not None:
            power, curve, weights = self._flash_weights(values, self._hats)
            total, fractions = weights.sum(axis=0), _fractions(weights)
            by_colours, by_colour, by_flash = (
                cotangents[name] for name in ("flash_optics", "flash_colour", "flash")
            )
            by_spectra += np.einsum("rcs,lc->rls", by_colours, fractions)
            # Fractions sum to 1: only the difference between a wavelength's colour and the mean counts.
            by_fractions = np.einsum("rls,rcs->lc", spectra, by_colours)
            by_fractions -= (fractions * by_fractions).sum(axis=0)
            by_weights = np.divide(by_fractions, total, out=np.zeros_like(fractions), where=total > 0.0)
            by_weights += power * by_colour
            by_curve = (by_weights * self._electrons).sum(axis=1) + power * by_flash
            result["flash.power"] = np.asarray(by_colour @ total + by_flash @ curve)
            result["flash.spectrum"] = self._hats.T @ (self._flash * by_curve)
        of_surfaces = tuple(name for name in names if name in self._tunable.defaults)
        ends = np.cumsum([len(rows) for rows, _, _ in tables])[:-1]
        split = zip(np.split(by_spectra, ends), cotangents["sides"], cotangents["openness"], strict=True)
        return {**result, **self._tunable.backward(values, list(split), of_surfaces)}

    def _flash_weights(self, values: Values, hats: Array) -> tuple[Array, Array, Array]:
        """Power and `(n,)` spectrum of the flash, and `(n, c)` its contributions to the channels."""
        curve = self._flash * (hats @ values["flash.spectrum"])
        return values["flash.power"], curve, self._electrons * curve[:, None]


def _fractions(weights: Array) -> Array:
    """`(n, c)` of each wavelength in a channel's sum; 0 if the channel detects nothing."""
    total = weights.sum(axis=0)
    return np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)


def _colours(spectra: Array, fractions: Array) -> Array:
    """`(r, c, 4)` rows of spectra as seen by the channels."""
    return np.asarray(np.einsum("rls,lc->rcs", spectra, fractions))


def _join_tables(tables: list[SurfaceTables]) -> Tables:
    """Concatenate the tables of all surfaces."""
    spectra, sides, openness = zip(*tables, strict=True)
    return {"spectra": np.concatenate(spectra), "sides": np.stack(sides), "openness": np.stack(openness)}
