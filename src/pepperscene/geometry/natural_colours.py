"""Natural colours of a mesh for other programs, baked into images over its surfaces.

A colour is the diffuse reflectance of the front in D65, for the CIE 1931 observer; that of a perfect diffuser
is 1, 1, 1. An image has a tile for each organ, whose texels have the pigment states of the vertices around
them, with the patterns, the ageing and the residue that the renderer gives the organ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.classes import Appearance, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.geometry.mesh import PIGMENTS, FloatArray, Mesh

if TYPE_CHECKING:
    from pepperscene.materials import Surface

NATURAL_NM: Final = np.arange(380.0, 781.0, 5.0)
"""Wavelengths of the surfaces, nm."""
_BLADE_TILE: Final = (64, 64)  # chosen: texels across and along, 2 mm on a leaf
_FRUIT_TILE: Final = (128, 64)  # chosen: 2 mm on a fruit
_TILE: Final = (16, 16)  # chosen: of other organs, a few millimetres
_FAR_TILE: Final = (4, 4)  # chosen: of coarse plants, which are metres away
_LARGEST_IMAGE: Final = 8192  # chosen: texels along a side, as all graphics hardware can load
_MOST_COVER: Final = 0.95  # largest cover with residue, as `Surface` describes
_BATCH: Final = 1 << 18  # chosen: texels at a time, 50 MB


@dataclass(frozen=True, eq=False)
class BakedColours:
    """Images of the colours of a mesh.

    Attributes:
        images: `(h, w, 3)` uint8 sRGB by name, the first row at v = 1.
        face_image: `(f,)` position in `images` of the image of each face; -1 for none.
        uv: `(v, 2)` places of the vertices in their image, v upwards; the mesh's own uv without an image.
    """

    images: Mapping[str, NDArray[np.uint8]]
    face_image: NDArray[np.intp]
    uv: NDArray[np.float32]


def natural_surfaces(mesh: Mesh) -> dict[str, Surface]:
    """The surfaces of a mesh by name, over visible light: those of its cultivar, and of a greenhouse.

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
        surfaces |= organ_surfaces(cultivar, NATURAL_NM)
    if not set(mesh.surfaces) <= set(surfaces):
        surfaces = greenhouse_surfaces(NATURAL_NM) | surfaces
    return {name: surfaces[name] for name in mesh.surfaces if name in surfaces}


def linear_colours(
    spectra: FloatArray, wavelength_nm: FloatArray, light: FloatArray | None = None
) -> FloatArray:
    """`(n, 3)` linear sRGB of spectra, not clipped.

    Args:
        spectra: `(n, k)` reflectances; or spectral powers, with a light of 1 everywhere.
        wavelength_nm: `(k,)` evenly spaced.
        light: `(k,)` spectral power that falls on the surface; None for D65.
    """
    from pepperscene.spectra import colour_science

    colour = colour_science()
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    columns = [np.interp(wavelength_nm, observer.wavelengths, column) for column in observer.values.T]
    if light is None:
        d65 = colour.SDS_ILLUMINANTS["D65"]
        light = np.interp(wavelength_nm, d65.wavelengths, d65.values)
    weights = np.stack(columns) * light
    weights /= weights[1].sum()
    return np.asarray(colour.XYZ_to_RGB(spectra @ weights.T, "sRGB", apply_cctf_encoding=False), dtype=float)


def bake_colours(mesh: Mesh, surfaces: Mapping[str, Surface]) -> BakedColours:
    """Bake the colours of all organs whose colour does not come from a scan.

    Args:
        mesh: of organs that share no vertices, nor do their parts of different surfaces.
        surfaces: of `natural_surfaces`; faces of other surfaces get no image.
    """
    images: dict[str, NDArray[np.uint8]] = {}
    face_image, uv = np.full(len(mesh.faces), -1, np.intp), mesh.uv.copy()
    for name, surface, tile, rows in _parts(mesh, surfaces):
        corners = mesh.faces[rows]
        # Texels of organs with the same appearance are in one tile.
        keys = mesh.face_instance[rows].astype(np.int64) * len(mesh.appearances) + mesh.face_appearance[rows]
        organs, number = np.unique(keys, return_inverse=True)
        atlas = _Atlas.of(len(organs), tile)
        state = atlas.rasterise(number, mesh.uv[corners].astype(float), mesh.state[corners].astype(float))
        appearances = [mesh.appearances[key % len(mesh.appearances)] for key in organs.tolist()]
        step = max(_BATCH // math.prod(tile), 1)
        batches = [slice(first, first + step) for first in range(0, len(organs), step)]
        colours = [_texel_colours(surface, atlas.texel_uv, state[one], appearances[one]) for one in batches]
        face_image[rows] = len(images)
        uv[corners] = atlas.places(number[:, None], mesh.uv[corners])
        images[name] = atlas.image(np.concatenate(colours))
    return BakedColours(images, face_image, uv)


def _parts(
    mesh: Mesh, surfaces: Mapping[str, Surface]
) -> Iterator[tuple[str, Surface, tuple[int, int], NDArray[np.intp]]]:
    """Name, surface, size of tiles and faces of each image."""
    is_far = np.array([item.far_row >= 0 and not item.full for item in mesh.instances])[mesh.face_instance]
    usable = np.ones(len(mesh.faces), dtype=bool)
    if mesh.colour is not None:
        usable = mesh.colour[mesh.faces[:, 0], 0] == PIGMENTS
    for index, name in enumerate(mesh.surfaces):
        if name not in surfaces:
            continue
        faces = usable & (mesh.face_surface == index)
        for far in (False, True):
            rows = np.flatnonzero(faces & (is_far == far))
            if not len(rows):
                continue
            is_fruit = mesh.instance_class[mesh.face_instance[rows[0]]] == OrganClass.PEPPER
            near = _BLADE_TILE if surfaces[name].is_blade else _FRUIT_TILE if is_fruit else _TILE
            yield f"{name}_far" if far else name, surfaces[name], _FAR_TILE if far else near, rows


def _texel_colours(
    surface: Surface, uv: FloatArray, state: FloatArray, appearances: list[Appearance]
) -> NDArray[np.uint8]:
    """`(n, t, 3)` sRGB of the texels of n organs with a state `(n, t)` at the places `(t, 2)`."""
    from pepperscene.materials.tissue import SurfaceTexels, tissue_states

    texels = len(uv)
    places = np.tile(uv, (len(state), 1))
    variant = np.repeat(np.array([item.variant for item in appearances], np.int64), texels)
    ageing, cover = (
        np.repeat([getattr(item, name) for item in appearances], texels) for name in ("ageing", "residue")
    )
    mixed = tissue_states(surface, state.reshape(-1), places, variant, ageing)
    table = np.clip(linear_colours(surface.reflectance[:, 0], surface.wavelength_nm), 0.0, 1.0)
    linear = np.stack([np.interp(mixed, surface.states, channel) for channel in table.T], axis=-1)
    if surface.residue_pattern is not None and cover.any():
        cover = cover * SurfaceTexels.of(surface, places, variant).bilinear(surface.residue_pattern)
    cover = np.clip(cover, 0.0, _MOST_COVER)[:, None]
    linear += cover * (surface.residue_reflectance - linear)
    return np.round(255.0 * srgb_encode(linear)).astype(np.uint8).reshape(len(state), texels, 3)


@dataclass(frozen=True)
class _Atlas:
    """Tiles of equal size in rows from the lower left; texel centres are at the ends of u and v."""

    tile: tuple[int, int]  # texels across and along
    grid: tuple[int, int]  # tiles across and along
    count: int

    @classmethod
    def of(cls, count: int, tile: tuple[int, int]) -> _Atlas:
        """The layout of some tiles, which are smaller if the image would be too large."""
        while True:
            across = max(math.ceil(math.sqrt(count * tile[1] / tile[0])), 1)
            grid = across, -(-count // across)
            if max(grid[0] * tile[0], grid[1] * tile[1]) <= _LARGEST_IMAGE or min(tile) <= 2:
                return cls(tile, grid, count)
            tile = tile[0] // 2, tile[1] // 2

    @property
    def texel_uv(self) -> FloatArray:
        """`(t, 2)` surface coordinates of the texels of a tile, along u first."""
        u, v = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in self.tile))
        return np.stack([u.ravel(), v.ravel()], axis=1)

    def places(self, number: NDArray[np.intp], uv: NDArray[np.float32]) -> NDArray[np.float32]:
        """`(..., 2)` places in the image of surface coordinates in tiles."""
        corner = np.stack([number % self.grid[0], number // self.grid[0]], axis=-1) * np.array(self.tile)
        places = (corner + 0.5 + uv * (np.array(self.tile) - 1)) / (np.array(self.tile) * self.grid)
        return np.asarray(places, np.float32)

    def rasterise(self, number: NDArray[np.intp], uv: FloatArray, values: FloatArray) -> FloatArray:
        """`(count, t)` values of texels, linear over triangles of surface coordinates.

        Texels next to a triangle that no triangle covers have the value of its nearest place, all others the
        mean of their tile.

        Args:
            number: `(f,)` tile of each triangle.
            uv: `(f, 3, 2)` surface coordinates of its corners.
            values: `(f, 3)` at its corners.
        """
        from pepperscene.geometry.texel_kernel import fill_texels

        width, height = self.tile
        weight = np.bincount(number, minlength=self.count)
        mean = np.bincount(number, values.mean(axis=1), self.count) / np.maximum(weight, 1)
        texels = np.repeat(mean, width * height).reshape(self.count, height, width)
        fill_texels(texels, number, uv * (np.array(self.tile) - 1), values)
        return texels.reshape(self.count, -1)

    def image(self, colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`(h, w, 3)` the image of the tiles' colours `(count, t, 3)`."""
        (width, height), (across, along) = self.tile, self.grid
        tiles = np.zeros((across * along, height, width, 3), np.uint8)
        tiles[: self.count] = colours.reshape(self.count, height, width, 3)
        rows = tiles.reshape(along, across, height, width, 3).swapaxes(1, 2)
        return np.ascontiguousarray(rows.reshape(along * height, across * width, 3)[::-1])
