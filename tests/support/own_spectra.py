"""Measured curves as a user has them: CSV files of a leaf, in any notation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

NM = np.arange(400.0, 1001.0, 5.0)


def leaf_curve(nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance of a made-up green leaf."""
    edge = 1.0 / (1.0 + np.exp(-(nm - 712.0) / 11.0))
    green = np.exp(-(((nm - 552.0) / 38.0) ** 2))
    return 0.06 + 0.07 * green + 0.40 * edge, 0.02 + 0.08 * green + 0.43 * edge


def write_csv(path: Path, header: str, *columns: np.ndarray) -> Path:
    """A CSV file with these columns."""
    rows = [",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return path


def write_leaf(folder: Path, factor: float = 1.0) -> Path:
    """`leaf.csv` with the curve of `leaf_curve`, times a factor."""
    reflectance, transmittance = leaf_curve(NM)
    header = "wavelength_nm,reflectance,transmittance"
    return write_csv(folder / "leaf.csv", header, NM, factor * reflectance, factor * transmittance)
