"""A drawing of camera places over the rows, seen from above and along the rows, by matplotlib."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.recipe.plan import Stream, random_generator
from pepperscene.recipe.resolve.frame_setups import FrameSetup
from pepperscene.recipe.views_tables import RandomViews
from pepperscene.review.preview.places import CameraPlaces

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pepperscene.scene import Greenhouse
    from pepperscene.scene.greenhouse import RowLine

Array = NDArray[np.float64]

_SIZE_IN: Final = (11.0, 6.0)
_LEFT_IN: Final = (0.75, 0.75)  # before each of the two drawings
_RIGHT_IN, _BOTTOM_IN, _HEIGHT_IN = 0.15, 0.95, 4.35
_ARROW: Final = 0.055  # chosen: length of a view direction over the height of a drawing
_DPI: Final = 130
_MOST_ARROWS: Final = 60  # chosen: view directions of a camera that are drawn; more would be one area
_PLANT: Final = "#2e7d32"
_FAR: Final = "#a5b8a3"
_DASHES: Final = (0, (4, 3))
_GUTTER, _GUTTER_EDGE = "#e4e7de", "#b9bdb0"
_TARGET: Final = "#c2185b"
_CAMERAS: Final = ("#1f4e9e", "#d1600f", "#6a3d9a", "#00838f")  # of a rig, repeated if there are more
_STEM_RADIUS_M: Final = 0.03  # chosen: of the circle of a plant, three times a stem, so that it is visible
_MARGIN_M: Final = 0.25  # chosen: around plants and cameras
_ABOVE_BASE_M: Final = 1.5  # chosen: height of the plants that the side view shows at least
_SELECTED, _FURTHER = 0.95, 0.4
"""Opacity of the cameras of selected and of further frames. Chosen: places are seen through each other."""
_DOTS: Final = (4.0, 2.8)  # diameters in points, of few cameras and of many
_STYLE: Final = {
    "font.size": 8.5,
    "text.parse_math": False,  # names may hold dollar signs
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@dataclass(frozen=True, eq=False)
class RowGeometry:
    """The rows of a scene.

    Attributes:
        greenhouse: dimensions in metres.
        plants: `(n, 2)` x and y of the plants of the double row.
        lines: of all rows, the double row first.
    """

    greenhouse: Greenhouse
    plants: Array
    lines: tuple[RowLine, ...]


def row_geometry(setup: FrameSetup, set_index: int) -> RowGeometry:
    """The rows of a set of plants; offsets of single plants across their row are left out."""
    from pepperscene.scene import jittered_positions
    from pepperscene.scene.greenhouse import row_lines

    builder = SceneBuilder(setup.recipe, setup.cultivar, processes=1)
    row, greenhouse = builder.row, builder.greenhouse
    rng = random_generator(setup.recipe.seed, Stream.PLACE, set_index, 0)
    plants = jittered_positions(row, greenhouse, rng)
    return RowGeometry(greenhouse, plants, tuple(row_lines(row, greenhouse)))


def draw_plan(name: str, rows: RowGeometry, places: CameraPlaces) -> bytes:
    """Draw the camera places of a scene of the recipe with this name; returns the content of a PNG file."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=_SIZE_IN)
        ranges = _shown_ranges(rows, places)
        width, depth, _ = np.ptp(ranges, axis=1)
        # The limits are chosen: neither drawing gets less than 0.38 of the width.
        share = float(np.clip(width / (width + depth), 0.4, 0.62))
        spare_in = _SIZE_IN[0] - sum(_LEFT_IN) - _RIGHT_IN
        widths_in = share * spare_in, (1 - share) * spare_in
        top = _add_axes(figure, _LEFT_IN[0], widths_in[0], ranges[0], ranges[1])
        side = _add_axes(figure, sum(_LEFT_IN) + widths_in[0], widths_in[1], ranges[1], ranges[2])
        _draw_top(top, rows)
        _draw_side(side, rows)
        for axes, plane in ((top, [0, 1]), (side, [1, 2])):
            _draw_places(axes, places, plane, _ARROW * _HEIGHT_IN)
        if places.limits is not None and not len(places.poses):
            _draw_limits(top, side, places.limits, _middle(rows, places.limits))
        for axis in (top.xaxis, top.yaxis, side.xaxis, side.yaxis):
            axis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
        top.set(title="from above", xlabel="x along the row (m)", ylabel="y into the crop (m)")
        side.set(title="along the row", xlabel="y into the crop (m)", ylabel="z above the floor (m)")
        figure.suptitle(_title(name, places), x=0.02, y=0.97, ha="left", fontsize=11)
        _add_legend(figure, rows, places)
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=_DPI, metadata={"Software": None})
    return file.getvalue()


def _add_axes(figure: Figure, left_in: float, width_in: float, across: Array, up: Array) -> Axes:
    """Axes with the same scale in both directions, which show two ranges and what is beside them."""
    page_width, page_height = _SIZE_IN
    box = left_in / page_width, _BOTTOM_IN / page_height, width_in / page_width, _HEIGHT_IN / page_height
    axes = figure.add_axes(box)
    scale = max(np.ptp(across) / width_in, np.ptp(up) / _HEIGHT_IN)
    for set_limits, limits, length_in in ((axes.set_xlim, across, width_in), (axes.set_ylim, up, _HEIGHT_IN)):
        half = scale * length_in / 2
        set_limits(limits.mean() - half, limits.mean() + half)
    axes.set_aspect("equal", adjustable="box")
    axes.autoscale(False)
    return axes


def _title(name: str, places: CameraPlaces) -> str:
    spec, count = places.spec, len(places.poses)
    text = f"{name}: set {spec.set}, rotation {spec.rotation}"
    if count:
        return f"{text}, {count} camera {'place' if count == 1 else 'places'}"
    return f"{text}, views that depend on the plants, which were not grown"


def _middle(rows: RowGeometry, limits: RandomViews) -> Array:
    """`(3,)` the point that the limits of random views are drawn around: the target, or where one can be."""
    if not isinstance(limits.target, str):
        return np.array(limits.target)
    # The middle plant of the front row.
    z = rows.greenhouse.stem_base_m + _ABOVE_BASE_M
    return np.array([0.0, -rows.greenhouse.lean_offset_m(z), z])


def _shown_ranges(rows: RowGeometry, places: CameraPlaces) -> Array:
    """`(3, 2)` ranges of x, y and z in metres that a drawing shows: of plants, cameras and targets."""
    base = rows.greenhouse.stem_base_m
    feet = np.column_stack([rows.plants, np.full(len(rows.plants), base + _ABOVE_BASE_M)])
    points = [feet, places.poses[:, :3, 3], places.targets]
    if places.limits is not None and not len(places.poses):
        middle, reach = _middle(rows, places.limits), places.limits.distance_m[1]
        # Only azimuths of more than 90 degrees are behind the target.
        behind = max(0.0, -float(np.cos(places.limits.azimuth_rad).min()))
        points.append(middle + reach * np.array([[-1.0, -1.0, -1.0], [1.0, behind, 1.0]]))
        if places.limits.volume_m is not None:
            points.append(np.array(places.limits.volume_m).T)
    every = np.concatenate(points)
    ranges = np.stack([every.min(axis=0) - _MARGIN_M, every.max(axis=0) + _MARGIN_M], axis=1)
    ranges[2, 0] = min(ranges[2, 0], -_MARGIN_M / 4)  # just below the floor
    return ranges


def _draw_top(axes: Axes, rows: RowGeometry) -> None:
    """Gutters as strips, rows beyond the double row as lines, plants as circles."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Rectangle

    greenhouse = rows.greenhouse
    reach, width = greenhouse.far_reach_m, greenhouse.gutter_width_m
    for line in rows.lines:
        if width:
            strip = Rectangle((-reach, line.y_m - width / 2), 2 * reach, width, color=_GUTTER, zorder=0)
            axes.add_patch(strip)
        if greenhouse.far_rows:
            axes.plot([-reach, reach], [line.y_m] * 2, color=_FAR, linewidth=1.2, linestyle=_DASHES, zorder=1)
    circles = [Circle((x, y), _STEM_RADIUS_M) for x, y in rows.plants]
    axes.add_collection(PatchCollection(circles, color=_PLANT, zorder=2))


def _draw_side(axes: Axes, rows: RowGeometry) -> None:
    """Each row as a line that leans with it; floor, gutters, and crop wires as dots."""
    from matplotlib.patches import Rectangle

    greenhouse = rows.greenhouse
    base, bottom, width = greenhouse.stem_base_m, greenhouse.gutter_height_m, greenhouse.gutter_width_m
    high = greenhouse.crop_wire_m or base + axes.get_ylim()[1]
    axes.axhline(0.0, color="#9e9e9e", linewidth=1.0, zorder=0)
    for line in rows.lines:
        if not (line.labelled or greenhouse.far_rows):
            continue
        if width:
            size = (line.y_m - width / 2, bottom), width, base - bottom
            axes.add_patch(
                Rectangle(*size, facecolor=_GUTTER, edgecolor=_GUTTER_EDGE, linewidth=0.6, zorder=0)
            )
        y = [line.y_m, line.y_m + line.aisle * greenhouse.lean_offset_m(high)]
        style = (_PLANT, "-", 2.4) if line.labelled else (_FAR, _DASHES, 1.2)
        axes.plot(y, [base, high], color=style[0], linestyle=style[1], linewidth=style[2], zorder=1)
        if greenhouse.crop_wire_m:
            axes.plot(y[1], high, ".", color="#616161", markersize=4, zorder=2)


def _draw_places(axes: Axes, places: CameraPlaces, plane: list[int], arrow_in: float) -> None:
    """Cameras as dots with lines in their directions of view, and targets as crosses, in a plane."""
    if len(places.targets):
        x, y = places.targets[:, plane].T
        axes.plot(x, y, "x", color=_TARGET, markersize=3.5, markeredgewidth=0.8, alpha=0.7, zorder=3)
    dot: dict[str, Any] = {"markersize": _DOTS[len(places.poses) > _MOST_ARROWS], "markeredgewidth": 0.0}
    # Those of selected frames are drawn above the others.
    for is_selected in (False, True):
        for number in range(len(places.cameras)):
            poses = places.poses[(places.camera == number) & (places.selected == is_selected)]
            if not len(poses):
                continue
            colour, alpha = _CAMERAS[number % len(_CAMERAS)], _SELECTED if is_selected else _FURTHER
            axes.plot(*poses[:, plane, 3].T, "o", color=colour, alpha=alpha, zorder=5, **dot)
            # Lengths in inches are the same in both drawings, apart from foreshortening.
            some = poses[:: -(-len(poses) // _MOST_ARROWS)]
            x, y = some[:, plane, 3].T
            u, v = arrow_in * some[:, plane, 2].T
            style: dict[str, Any] = {"units": "inches", "scale_units": "inches", "scale": 1.0, "width": 0.009}
            style |= {"headwidth": 1.0, "headlength": 0.0, "headaxislength": 0.0, "minlength": 0.0}
            axes.quiver(x, y, u, v, angles="xy", color=colour, alpha=alpha, zorder=4, **style)


def _draw_limits(top: Axes, side: Axes, limits: RandomViews, middle: Array) -> None:
    """The sectors that cameras are drawn in around one target, and the limits of their places."""
    from matplotlib.patches import Rectangle, Wedge

    near, far = limits.distance_m
    # The border shows sectors without an area, of a single distance or angle.
    style: dict[str, Any] = {"facecolor": (_CAMERAS[0], 0.25), "edgecolor": (_CAMERAS[0], 0.6)}
    style |= {"linewidth": 1.0, "width": max(far - near, 1e-3), "zorder": 3}
    # Azimuth 0 is at -y, and positive azimuths are towards +x.
    azimuth = np.degrees(limits.azimuth_rad) - 90.0
    top.add_patch(Wedge((middle[0], middle[1]), far, *azimuth, **style))
    low, high = np.degrees(limits.elevation_rad)
    cosine = np.cos(limits.azimuth_rad)
    if cosine.max() > 0.0 or limits.azimuth_rad[0] < 0.0 < limits.azimuth_rad[1]:
        side.add_patch(Wedge((middle[1], middle[2]), far, 180.0 - high, 180.0 - low, **style))
    if cosine.min() < 0.0:
        side.add_patch(Wedge((middle[1], middle[2]), far, low, high, **style))
    for axes, plane in ((top, [0, 1]), (side, [1, 2])):
        axes.plot(*middle[plane], "x", color=_TARGET, markersize=6, zorder=4)
        if limits.volume_m is not None:
            (left, right), (low, high) = (limits.volume_m[axis] for axis in plane)
            frame = Rectangle(
                (left, low), right - left, high - low, fill=False, edgecolor=_CAMERAS[0], zorder=3
            )
            axes.add_patch(frame)


def _add_legend(figure: Figure, rows: RowGeometry, places: CameraPlaces) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=_PLANT, marker="o", linestyle="", label="plants")]
    if rows.greenhouse.gutter_width_m:
        handles.append(Patch(facecolor=_GUTTER, edgecolor=_GUTTER_EDGE, label="gutters"))
    if rows.greenhouse.far_rows:
        handles.append(Line2D([], [], color=_FAR, linestyle=_DASHES, label="far rows"))
    some = bool(places.selected.any() and not places.selected.all())
    for number, name in enumerate(places.cameras if len(places.poses) else ()):
        label = "cameras" if len(places.cameras) == 1 else f"camera {name}"
        colour = _CAMERAS[number % len(_CAMERAS)]
        style: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 4}
        handles.append(Line2D([], [], label=label + (" of selected frames" if some else ""), **style))
        if some:
            handles.append(Line2D([], [], label=f"{label} of further frames", alpha=_FURTHER, **style))
    if places.limits is not None and not len(places.poses):
        handles.append(Patch(color=_CAMERAS[0], alpha=0.25, label="limits of the places around one target"))
        handles.append(Line2D([], [], color=_TARGET, marker="x", linestyle="", label="a target"))
    elif len(places.targets):
        handles.append(Line2D([], [], color=_TARGET, marker="x", linestyle="", label=places.target_name))
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.012, 0.0),
        ncols=min(len(handles), 6),
        frameon=False,
    )
