"""The tables that a picture is differentiated by, as functions of surfaces and flash, and their derivatives.

Light that meets one surface is carried by channel, so a surface's spectra and the flash's meet before any ray
is traced: with what each wavelength of the flash counts for in channel c, W_lc, the kernel reads the colours
sum_l R_l W_lc / sum_l W_lc of each row and the flash's own, sum_l W_lc. Light that meets more is carried at
single wavelengths and reads spectra and flash themselves.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.gradients.pigment_models import Values
from pepperscene.render.gradients.tunable import Part, Tunable
from pepperscene.render.kernel.camera import STEP_NM, Response

Array = NDArray[np.float64]
Tables = dict[str, Array]


class DiffTables:
    """Where the kernel's derivatives end and NumPy's begin.

    Args:
        tunable: the surfaces.
        response: of the camera; its flash is the one that `flash.power` and `flash.spectrum` change.
        nodes_nm: `(m,)` where the flash's weights are; none without a flash.
        sun: `(n,)` its irradiance where it lights first hits by channel, or None.
    """

    def __init__(self, tunable: Tunable, response: Response, nodes_nm: Array, sun: Array | None) -> None:
        self._tunable, self._flash = tunable, response.flash
        steps = np.full(response.grid_nm.size, STEP_NM)
        steps[[0, -1]] *= 0.5
        self._counts = response.electrons * steps[:, None]
        # (n, m) the weights' hat functions.
        self._hats: Array | None = None
        if nodes_nm.size:
            rows = [np.interp(response.grid_nm, nodes_nm, one) for one in np.eye(nodes_nm.size)]
            self._hats = np.stack(rows, axis=1)
        self._sun = None if sun is None else _shares(self._counts * sun[:, None])

    def tables(self, values: Values) -> Tables:
        """The tables by name: spectra `(r, n, 4)`, sides `(k, 2, 4)`, openness `(k, 2, NODES, 2)`; with a
        flash lit `(r, c, 4)`, colour `(c,)` and flash `(n,)`; with such a sun sunlit `(r, c, 4)`.
        """
        found = _joined(self._tunable.parts(values))
        if self._sun is not None:
            found["sunlit"] = _seen(found["spectra"], self._sun)
        if self._hats is None:
            return found
        power, curve = values["flash.power"], self._flash * (self._hats @ values["flash.spectrum"])
        weights = self._counts * curve[:, None]
        return found | {
            "lit": _seen(found["spectra"], _shares(weights)),
            "colour": power * weights.sum(axis=0),
            "flash": power * curve,
        }

    def forward(self, values: Values, direction: Values) -> Tables:
        """How the tables change along a direction of the parameters."""
        found = _joined(self._tunable.forward(values, direction))
        if self._sun is not None:
            found["sunlit"] = _seen(found["spectra"], self._sun)
        if self._hats is None:
            return found
        spectra = _joined(self._tunable.parts(values))["spectra"]
        power, curve = values["flash.power"], self._flash * (self._hats @ values["flash.spectrum"])
        none = np.zeros(self._hats.shape[1])
        more = direction.get("flash.power", np.zeros(()))
        bent = self._flash * (self._hats @ direction.get("flash.spectrum", none))
        weights, changes = self._counts * curve[:, None], self._counts * bent[:, None]
        total = weights.sum(axis=0)
        shares = _shares(weights)
        shifts = np.divide(
            changes - shares * changes.sum(axis=0), total, out=np.zeros_like(shares), where=total > 0.0
        )
        return found | {
            "lit": _seen(found["spectra"], shares) + _seen(spectra, shifts),
            "colour": more * total + power * changes.sum(axis=0),
            "flash": more * curve + power * bent,
        }

    def backward(
        self, values: Values, cotangents: Mapping[str, Array], names: tuple[str, ...]
    ) -> dict[str, Array]:
        """Derivatives of a number with respect to parameters, from those with respect to the tables."""
        parts = self._tunable.parts(values)
        spectra, by_spectra = _joined(parts)["spectra"], cotangents["spectra"].copy()
        found: dict[str, Array] = {}
        if self._sun is not None:
            by_spectra += np.einsum("rcs,lc->rls", cotangents["sunlit"], self._sun)
        if self._hats is not None:
            power, curve = values["flash.power"], self._flash * (self._hats @ values["flash.spectrum"])
            weights = self._counts * curve[:, None]
            total, shares = weights.sum(axis=0), _shares(weights)
            lit, colour, flash = (cotangents[name] for name in ("lit", "colour", "flash"))
            by_spectra += np.einsum("rcs,lc->rls", lit, shares)
            # Shares sum to 1: only what a wavelength's colour differs from the mean by counts.
            by_shares = np.einsum("rls,rcs->lc", spectra, lit)
            by_shares -= (shares * by_shares).sum(axis=0)
            by_weights = np.divide(by_shares, total, out=np.zeros_like(shares), where=total > 0.0)
            by_weights += power * colour
            by_curve = (by_weights * self._counts).sum(axis=1) + power * flash
            found["flash.power"] = np.asarray(colour @ total + flash @ curve)
            found["flash.spectrum"] = self._hats.T @ (self._flash * by_curve)
        own = tuple(name for name in names if name in self._tunable.defaults)
        split = _split({**cotangents, "spectra": by_spectra}, parts)
        return {**found, **self._tunable.backward(values, split, own)}


def _shares(weights: Array) -> Array:
    """`(n, c)` of each wavelength in a channel's sum; nothing where a channel sees nothing."""
    total = weights.sum(axis=0)
    return np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)


def _seen(spectra: Array, shares: Array) -> Array:
    """`(r, c, 4)` rows of spectra as the channels see them."""
    return np.asarray(np.einsum("rls,lc->rcs", spectra, shares))


def _joined(parts: list[Part]) -> Tables:
    """The tables of all surfaces, one behind the other."""
    spectra, sides, openness = zip(*parts, strict=True)
    return {"spectra": np.concatenate(spectra), "sides": np.stack(sides), "openness": np.stack(openness)}


def _split(tables: Mapping[str, Array], parts: list[Part]) -> list[Part]:
    """What belongs to each surface."""
    ends = np.cumsum([len(spectra) for spectra, _, _ in parts])[:-1]
    spectra = np.split(tables["spectra"], ends)
    return list(zip(spectra, tables["sides"], tables["openness"], strict=True))
