"""A user's flash with the spectrum of a shipped LED works in a recipe, and its identity."""

from __future__ import annotations

import tomllib

import tomli_w

from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.shipped import shipped_folder

LED = "light/houser2013_cool_white_led"


def test_identity_depends_on_the_file_of_a_flash_beside_it_if_there_is_one(tmp_path):
    shipped = shipped_folder("materials") / "flashes" / "led_matrix_200klx.toml"
    table = tomllib.loads(shipped.read_text(encoding="utf-8"))
    path = tmp_path / "flash.toml"

    def recipe_with(file):
        table["spectrum"] = {"file": file, "column": "slide_4_lumileds_cool_white"}
        path.write_text(tomli_w.dumps(table), encoding="utf-8")
        return resolve_recipe("demo", {"camera.flash": str(path)}).recipe

    with_shipped = recipe_with(LED)
    before = with_shipped.sha256()
    assert with_shipped.identity()["files"]["flash.spectrum"]["name"] == LED.partition("/")[2]
    (tmp_path / "light").mkdir()
    text = "wavelength_nm,slide_4_lumileds_cool_white\n400,1\n700,1\n"
    (tmp_path / f"{LED}.csv").write_text(text, encoding="utf-8")
    assert recipe_with(f"{LED}.csv").sha256() != before
