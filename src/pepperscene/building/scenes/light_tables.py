"""Absorbed light of a recipe's plants as tables by organ, plant, layer and row, now or over a day."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.light_options import LightOptions
from pepperscene.building.scenes.skies import sky_under_daylight
from pepperscene.building.scenes.trait_tables import write_tables
from pepperscene.building.scenes.turning import sky_at, turn_of
from pepperscene.dataset.store.manifest import Row, TableColumn, axis_columns, column_types, rows_table
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

if TYPE_CHECKING:
    import pyarrow

    from pepperscene.render.absorbed import AbsorbedLight, LightAmounts, LightTracer
    from pepperscene.scene import Scene, Sky
    from pepperscene.scene.daylight_course import DaylightMoment
    from pepperscene.spectra.wavebands import Waveband

_TIME: Final = {
    "frame": TableColumn("int64", "the frame whose scene this is"),
    "time": TableColumn("string", "local time with its offset; null for the recipe's own daylight"),
}
_AMOUNTS: Final = {
    "band": TableColumn("string", "name of the band of wavelengths"),
    "absorbed_W": TableColumn("double", "absorbed power"),
    "absorbed_error_W": TableColumn("double", "its standard error"),
    "absorbed_umol_s": TableColumn("double", "absorbed photons"),
    "absorbed_error_umol_s": TableColumn("double", "their standard error"),
    "absorbed_W_m2": TableColumn("double", "`absorbed_W` over `area_m2`"),
    "absorbed_umol_m2_s": TableColumn("double", "`absorbed_umol_s` over `area_m2`"),
    "received_umol_m2_s": TableColumn(
        "double", "photons that arrive at all sides over `area_m2`; null without `--received`"
    ),
    "received_error_umol_m2_s": TableColumn("double", "their standard error"),
    "red_far_red": TableColumn(
        "double", "ratio of the received photons of the bands `red` and `far_red`; null without them"
    ),
}
_AREA: Final = {
    "area_m2": TableColumn("double", "of the organs' triangles: one side of a blade, the skin of a fruit")
}
_ORGAN: Final = {
    "plant": TableColumn("int32", "number of the plant, as in a frame's JSON"),
    "instance": TableColumn("int32", "value of the instance images of this scene"),
    "kind": TableColumn("string", "kind of organ"),
    "class": TableColumn("string", "class of its pixels"),
    "phytomer": TableColumn(
        "int32", "position of its node along the main stem, 0 at the ground; -1 for none"
    ),
    "row": TableColumn("int32", "0 for the front row, 1 for the back row"),
    "layer": TableColumn("int32", "number of the layer of its centroid, 0 at the floor"),
    **axis_columns("{}_m", "centroid of its surface (world); *z* is its height above the floor"),
    **_AREA,
}
_CLASS: Final = {"class": TableColumn("string", "class of organs; `all` for all organs together")}
LIGHT_TABLES: Final[Mapping[str, Mapping[str, TableColumn]]] = {
    "organs": {**_TIME, **_ORGAN, **_AMOUNTS},
    "plants": {**_TIME, "plant": _ORGAN["plant"], **_CLASS, **_AREA, **_AMOUNTS},
    "layers": {
        **_TIME,
        "layer": TableColumn("int32", "number of the layer, 0 at the floor"),
        "z_m": TableColumn("double", "height of its lower limit"),
        **_CLASS,
        **_AREA,
        **_AMOUNTS,
    },
    "rows": {**_TIME, "row": _ORGAN["row"], **_CLASS, **_AREA, **_AMOUNTS},
    "times": {
        **_TIME,
        "hours_h": TableColumn("double", "part of the day that this time stands for; null without a day"),
        "sun_elevation_deg": TableColumn("double", "of the sun above the horizon; null without a sun"),
        "sun_azimuth_deg": TableColumn("double", "of the sun in the scene, counter-clockwise from *x*"),
        "illuminance_lx": TableColumn(
            "double", "of a level plane above the crop, below the cover, by daylight"
        ),
    },
    "day": {
        "frame": _TIME["frame"],
        **_ORGAN,
        "band": _AMOUNTS["band"],
        "absorbed_kJ_m2": TableColumn("double", "absorbed energy of the day over `area_m2`"),
        "absorbed_mol_m2": TableColumn("double", "absorbed photons of the day over `area_m2`"),
        "absorbed_error_mol_m2": TableColumn("double", "their standard error"),
    },
}
"""Columns by the name of the table, which is that of its file."""


@dataclass(frozen=True, eq=False)
class OrganLight:
    """Light of the plants of a scene: Arrow tables with the columns of `LIGHT_TABLES`.

    Attributes:
        organs: a row for each organ, band and time.
        plants, layers, rows: for each of these, class of organs, band and time.
        times: for each time.
        day: for each organ and band, over the day; no rows without one.
    """

    organs: pyarrow.Table
    plants: pyarrow.Table
    layers: pyarrow.Table
    rows: pyarrow.Table
    times: pyarrow.Table
    day: pyarrow.Table


def light_tables(
    recipe: Recipe | ResolvedRecipe | str | Path,
    frame: int | None = None,
    options: LightOptions | None = None,
    on_stage: Callable[[str], None] | None = None,
) -> OrganLight:
    """Trace the light that the plants of a frame's scene absorb, from sun, sky and the scene's lamps.

    Lamps that flash, or are fixed to the camera, are left out.

    Args:
        recipe: a recipe, its resolved form, a shipped name or a path.
        frame: index of the frame; None for the first that the recipe selects.
        options: bands, errors, and the day; None for PAR by the recipe's own daylight.
        on_stage: called with the name of each stage when it begins.

    Raises:
        InputError: the recipe, a file that it names, the index or an option is not valid.
    """
    options, on_stage = options or LightOptions(), on_stage or (lambda _: None)
    moments, bands = options.moments(), options.wavebands()
    renderer = FrameRenderer(recipe, on_stage=on_stage)
    spec = renderer.recipe.plan.first_frame(frame)
    tracer = _tracer(renderer, spec, bands, on_stage)
    organs = _Organs.of(tracer, renderer.setups.at(spec).recipe.row.plants_front, options.layer / 1e3)
    rows: dict[str, list[Row]] = {name: [] for name in LIGHT_TABLES}
    parts, hours = [], []
    for when, length, sky in _skies(renderer, spec, options, moments):
        on_stage("tracing light" if when is None else f"tracing light at {when[11:16]}")
        seed = renderer.recipe.seed
        light = tracer.trace(sky, target_error=options.target_error, seed=seed)
        received = None
        if options.received:
            received = tracer.trace(
                sky, measured="received", target_error=options.target_error, seed=seed + 1
            )
        start: Row = {"frame": spec.index, "time": when}
        for name, table_rows in organs.rows(light, received).items():
            rows[name] += [start | row for row in table_rows]
        rows["times"].append(start | _time_row(sky, length))
        parts.append(light)
        hours.append(length or 0.0)
    if moments is not None:
        rows["day"] = [{"frame": spec.index} | row for row in organs.day_rows(parts, hours)]
    return OrganLight(
        **{name: rows_table(rows[name], column_types(table)) for name, table in LIGHT_TABLES.items()}
    )


def write_light(tables: OrganLight, folder: str | Path, file_format: str = "parquet") -> tuple[Path, ...]:
    """Write the tables as `.parquet` or `.csv` into a folder, all or none; `day` only if it has rows.

    Raises:
        InputError: the format is unknown.
        OutputError: a file cannot be written.
    """
    named = {name: getattr(tables, name) for name in LIGHT_TABLES if name != "day" or tables.day.num_rows}
    return write_tables(named, folder, file_format)


def lit_scene(renderer: FrameRenderer, spec: FrameSpec, nm: tuple[float, float]) -> Scene:
    """The scene of a frame that light of a range of wavelengths is traced in.

    It is complete, with coarse plants in far rows.
    """
    from pepperscene.scene import assemble_scene

    built, (surfaces, sky) = renderer.built_scene(spec), renderer.optics(spec, nm)
    return assemble_scene(built.mesh, surfaces, sky, built.skeleton, renderer.lamps(spec))


def _tracer(
    renderer: FrameRenderer, spec: FrameSpec, bands: tuple[Waveband, ...], on_stage: Callable[[str], None]
) -> LightTracer:
    from pepperscene.render.absorbed import LightTracer
    from pepperscene.spectra.wavebands import FIRST_NM, LAST_NM

    on_stage("growing plants")
    return LightTracer(lit_scene(renderer, spec, (FIRST_NM, LAST_NM)), bands)


def _skies(
    renderer: FrameRenderer, spec: FrameSpec, options: LightOptions, moments: list[DaylightMoment] | None
) -> Iterator[tuple[str | None, float | None, Sky | None]]:
    """Time, hours of the day that it stands for, and sky, of each moment."""
    if moments is None:
        yield None, None, renderer.sky(spec)
        return
    for moment in moments:
        total = moment.direct_lx + moment.diffuse_lx
        sky = sky_under_daylight(
            renderer.builder(spec),
            renderer.setups.at(spec),
            spec,
            direct_lx=moment.direct_lx,
            diffuse_lx=moment.diffuse_lx,
            # Chosen: clouds hide as much of the sky as of the light is diffuse, but a clear sky's own light.
            cloud_cover=0.0 if options.weather is None else min(moment.diffuse_lx / total, 1.0),
            sun_azimuth_rad=math.radians(options.north) - moment.azimuth_rad,
            sun_elevation_rad=moment.elevation_rad,
        )
        when, turn_rad = moment.when.isoformat(timespec="minutes"), turn_of(spec, renderer.setups.at(spec))
        yield when, moment.hours, sky_at(sky, turn_rad)


def _time_row(sky: Sky | None, hours: float | None) -> Row:
    row: Row = {"hours_h": hours, "illuminance_lx": 0.0 if sky is None else sky.horizontal_illuminance()}
    if sky is not None and sky.sun is not None:
        x, y, z = sky.sun.direction.tolist()
        row["sun_elevation_deg"] = math.degrees(math.asin(z))
        row["sun_azimuth_deg"] = math.degrees(math.atan2(y, x))
    return row


@dataclass(frozen=True, eq=False)
class _Organs:
    """The organs of a tracer: their columns, and the groups that each belongs to."""

    columns: list[Row]  # of each organ
    classes: tuple[list[str], NDArray[np.intp]]  # names of the classes, and `(n,)` that of each organ
    # Columns of the groups of plants, layers and rows, and `(n,)` the group of each organ.
    groups: dict[str, tuple[list[Row], NDArray[np.intp]]]

    @classmethod
    def of(cls, tracer: LightTracer, plants_front: int, layer_m: float) -> _Organs:
        from pepperscene.geometry.sizes import organ_sizes

        mesh, instances = tracer.scene.mesh, tracer.instances
        items = [mesh.instances[k] for k in instances.tolist()]
        centre = organ_sizes(mesh, instances).surface_centre_m
        layer = np.maximum(np.floor(centre[:, 2] / layer_m), 0.0).astype(int)
        plant = np.array([item.plant for item in items])
        row = (plant >= plants_front).astype(int)
        names = [item.organ_class.name.lower() for item in items]
        columns: list[Row] = []
        for k, item in enumerate(items):
            x, y, z = centre[k].tolist()
            organ = {"plant": item.plant, "instance": int(instances[k]) + 1, "kind": item.kind}
            organ |= {"class": names[k], "phytomer": item.phytomer}
            organ |= {"row": int(row[k]), "layer": int(layer[k])}
            columns.append(organ | {"x_m": x, "y_m": y, "z_m": z})
        groups = {}
        for key, values in (("plant", plant), ("layer", layer), ("row", row)):
            found, group = np.unique(values, return_inverse=True)
            keys: list[Row] = [{key: int(value)} for value in found]
            if key == "layer":
                keys = [one | {"z_m": layer_m * one["layer"]} for one in keys]
            groups[f"{key}s"] = keys, group
        found, number = np.unique(names, return_inverse=True)
        return cls(columns, (found.tolist(), number), groups)

    def rows(self, light: AbsorbedLight, received: AbsorbedLight | None) -> dict[str, list[Row]]:
        """The rows of all tables of a moment."""
        each = np.arange(len(light.instances))
        tables = {"organs": _amount_rows(self.columns, each, light, received)}
        classes, number = self.classes
        for table, (keys, group) in self.groups.items():
            tables[table] = []
            for k, name in enumerate(["all", *classes]):
                of_class = np.where(number == k - 1, group, -1) if k else group
                named = [one | {"class": name} for one in keys]
                tables[table] += _amount_rows(named, of_class, light, received)
        return tables

    def day_rows(self, parts: list[AbsorbedLight], hours: list[float]) -> Iterator[Row]:
        """The rows of a day."""
        from pepperscene.render.absorbed import add_light

        light = add_light(parts, [3600.0 * length for length in hours])
        amounts, area = light.amounts, light.area_m2
        for b, band in enumerate(light.bands):
            per_area = (
                1e-3 * amounts.watts[b] / area,
                1e-6 * amounts.umol_s[b] / area,
                1e-6 * amounts.umol_s_error[b] / area,
            )
            names = "absorbed_kJ_m2", "absorbed_mol_m2", "absorbed_error_mol_m2"
            for k, organ in enumerate(self.columns):
                values = dict(zip(names, (float(one[k]) for one in per_area), strict=True))
                yield organ | {"area_m2": float(area[k]), "band": band.name} | values


def _amount_rows(
    keys: list[Row], group: NDArray[np.intp], light: AbsorbedLight, received: AbsorbedLight | None
) -> list[Row]:
    """Rows of groups of organs, without empty ones, band by band."""
    count, rows = len(keys), list[Row]()
    members = group >= 0
    area = np.bincount(group[members], light.area_m2[members], count)
    amounts = light.grouped(group, count)
    arriving = None if received is None else received.grouped(group, count)
    ratio = None if arriving is None else _red_far_red(light, arriving)
    for k in np.flatnonzero(area > 0.0).tolist():
        for b, band in enumerate(light.bands):
            row = keys[k] | {"area_m2": float(area[k]), "band": band.name}
            row |= _absorbed_columns(amounts, b, k, float(area[k]))
            if arriving is not None:
                row["received_umol_m2_s"] = float(arriving.umol_s[b, k] / area[k])
                row["received_error_umol_m2_s"] = float(arriving.umol_s_error[b, k] / area[k])
            if ratio is not None and math.isfinite(ratio[k]):
                row["red_far_red"] = float(ratio[k])
            rows.append(row)
    return rows


def _absorbed_columns(amounts: LightAmounts, b: int, k: int, area: float) -> dict[str, Any]:
    return {
        "absorbed_W": float(amounts.watts[b, k]),
        "absorbed_error_W": float(amounts.watts_error[b, k]),
        "absorbed_umol_s": float(amounts.umol_s[b, k]),
        "absorbed_error_umol_s": float(amounts.umol_s_error[b, k]),
        "absorbed_W_m2": float(amounts.watts[b, k] / area),
        "absorbed_umol_m2_s": float(amounts.umol_s[b, k] / area),
    }


def _red_far_red(light: AbsorbedLight, arriving: LightAmounts) -> NDArray[np.float64] | None:
    """`(n,)` ratio of the photons of both bands; None if one was not traced."""
    names = [band.name for band in light.bands]
    if not {"red", "far_red"} <= set(names):
        return None
    red, far_red = (arriving.umol_s[names.index(name)] for name in ("red", "far_red"))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(red / far_red)
