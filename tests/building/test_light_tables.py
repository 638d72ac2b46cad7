"""Tables of absorbed light of a recipe: sums, units, options and files."""

from __future__ import annotations

import numpy as np
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

import pepperscene as ps
from pepperscene.building.scenes.light_tables import LIGHT_TABLES, lit_scene
from pepperscene.cli import app
from pepperscene.errors import ArgumentError, InputError

PLANT = {"row.plants_front": 1, "row.plants_back": 1, "cultivar": "kaite_february"}
OPTIONS = ps.LightOptions(bands="par,red,far_red", target_error=0.2, received=True, layer=250.0)


@pytest.fixture(scope="module")
def recipe():
    return ps.load_recipe("barth2018", PLANT)


@pytest.fixture(scope="module")
def tables(recipe):
    return ps.light_tables(recipe, 0, OPTIONS)


def rows(table, **values):
    return [row for row in table.to_pylist() if all(row[key] == value for key, value in values.items())]


def test_groups_are_sums_of_organs(tables):
    organs = rows(tables.organs, band="par")
    total = sum(row["absorbed_umol_s"] for row in organs)
    for table in (tables.plants, tables.layers, tables.rows):
        assert sum(row["absorbed_umol_s"] for row in rows(table, band="par", **{"class": "all"})) == (
            pytest.approx(total, rel=1e-9)
        )
    for plant in (0, 1):
        (leaves,) = rows(tables.plants, band="par", plant=plant, **{"class": "leaf"})
        own = [row for row in organs if row["plant"] == plant and row["class"] == "leaf"]
        assert leaves["area_m2"] == pytest.approx(sum(row["area_m2"] for row in own))
        assert leaves["absorbed_W"] == pytest.approx(sum(row["absorbed_W"] for row in own))
    for row in organs:
        assert row["layer"] == int(row["z_m"] // 0.25)
        assert row["row"] == row["plant"]
        assert row["absorbed_umol_m2_s"] == pytest.approx(row["absorbed_umol_s"] / row["area_m2"])


def test_amounts_are_plausible(tables):
    (time,) = tables.times.to_pylist()
    # 5,500 lx of daylight are about 100 umol m-2 s-1 of PAR: 54 lx for each (Thimijan & Heins 1983).
    assert time["illuminance_lx"] == pytest.approx(5500.0, rel=0.01)
    for row in rows(tables.organs, band="par", **{"class": "leaf"}):
        assert 0.0 < row["absorbed_umol_m2_s"] < 300.0
        # 4.57 umol/J of PAR (the same).
        assert 4.2 < row["absorbed_umol_s"] / row["absorbed_W"] < 4.9
    leaves = rows(tables.rows, **{"class": "leaf"})
    share = {
        row["band"]: row["absorbed_umol_m2_s"] / row["received_umol_m2_s"] for row in leaves if not row["row"]
    }
    # Leaves absorb most of PAR and red, and little of far red.
    assert 0.75 < share["par"] < 0.95
    assert share["far_red"] < 0.5 < share["red"]
    # Daylight has a ratio of 1.1 to 1.2 (Smith 1982), less among leaves.
    assert all(0.3 < row["red_far_red"] < 1.3 for row in leaves)


def test_same_seed_gives_the_same_bits(recipe):
    renderer = ps.FrameRenderer(recipe)
    scene = lit_scene(renderer, recipe.plan.frame(0), (400.0, 700.0))
    first, second, other = (
        ps.absorbed_light(scene, target_error=0.5, seed=seed).replicates for seed in (1, 1, 2)
    )
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_light_falls_as_in_the_photograph_of_a_turned_plant():
    renderer = ps.FrameRenderer(ps.load_recipe("turntable"))
    spec = renderer.recipe.plan.frame(15)
    lit, photographed = lit_scene(renderer, spec, (400.0, 700.0)), renderer.scene(spec)
    assert len(lit.lamps) == len(photographed.lamps) > 0
    for one, other in zip(lit.lamps, photographed.lamps, strict=True):
        np.testing.assert_array_equal(one.position_m, other.position_m)
        np.testing.assert_array_equal(one.rotation, other.rotation)
    # The cloth and the charts have gone round as well.
    np.testing.assert_array_equal(lit.mesh.bounds, photographed.mesh.bounds)
    assert not np.allclose(
        lit.mesh.bounds, lit_scene(renderer, renderer.recipe.plan.frame(0), (400.0, 700.0)).mesh.bounds
    )


def test_day_is_the_sum_of_its_times(tmp_path):
    weather = tmp_path / "day.csv"
    weather.write_text("time,direct_W_m2,diffuse_W_m2\n11:00,200,200\n13:00,0,200\n")
    options = ps.LightOptions(target_error=0.5, date="2026-06-21", weather=weather)
    tables = ps.light_tables(ps.load_recipe("barth2018", {**PLANT, "row.plants_back": 0}), 0, options)
    first, second = tables.times.to_pylist()
    assert (first["hours_h"], second["hours_h"]) == (2.0, 2.0)
    assert second["sun_elevation_deg"] is None
    by_organ = {}
    for row in tables.organs.to_pylist():
        by_organ.setdefault(row["instance"], []).append(row["absorbed_umol_m2_s"])
    for row in tables.day.to_pylist():
        assert row["absorbed_mol_m2"] == pytest.approx(sum(by_organ[row["instance"]]) * 7200e-6)
    # Float glass lets nine tenths pass.
    assert 0.8 < second["illuminance_lx"] / (200.0 * 130.0) < 1.0


def test_command_writes_tables(tmp_path):
    settings = [f"--set={key}={value}" for key, value in {**PLANT, "row.plants_back": 0}.items()]
    arguments = ["light", "barth2018", "--out", str(tmp_path), "--target-error", "0.5", *settings]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    names = {path.stem for path in tmp_path.iterdir()}
    assert names == set(LIGHT_TABLES) - {"day"}
    for name in names:
        assert parquet.read_table(tmp_path / f"{name}.parquet").column_names == list(LIGHT_TABLES[name])


@pytest.mark.parametrize(
    "options",
    [
        {"bands": "purple"}, {"bands": "par,par"}, {"bands": "x=700-600"}, {"bands": "x=200-600"},
        {"bands": ""}, {"target_error": 0.0}, {"target_error": float("nan")}, {"layer": 0.0},
        {"date": "june"}, {"date": "2026-12-21", "latitude": 80.0}, {"weather": "day.csv"},
        {"date": "2026-06-21", "every": 0.0}, {"latitude": 100.0, "date": "2026-06-21"},
    ],
)  # fmt: skip
def test_bad_options(recipe, options):
    with pytest.raises(InputError):
        ps.light_tables(recipe, 0, ps.LightOptions(**options))


def test_bad_format(tmp_path, tables):
    with pytest.raises(ArgumentError, match="parquet or csv"):
        ps.write_light(tables, tmp_path, "xlsx")
    assert not list(tmp_path.iterdir())


def test_scene_without_light_absorbs_none():
    dark = ps.load_recipe("barth2018", {**PLANT, "row.plants_back": 0, "daylight.illuminance_lx": 0})
    tables = ps.light_tables(dark, 0, ps.LightOptions(target_error=0.5))
    assert np.all(np.array(tables.organs["absorbed_W"]) == 0.0)
