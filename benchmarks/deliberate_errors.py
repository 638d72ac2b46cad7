"""Deliberate errors in the sources, and whether the tests find them.

Each error replaces one piece of text that occurs once in `src`: a sign, a factor, an axis, a clamp, a unit,
an order, a cache, or a number that is off by one. A copy of the checkout gets one error at a time, and tests
of the packages that it names run until one fails:

    python benchmarks/deliberate_errors.py            # tests outside the long tier
    python benchmarks/deliberate_errors.py --long 3 7  # errors 3 and 7, with the long tier
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Error(NamedTuple):
    """One error: its kind, the text and what replaces it, and folders of tests in their order."""

    kind: str
    text: str
    replacement: str
    folders: tuple[str, ...]


ERRORS = (
    Error(
        "factor",
        "self.lens.focal_length_m / (2 * self.lens.f_number)",
        "self.lens.focal_length_m / self.lens.f_number",
        ("camera", "laws", "render"),
    ),
    Error(
        "clamp",
        "min(self.flash.pulse_s, self.exposure_s) / self.exposure_s",
        "self.flash.pulse_s / self.exposure_s",
        ("camera", "laws", "render"),
    ),
    Error(
        "sign",
        "- 0.5 * self.rows) * self.line_time_s",
        "+ 0.5 * self.rows) * self.line_time_s",
        ("camera", "laws"),
    ),
    Error(
        "offbyone",
        "return (self.rows - 1) * self.line_time_s",
        "return self.rows * self.line_time_s",
        ("camera", "laws"),
    ),
    Error(
        "factor",
        "self.full_well_e / (self.full_scale_dn - self.black_level_dn) / self.gain",
        "self.full_well_e / self.full_scale_dn / self.gain",
        ("camera", "laws"),
    ),
    Error(
        "sign",
        "linear if offset == 0 else (linear + offset) / (np.float32(1) + offset)",
        "linear if offset == 0 else (linear + offset) / (np.float32(1) - offset)",
        ("camera", "laws", "render"),
    ),
    Error(
        "factor",
        "np.asarray(np.diff(borders) * (rows / camera.height))",
        "np.asarray(np.diff(borders))",
        ("camera", "render", "building"),
    ),
    Error(
        "factor",
        "500.0 * (x - y), 200.0 * (y - z)",
        "500.0 * (x - y), 200.0 * (z - y)",
        ("camera", "colour"),
    ),
    Error(
        "unit",
        "return float(np.trapezoid(nm * sensitivity, nm) / np.trapezoid(sensitivity, nm)) * 1e-9",
        "return float(np.trapezoid(nm * sensitivity, nm) / np.trapezoid(sensitivity, nm)) * 1e-8",
        ("camera", "laws"),
    ),
    Error(
        "factor",
        "np.asarray(wavelength_nm, dtype=float) * 1e-9 / (_PLANCK * _LIGHT_SPEED)",
        "np.asarray(wavelength_nm, dtype=float) * 1e-9 / (2 * _PLANCK * _LIGHT_SPEED)",
        ("spectra", "camera"),
    ),
    Error(
        "sign",
        "transmittance ** (air_mass(elevation_rad) / 1.5)",
        "transmittance ** (-air_mass(elevation_rad) / 1.5)",
        ("spectra", "scene"),
    ),
    Error(
        "order",
        "p_amplitude = (n * cosine - refracted) / (n * cosine + refracted)",
        "p_amplitude = (cosine - n * refracted) / (cosine + n * refracted)",
        ("spectra", "laws"),
    ),
    Error(
        "factor",
        "cover = DUST * np.exp(0.7 * speckle - 0.5 * 0.7**2)",
        "cover = DUST * np.exp(0.7 * speckle + 0.5 * 0.7**2)",
        ("materials", "laws"),
    ),
    Error(
        "sign",
        "shift = 0.5 * ((own_row + row_step) % 2)",
        "shift = -0.5 * ((own_row + row_step) % 2)",
        ("materials",),
    ),
    Error(
        "factor",
        "radius = width * (1.0 + even * (oval + bulge))",
        "radius = width * (1.0 + even * (oval - bulge))",
        ("geometry", "laws"),
    ),
    Error(
        "axis",
        "points[..., 2] = slimness * level",
        "points[..., 2] = level",
        ("geometry", "laws"),
    ),
    Error(
        "sign",
        "extra_out = flat.extra_edge * out - height * rise - width * level",
        "extra_out = flat.extra_edge * out + height * rise - width * level",
        ("geometry", "laws"),
    ),
    Error(
        "offbyone",
        "below = np.minimum(position.astype(np.intp), self.line.shape[1] - 2)",
        "below = np.minimum(position.astype(np.intp), self.line.shape[1] - 3)",
        ("grammar", "geometry", "laws"),
    ),
    Error(
        "sign",
        "direction_x, direction_y = horizontal * math.sin(azimuth), -horizontal * math.cos(azimuth)",
        "direction_x, direction_y = horizontal * math.sin(azimuth), horizontal * math.cos(azimuth)",
        ("grammar", "geometry", "laws"),
    ),
    Error(
        "factor",
        "own = math.sqrt(1.0 - correlation) * ndtri(uniform[name])",
        "own = (1.0 - correlation) * ndtri(uniform[name])",
        ("grammar", "laws"),
    ),
    Error(
        "factor",
        "sd = math.sqrt(max(square - mean * mean, 0.0))",
        "sd = max(square - mean * mean, 0.0)",
        ("cultivar", "laws"),
    ),
    Error(
        "offbyone",
        "fan = np.stack([np.zeros(k - 2, int), np.arange(1, k - 1), np.arange(2, k)], axis=1)",
        "fan = np.stack([np.zeros(k - 3, int), np.arange(1, k - 2), np.arange(2, k - 1)], axis=1)",
        ("scene", "laws"),
    ),
    Error(
        "factor",
        "received = diffuse * skylight.at(wavelength_nm) + beam * sunlight.at(wavelength_nm)",
        "received = diffuse * skylight.at(wavelength_nm) + sunlight.at(wavelength_nm)",
        ("scene", "laws"),
    ),
    Error(
        "sign",
        "float(np.tan(self.row_lean_rad)) * max(0.0, height_m - self.stem_base_m)",
        "float(np.tan(self.row_lean_rad)) * max(0.0, height_m + self.stem_base_m)",
        ("scene", "building"),
    ),
    Error(
        "sign",
        "sky_lx = illuminance_lx - sun_lx - floor_sr * illuminance(sunlit)",
        "sky_lx = illuminance_lx - sun_lx + floor_sr * illuminance(sunlit)",
        ("scene", "laws"),
    ),
    Error(
        "axis",
        "det = along_u.x * along_v.y - along_u.y * along_v.x",
        "det = along_u.x * along_v.y + along_u.y * along_v.x",
        ("render", "laws"),
    ),
    Error(
        "factor",
        "lambert *= 1.0 - gloss",
        "lambert *= 1.0",
        ("render", "laws"),
    ),
    Error(
        "unit",
        "per_m2 = device_float(1.0 / self._unit_m**2)",
        "per_m2 = device_float(1.0 / self._unit_m)",
        ("render", "building"),
    ),
    Error(
        "cache",
        "remaining = sampling.samples - first",
        "remaining = sampling.samples",
        ("render", "laws"),
    ),
    Error(
        "offbyone",
        "first, last = inside[np.append(0, gap + 1)[: inside.size]]",
        "first, last = inside[np.append(0, gap)[: inside.size]]",
        ("truth", "export", "render"),
    ),
    Error(
        "offbyone",
        "int(columns[-1]) + 1, y + int(rows[-1]) + 1",
        "int(columns[-1]), y + int(rows[-1]) + 1",
        ("truth", "export", "render"),
    ),
    Error(
        "factor",
        "centre = fruit.pose[:3, 3] + fruit.pose[:3, :3] @ (0.5 * (fruit.low + fruit.high))",
        "centre = fruit.pose[:3, 3] + fruit.pose[:3, :3] @ (0.5 * (fruit.high - fruit.low))",
        ("truth", "export", "laws", "building"),
    ),
    Error(
        "factor",
        "covariance = deviations.T @ deviations / len(lab)",
        "covariance = deviations.T @ deviations / (len(lab) - 1)",
        ("colour",),
    ),
    Error(
        "sign",
        "return np.clip(vector, self.low + margin, self.high - margin)",
        "return np.clip(vector, self.low - margin, self.high + margin)",
        ("tuning",),
    ),
    Error(
        "order",
        "return (growth.date - first.date).days / days",
        "return (last.date - growth.date).days / days",
        ("recipe", "building", "cultivar"),
    ),
    Error(
        "clamp",
        "table.focus_m <= lens.focal_length_m:",
        "table.focus_m <= 1e-3 * lens.focal_length_m:",
        ("recipe",),
    ),
    Error(
        "unit",
        "sun_lx / np.sin(light.sun_elevation_rad)",
        "sun_lx / np.cos(light.sun_elevation_rad)",
        ("building", "scene", "render"),
    ),
    Error(
        "order",
        "return min(max(round(value - _CENTRE, 2), 0.0), pixels - 1.0)",
        "return min(max(round(value + _CENTRE, 2), 0.0), pixels - 1.0)",
        ("export",),
    ),
    Error(
        "offbyone",
        "starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])",
        "starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1])])",
        ("export", "dataset"),
    ),
    Error(
        "unit",
        "depth_mm = pinhole.resample(np.rint(MILLIMETRES * surface.depth_z), 0.0)",
        "depth_mm = pinhole.resample(np.rint(MILLIMETRES * surface.distance), 0.0)",
        ("export",),
    ),
    Error(
        "factor",
        "precision, recall = matched / predicted, matched / truth",
        "precision, recall = matched / truth, matched / predicted",
        ("learning",),
    ),
    Error(
        "cache",
        "return index * 2 * REST + segment_id",
        "return index * REST + segment_id",
        ("export",),
    ),
)


def file_with(text: str, sources: Path) -> Path:
    """The only file that contains a text once; raises `ValueError` if there is none or several."""
    found = [path for path in sorted(sources.rglob("*.py")) if text in path.read_text(encoding="utf-8")]
    if len(found) != 1 or found[0].read_text(encoding="utf-8").count(text) != 1:
        raise ValueError(f"{text!r} occurs in {[str(path) for path in found]}")
    return found[0]


def first_failure(error: Error, checkout: Path, marks: str) -> str:
    """The first test that finds an error, or "" if none does."""
    file = file_with(error.text, checkout / "src")
    before = file.read_text(encoding="utf-8")
    file.write_text(before.replace(error.text, error.replacement), encoding="utf-8")
    command = [
        sys.executable, "-P", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", marks,
        *(f"tests/{folder}" for folder in error.folders),
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    try:
        done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    finally:
        file.write_text(before, encoding="utf-8")
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0] if lines else ""


def main() -> None:
    """Print a line for each error."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("numbers", nargs="*", type=int, help="of the errors; all if none is given")
    parser.add_argument("--long", action="store_true", help="run the tests of the long tier")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "checkout"
        ignored = shutil.ignore_patterns(".git", ".venv*", "out", "__pycache__", "_build")
        shutil.copytree(ROOT, checkout, ignore=ignored)
        for number in arguments.numbers or range(len(ERRORS)):
            error = ERRORS[number]
            found = first_failure(error, checkout, "long" if arguments.long else "not long")
            print(f"{number} {error.kind}: {error.text[:60]}: {found or 'not found'}", flush=True)


if __name__ == "__main__":
    main()
