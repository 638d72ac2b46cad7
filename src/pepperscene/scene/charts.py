"""Charts that cameras are calibrated with: marker boards, a ColorChecker and a scale bar, as triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes, single_instance_mesh
from pepperscene.materials.stand import BLACK_PATCH, WHITE_PATCH, patch_state
from pepperscene.scene.greenhouse import as_single_instance, box
from pepperscene.scene.row import rotation_about_z
from pepperscene.units import DEGREES, MILLIMETRES, Angle, Switch, Table, within

MARKERS: Final = (
    0xB532, 0x0F9A, 0x332D, 0x9946, 0x549E, 0x79CD, 0x9E2E, 0xC4F2, 0xFEDA, 0xCF56, 0xF991, 0x11A7, 0x0EB7,
    0x2A0F, 0x24B1, 0x263E, 0x4665, 0x6600, 0x6C5E, 0x76AF, 0x868B, 0xB02B, 0xCCD5, 0xDD82, 0xFE47, 0x9471,
    0xACE4, 0xA554, 0x2123, 0x346F, 0x4415, 0x57B2, 0x9ECF, 0xF0CB, 0x08AE, 0x0929, 0x1875, 0x04FF, 0x0DF6,
    0x1C5A, 0x1718, 0x2A28, 0x328C, 0x38B2, 0x24E8, 0x2EEB, 0x2D3F, 0x4B64, 0x502E, 0x5013,
)  # fmt: skip
"""The 50 markers of OpenCV's dictionary DICT_4X4_50 (Apache-2.0): their 4 x 4 bits from the upper left, row
by row, 1 for white. A test compares them with OpenCV."""
_MARKER: Final = 6  # cells along a side: four bits and a black border of one cell
_GAP: Final = 2  # chosen: white cells between the markers of an ArUco board
_MARGIN: Final = 2  # chosen: white cells around a board
_BAR_HEIGHT: Final = 1.5  # chosen: of a scale bar, in divisions
_PATCH: Final = 0.9  # chosen: side of a patch over its pitch; the rest is the black frame
_FRAME: Final = 0.3  # chosen: black frame around the patches, in pitches
_THICKNESS: Final = 0.003  # chosen: of all charts
_ABOVE: Final = 1e-4  # metres from a card to its pattern, so that rays meet the pattern first


class ChartKind(StrEnum):
    """What a chart shows."""

    CHARUCO = "charuco"
    ARUCO = "aruco"
    COLORCHECKER = "colorchecker"
    SCALE_BAR = "scale_bar"


_DEFAULTS: Final = {
    ChartKind.CHARUCO: ((7, 5), 0.03),
    ChartKind.ARUCO: ((2, 2), 0.04),
    ChartKind.COLORCHECKER: ((6, 4), 0.0445),  # chosen: the patches of the large chart are about 40 mm wide
    ChartKind.SCALE_BAR: ((20, 1), 0.01),
}
"""Columns and rows, and the size of one: chosen."""

_Coordinate = Annotated[float, within(-5000, 5000), MILLIMETRES]
_Count = Annotated[int, within(1, 40)]


@dataclass(frozen=True, kw_only=True)
class CalibrationChart(Table):
    """A flat chart with black and white squares or coloured patches, whose light comes from its spectra.

    Boards use OpenCV's dictionary `DICT_4X4_50`, and have its markers in OpenCV's order, row by row from the
    upper left. Markers of a ChArUco board are three quarters as wide as its squares; those of an ArUco board
    are a third of their width apart.

    Attributes:
        position_m: x, y and z of its centre; 0, 0, 0 is on the ground below the plant.
        azimuth_rad: direction that it faces: 0 is towards the aisle, positive towards +x.
        tilt_rad: 0 stands upright, 90 lies face up.
        count: columns and rows of squares, markers or divisions. Default: 7 and 5 for `charuco`, 2 and 2 for
            `aruco`, 20 and 1 for `scale_bar`. A `colorchecker` has 6 and 4.
        cell_m: side of a square, a marker or a division, or distance from patch to patch. Default: 30 for
            `charuco`, 40 for `aruco`, 44.5 for `colorchecker`, 10 for `scale_bar`.
        first_marker: number of its first marker in the dictionary.
        turns: whether it turns with the plant, or stays with the camera.
    """

    kind: ChartKind
    position_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    azimuth_rad: Angle = 0.0
    tilt_rad: Annotated[float, within(-90, 90), DEGREES] = 0.0
    count: tuple[_Count, _Count] | None = None
    cell_m: Annotated[float, within(3, 200), MILLIMETRES] | None = None
    first_marker: Annotated[int, within(0, 49)] = 0
    turns: Switch = False

    def __post_init__(self) -> None:
        columns, rows = self.cells
        if self.kind == ChartKind.COLORCHECKER and (columns, rows) != (6, 4):
            raise ValueError("count must be [6, 4] for a colorchecker, or left out")
        if self.kind == ChartKind.SCALE_BAR and rows != 1:
            raise ValueError("count must have one row for a scale_bar")
        if self.kind == ChartKind.CHARUCO and min(columns, rows) < 2:
            raise ValueError("count must be at least [2, 2] for a charuco board")
        if self.first_marker + self.marker_count > len(MARKERS):
            raise ValueError(
                f"count = [{columns}, {rows}] needs {self.marker_count} markers from first_marker = "
                f"{self.first_marker} on, but the dictionary has {len(MARKERS)}"
            )

    @property
    def cells(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.count or _DEFAULTS[self.kind][0]

    @property
    def cell_size_m(self) -> float:
        """Side of a square, a marker or a division, or distance from patch to patch."""
        return self.cell_m or _DEFAULTS[self.kind][1]

    @property
    def marker_count(self) -> int:
        """Markers on the chart."""
        columns, rows = self.cells
        return {ChartKind.CHARUCO: columns * rows // 2, ChartKind.ARUCO: columns * rows}.get(self.kind, 0)

    @property
    def pose(self) -> NDArray[np.float64]:
        """`(4, 4)` from the chart's axes, right, up and towards its front, to those of the stand, metres."""
        c, s = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        upright = np.array([[1.0, 0.0, 0.0], [0.0, s, -c], [0.0, c, s]])
        pose = np.eye(4)
        pose[:3, :3] = rotation_about_z(self.azimuth_rad) @ upright
        pose[:3, 3] = self.position_m
        return pose

    def pattern(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Patches `(h, w)` by number, and the edges of columns `(w + 1,)` and rows `(h + 1,)` in metres.

        Columns go to the right and rows downwards; 0 is the upper left corner of the first square, marker,
        division or patch.
        """
        (columns, rows), size = self.cells, self.cell_size_m
        match self.kind:
            case ChartKind.COLORCHECKER:
                image = np.full((2 * rows + 1, 2 * columns + 1), BLACK_PATCH)
                image[1::2, 1::2] = np.arange(columns * rows).reshape(rows, columns)
                return image, _patch_edges(columns, size), _patch_edges(rows, size)
            case ChartKind.SCALE_BAR:
                dark = np.arange(columns)[None] % 2 == 0
                cell, edges_y = size, np.array([-1.0, 0.0, _BAR_HEIGHT, 1.0 + _BAR_HEIGHT]) * size
                image = _black_and_white(np.pad(~dark, 1, constant_values=True))
                return image, cell * np.arange(-1.0, columns + 2.0), edges_y
            case ChartKind.CHARUCO:
                white, cell = self._charuco(columns, rows), size / (_MARKER + 2)
            case ChartKind.ARUCO:
                white, cell = self._aruco(columns, rows), size / _MARKER
        image = _black_and_white(np.pad(white, _MARGIN, constant_values=True))
        edges_x, edges_y = (cell * np.arange(-_MARGIN, n + _MARGIN + 1.0) for n in white.shape[::-1])
        return image, edges_x, edges_y

    def _charuco(self, columns: int, rows: int) -> NDArray[np.bool_]:
        """Which cells of a ChArUco board are white, eight along a square; the upper left square is black."""
        side = _MARKER + 2
        white = np.zeros((rows * side, columns * side), dtype=bool)
        number = self.first_marker
        for row in range(rows):
            for column in range(columns):
                if (row + column) % 2:
                    square = white[row * side : (row + 1) * side, column * side : (column + 1) * side]
                    square[:] = np.pad(marker_bits(number), 1, constant_values=True)
                    number += 1
        return white

    def _aruco(self, columns: int, rows: int) -> NDArray[np.bool_]:
        """Which cells of an ArUco board are white."""
        pitch = _MARKER + _GAP
        white = np.ones((rows * pitch - _GAP, columns * pitch - _GAP), dtype=bool)
        for number in range(columns * rows):
            top, left = (pitch * n for n in divmod(number, columns))
            white[top : top + _MARKER, left : left + _MARKER] = marker_bits(self.first_marker + number)
        return white

    def mesh(self) -> Mesh:
        """The chart in the stand's axes: one instance of the background, its card and its pattern."""
        image, edges_x, edges_y = self.pattern()
        # Its middle is the origin: x to the right, y up, z towards the front.
        x = edges_x - (edges_x[0] + edges_x[-1]) / 2.0
        y = (edges_y[0] + edges_y[-1]) / 2.0 - edges_y
        card = box((y[-1], y[0]), (-_THICKNESS, -_ABOVE), (x[0], x[-1]), "chart")
        # As the pattern at its edge.
        edge = np.full(len(card.vertices), patch_state(int(image[0, 0])), np.float32)
        whole = concatenate_meshes([_pattern_mesh(image, x, y), replace(card, state=edge)])
        return as_single_instance(whole, str(self.kind)).moved(self.pose[:3, :3], self.pose[:3, 3])


def _patch_edges(count: int, pitch: float) -> NDArray[np.float64]:
    """Edges of the frame and the patches along one side; 0 is the beginning of the first patch."""
    starts = pitch * np.arange(count)
    patches = np.column_stack([starts, starts + _PATCH * pitch]).ravel()
    return np.concatenate([[patches[0] - _FRAME * pitch], patches, [patches[-1] + _FRAME * pitch]])


def _black_and_white(white: ArrayLike) -> NDArray[np.int64]:
    return np.where(white, WHITE_PATCH, BLACK_PATCH)


def marker_bits(number: int) -> NDArray[np.bool_]:
    """`(6, 6)` cells of a marker with its black border, upper row first; True is white."""
    bits = np.array([MARKERS[number] >> shift & 1 for shift in range(15, -1, -1)], dtype=bool)
    return np.pad(bits.reshape(4, 4), 1)


def _pattern_mesh(image: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64]) -> Mesh:
    """Two triangles for each cell of a pattern in the plane z = 0, front to +z."""
    rows, columns = (index.ravel() for index in np.indices(image.shape))
    right, down = np.array([0, 1, 1, 0]), np.array([1, 1, 0, 0])
    across, along = columns[:, None] + right, rows[:, None] + down
    vertices = np.stack([x[across], y[along], np.zeros(across.shape)], axis=-1).reshape(-1, 3)
    faces = 4 * np.arange(len(rows))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    uv = (vertices[:, :2] - [x[0], y[-1]]) / [x[-1] - x[0], y[0] - y[-1]]
    state = np.repeat([patch_state(patch) for patch in image.ravel().tolist()], 4)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    return single_instance_mesh(
        vertices, normals, uv, state, faces.reshape(-1, 3), OrganClass.BACKGROUND, "pattern", "chart"
    )
