"""Fine textures of skins: means, limits, sizes, and errors of their files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from pepperscene.errors import InputError
from pepperscene.materials import load_skin
from pepperscene.materials.skin import TEXEL_MM, TILE, SkinTable, skin_tile
from pepperscene.shipped import shipped_folder

SHIPPED = sorted(path.stem for path in (shipped_folder("materials") / "skins").glob("*.toml"))


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("part", ["fruit", "leaf", "stem"])
def test_means_are_those_of_a_surface_without_texture(name, part):
    tile = skin_tile(getattr(load_skin(name), part), part, roughness=0.07)
    assert tile.change.shape == tile.residue.shape == (TILE, TILE)
    assert tile.change.mean(dtype=float) == pytest.approx(0.0, abs=1e-6)
    assert np.abs(tile.change).max() <= 0.9
    assert tile.residue.mean(dtype=float) == pytest.approx(1.0, abs=1e-5)
    assert tile.residue.min() >= 0.0
    assert tile.slopes.mean(axis=(0, 1), dtype=float) == pytest.approx(np.zeros(2), abs=1e-6)
    # Half of the slopes that a lobe of this roughness stands for, of variance alpha^2 / 2 along each axis.
    assert (tile.slopes.astype(float) ** 2).sum(axis=-1).mean() <= 0.5 * 0.07**2 + 1e-9


def test_a_texture_depends_on_the_name_of_its_surface_alone():
    table = load_skin("pepper").fruit
    first, again, other = (skin_tile(table, name, 0.1) for name in ("fruit", "fruit", "other fruit"))
    np.testing.assert_array_equal(first.change, again.change)
    assert abs(np.corrcoef(first.change.ravel(), other.change.ravel())[0, 1]) < 0.05


@pytest.mark.parametrize("grain_mm", [0.3, 0.8])
def test_grains_have_their_width(grain_mm):
    # Noise under a Gaussian filter of deviation s has the autocorrelation exp(-r^2 / 4 s^2), here s = g / 4.
    change = skin_tile(SkinTable(speckle=0.1, grain_mm=grain_mm), "grains", 0.1).change.astype(float)
    assert change.std() == pytest.approx(0.1, rel=1e-3)
    shift = round(0.5 * grain_mm / TEXEL_MM)
    expected = np.exp(-((shift * TEXEL_MM) ** 2) / (4.0 * (0.25 * grain_mm) ** 2))
    for axis in (0, 1):
        found = (change * np.roll(change, shift, axis)).mean() / change.var()
        assert found == pytest.approx(expected, abs=0.05)


def test_spots_cover_their_area():
    # A soft spot of radius r and mean strength 3/4 has the volume 3/4 pi r^2 times Gamma(3/2).
    table = SkinTable(spots=0.5, spots_per_cm2=30, spot_mm=(0.4, 0.4))
    change = skin_tile(table, "spots", 0.1).change.astype(float)
    found = (change - change.min()).mean() / 0.5
    assert found == pytest.approx(0.75 * 0.886 * np.pi * 0.2**2 * 0.3, rel=0.15)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"fruit": {"grain_mm": 0.01}}, "fruit.grain_mm"),
        ({"fruit": {"spots": 2.0}}, "fruit.spots"),
        ({"leaf": {"speck_mm": [0.5, 0.2]}}, "must be [least, greatest]"),
        ({"stem": {"speckle": float("nan")}}, "stem.speckle"),
        ({"petal": {}}, "petal"),
    ],
)
def test_invalid_files_give_one_sentence(tmp_path, values, problem):
    path = tmp_path / "skin.toml"
    path.write_text(tomli_w.dumps({"name": "own", **values}))
    with pytest.raises(InputError) as error:
        load_skin(path)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unknown_skin_lists_the_shipped_ones():
    with pytest.raises(InputError, match="nor one of the shipped skins: pepper"):
        load_skin("silk")


PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "devices.md").read_text(encoding="utf-8")
SECTION = PAGE.split("\n## Skin\n")[1].split("\n## ")[0]


def test_the_example_of_the_page_loads(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", SECTION, re.DOTALL)
    (tmp_path / "mine.toml").write_text(example, encoding="utf-8")
    assert load_skin(tmp_path / "mine.toml").fruit.spots_per_cm2 == 12


def test_the_page_lists_every_key_and_every_shipped_skin():
    assert set(re.findall(r"^\| `(\w+)`", SECTION, re.MULTILINE)) == set(SkinTable.model_fields)
    (row,) = (row for row in PAGE.splitlines() if "| `skins` |" in row)
    assert set(re.findall(r"`(\w+)`", row.split("|")[3])) == set(SHIPPED)
    for name in SHIPPED:
        assert load_skin(name).licence
        assert load_skin(name).sources
