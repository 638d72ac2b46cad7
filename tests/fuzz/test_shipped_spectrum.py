"""A user's flash with the spectrum of a shipped LED works in a recipe, and its identity."""

from __future__ import annotations

import tomllib

import tomli_w

from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.shipped import shipped_folder

LED = "light/houser2013_cool_white_led"


def flash_file(folder, column):
    shipped = shipped_folder("materials") / "flashes" / "led_matrix_200klx.toml"
    table = tomllib.loads(shipped.read_text(encoding="utf-8"))
    table["spectrum"] = {"file": LED, "column": column}
    path = folder / "flash.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return path


def test_identity_of_a_recipe_whose_flash_uses_a_shipped_spectrum(tmp_path):
    path = flash_file(tmp_path, "slide_4_lumileds_cool_white")
    identity = resolve_recipe("demo", {"camera.flash": str(path)}).recipe.identity()
    assert identity["files"]["flash.spectrum"]["name"] == LED.partition("/")[2]


def test_identity_depends_on_the_file_beside_the_flash_if_there_is_one(tmp_path):
    path = flash_file(tmp_path, "slide_4_lumileds_cool_white")
    before = resolve_recipe("demo", {"camera.flash": str(path)}).recipe.sha256()
    (tmp_path / "light").mkdir()
    text = "wavelength_nm,slide_4_lumileds_cool_white\n400,1\n700,1\n"
    (tmp_path / "light" / "houser2013_cool_white_led.csv").write_text(text, encoding="utf-8")
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table["spectrum"]["file"] += ".csv"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    assert resolve_recipe("demo", {"camera.flash": str(path)}).recipe.sha256() != before
