"""Colours of surfaces in daylight, for the materials of mesh files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import ArgumentError
from pepperscene.geometry.mesh import Mesh

if TYPE_CHECKING:
    from pepperscene.materials import Surface

_NM: Final = np.arange(380.0, 781.0, 5.0)


def natural_colours(mesh: Mesh) -> dict[str, NDArray[np.float64]]:
    """`(s, 3)` linear sRGB by surface, one row per tabulated pigment state.

    It is the diffuse reflectance of the front in D65, for the CIE 1931 observer; a perfect diffuser is 1, 1,
    1. Surfaces that are neither of the mesh's cultivar nor of the greenhouse have none.

    Raises:
        ArgumentError: the mesh has plants of several cultivars, whose surfaces have the same names.
    """
    from pepperscene.materials import greenhouse_surfaces, organ_surfaces

    if len(mesh.cultivars) > 1:
        names = ", ".join(cultivar.name for cultivar in mesh.cultivars)
        problem = f'must be "class" or a table for a mesh with plants of several cultivars ({names})'
        raise ArgumentError("colours", problem)
    surfaces: dict[str, Surface] = {}
    for cultivar in mesh.cultivars:
        surfaces |= organ_surfaces(cultivar, _NM)
    if not set(mesh.surfaces) <= set(surfaces):
        surfaces = greenhouse_surfaces(_NM) | surfaces
    return _surface_colours({name: surfaces[name] for name in mesh.surfaces if name in surfaces})


def _surface_colours(surfaces: Mapping[str, Surface]) -> dict[str, NDArray[np.float64]]:
    from pepperscene.spectra import colour_science

    colour = colour_science()
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.stack([np.interp(_NM, observer.wavelengths, column) for column in observer.values.T])
    light = colour.SDS_ILLUMINANTS["D65"]
    weights = matching * np.interp(_NM, light.wavelengths, light.values)
    weights /= weights[1].sum()
    colours = {}
    for name, surface in surfaces.items():
        front = surface.reflectance[:, 0]
        spectra = np.stack([np.interp(_NM, surface.wavelength_nm, row) for row in front])
        rgb = colour.XYZ_to_RGB(spectra @ weights.T, "sRGB", apply_cctf_encoding=False)
        colours[name] = np.clip(np.asarray(rgb, dtype=float), 0.0, 1.0)
    return colours
