"""Daylight that a floor of white film below a crop reflects.

The environment of a scene stands for a greenhouse that goes on in all directions, so its floor is as dark as
that below the crop: it receives what the leaves of a homogeneous crop of the same leaf area let pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh
from pepperscene.materials import greenhouse_surfaces
from pepperscene.scene.greenhouse import Greenhouse
from pepperscene.scene.row import DoubleRow
from pepperscene.spectra import MEAN_LEAF, leaf_spectra
from pepperscene.spectra.spectrum import FloatArray, Spectrum

MAX_LEAF_AREA_INDEX: Final = 20.0
"""Chosen: three times that of the densest crops."""

_NM: Final = np.arange(300.0, 1101.0, 5.0)


def transmitted_daylight(leaf_area_index: float, sun_elevation_rad: float) -> tuple[Spectrum, Spectrum]:
    """Fractions of skylight and of sunlight that reach the floor below a homogeneous crop.

    Light along a path of the zenith angle t meets leaves like a random medium: exp(-k L / cos t) of it passes
    the leaf area index L (Monsi & Saeki 1953). For leaves of all orientations, k is 0.5 if they absorb all
    light, and 0.5 sqrt(1 - s) if they scatter the fraction s. A crop of such leaves reflects, seen from
    below as well, so that of what would pass a fraction leaves it upwards (Goudriaan 1977, Crop
    micrometeorology). The mean of the exponential over a uniform sky is 2 E3(k L), with the exponential
    integral E3 (Ross 1981). A traced canopy of random leaves has the result within 5 %
    (`tests/laws/test_floor_light.py`). Aisles, through which more light passes, are not considered.

    Args:
        leaf_area_index: one-sided leaf area over floor area; 0 lets all light pass.
        sun_elevation_rad: above the horizon.
    """
    from scipy.special import expn

    root = np.sqrt(1.0 - _leaf_scattering())
    optical_depth = 0.5 * root * leaf_area_index
    skylight = 2.0 * expn(3, optical_depth)
    sunlight = np.exp(-optical_depth / max(float(np.sin(sun_elevation_rad)), 1e-3))
    # Reflectance of a crop of infinite depth; a finite one reflects on both of its sides.
    reflected = ((1.0 - root) / (1.0 + root)) ** 2
    passing = (1.0 - reflected) / (1.0 - reflected * skylight**2)
    skylight, sunlight = passing * skylight, passing * sunlight
    return Spectrum(_NM, skylight, "hold"), Spectrum(_NM, sunlight, "hold")


def reflected_radiance(
    wavelength_nm: FloatArray,
    leaf_area_index: float,
    sun_elevation_rad: float,
    diffuse: FloatArray,
    beam: FloatArray | float = 0.0,
) -> FloatArray:
    """Radiance `(n,)` of a floor of white film below a crop, W m-2 sr-1 nm-1; see `transmitted_daylight`.

    `diffuse` and `beam` are the irradiance `(n,)` of a level plane above the crop by scattered light and by
    the sun's disc, W m-2 nm-1.
    """
    skylight, sunlight = transmitted_daylight(leaf_area_index, sun_elevation_rad)
    received = diffuse * skylight.at(wavelength_nm) + beam * sunlight.at(wavelength_nm)
    return np.asarray(received * film_reflectance().at(wavelength_nm) / np.pi)


def leaf_area_index(plants: Sequence[Mesh], row: DoubleRow, greenhouse: Greenhouse) -> float:
    """One-sided leaf area over floor area of double rows of these plants, at most `MAX_LEAF_AREA_INDEX`."""
    area = sum(_leaf_area(plant) for plant in plants)
    return min(area / ground_area(len(plants), row, greenhouse), MAX_LEAF_AREA_INDEX)


def ground_area(plants: int, row: DoubleRow, greenhouse: Greenhouse) -> float:
    """Floor area in square metres of a number of plants in a double row, with their part of the aisle."""
    if row.plants_back == 0:
        return plants * row.spacing_m * greenhouse.aisle_m
    return 0.5 * plants * row.spacing_m * (greenhouse.aisle_m + row.gap_m)


def _leaf_area(mesh: Mesh) -> float:
    """Area of the leaves' triangles; a blade is a sheet of one layer."""
    faces = mesh.faces[mesh.face_class == OrganClass.LEAF]
    a, b, c = (mesh.vertices[faces[:, k]].astype(np.float32, copy=False) for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum(dtype=float))


@lru_cache(maxsize=1)
def film_reflectance() -> Spectrum:
    """Reflectance of the white film on the floor."""
    film = greenhouse_surfaces(_NM)["floor_film"]
    return Spectrum(_NM, film.reflectance[0, 0], "hold")


@lru_cache(maxsize=1)
def _leaf_scattering() -> FloatArray:
    leaf = leaf_spectra(_NM, **MEAN_LEAF)
    return np.asarray(leaf.reflectance + leaf.transmittance)
