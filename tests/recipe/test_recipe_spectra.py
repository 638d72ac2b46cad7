"""Measured curves in the recipe's changes of a cultivar: paths, identity, notes and errors."""

from __future__ import annotations

import json

import pytest
from own_spectra import NM, write_csv, write_leaf

from pepperscene.building.execution.job import BuildJob
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe
from pepperscene.review.preview.summary import summarise_plan
from pepperscene.tuning.pigment_paths import visible_surfaces

LEAF = {"spectra": {"leaf": {"file": "curves/leaf.csv", "spread": 0.05}}}
NOTE = (
    "leaf: leaf.csv is measured from 400 to 1000 nm; "
    "the cameras see 380 to 720 nm, and its end values hold outside"
)


@pytest.fixture
def curves(tmp_path):
    (tmp_path / "curves").mkdir()
    write_leaf(tmp_path / "curves")
    return tmp_path / "curves"


def test_paths_are_relative_to_the_recipe_or_the_current_folder(curves, write_recipe, monkeypatch):
    recipe = write_recipe(override=LEAF)
    resolved = resolve_recipe(recipe)
    assert resolved.cultivar.spectra["leaf"].file == curves / "leaf.csv"
    # A recipe in another folder that extends it.
    child = curves / "child.toml"
    child.write_text('extends = "../mine.toml"\nname = "child"\n', encoding="utf-8")
    assert resolve_recipe(child).cultivar == resolved.cultivar
    monkeypatch.chdir(curves)
    changed = resolve_recipe("barth2018", {"override.spectra.leaf.file": "leaf.csv"})
    assert changed.cultivar.spectra["leaf"].file == curves / "leaf.csv"


def test_identity_follows_the_content_of_the_file_and_not_its_folder(curves, write_recipe, tmp_path):
    recipe = write_recipe(override=LEAF)
    identity = load_recipe(recipe).identity()
    assert json.loads(json.dumps(identity)) == identity
    assert str(tmp_path) not in json.dumps(identity)
    write_leaf(curves, 0.9)
    changed = load_recipe(recipe).identity()
    assert changed["recipe"] == identity["recipe"]
    differing = {key for key in identity["files"] if identity["files"][key] != changed["files"][key]}
    assert differing == {"override.spectra.leaf.file.0"}
    # A file of a cultivar counts as well.
    (tmp_path / "own.toml").write_text(
        'extends = "kaite"\nname = "own"\n[spectra.leaf]\nfile = "curves/leaf.csv"\n', encoding="utf-8"
    )
    own = write_recipe("other.toml", cultivar="own.toml")
    digests = []
    for factor in (1.0, 0.9):
        write_leaf(curves, factor)
        digests.append(load_recipe(own).sha256())
    assert digests[0] != digests[1]


def test_twins_and_varied_values_can_name_curves(curves, write_recipe):
    write_csv(curves / "pale.csv", "wavelength_nm,reflectance,transmittance", NM, 0 * NM + 0.5, 0 * NM + 0.4)
    pair = ["curves/leaf.csv", "curves/pale.csv"]
    twins = write_recipe(override=LEAF, twins={"override.spectra.leaf.file": pair})
    spectra = {"leaf": {"file": {"in_turn": pair, "per": "set"}}}
    varied = write_recipe("varied.toml", override={"spectra": spectra})
    for recipe in (twins, varied):
        setups = FrameSetups(resolve_recipe(recipe))
        plan = setups.resolved.recipe.plan
        frames = [plan.frame(index) for index in (0, plan.frames, plan.count // plan.sets)]
        files = {setups.at(frame).cultivar.spectra["leaf"].file for frame in frames}
        assert files == {curves / "leaf.csv", curves / "pale.csv"}
        digests = [load_recipe(recipe).sha256()]
        write_leaf(curves, 0.9)
        digests.append(load_recipe(recipe).sha256())
        write_csv(
            curves / "pale.csv", "wavelength_nm,reflectance,transmittance", NM, 0 * NM + 0.4, 0 * NM + 0.5
        )
        digests.append(load_recipe(recipe).sha256())
        assert len(set(digests)) == 3
        write_leaf(curves)
        write_csv(
            curves / "pale.csv", "wavelength_nm,reflectance,transmittance", NM, 0 * NM + 0.5, 0 * NM + 0.4
        )


def test_range_is_noted_in_preview_and_data_set(curves, write_recipe):
    camera = {"sensor": "generic_rgb", "width": 80, "height": 60}
    resolved = resolve_recipe(write_recipe(override=LEAF, camera=camera))
    assert resolved.spectra_notes == (NOTE,)
    assert summarise_plan(resolved, [0]).warnings == (NOTE,)
    assert BuildJob(resolved, "draft", ("class",)).info["measured_spectra"] == [NOTE]
    plain = resolve_recipe("barth2018")
    assert "measured_spectra" not in BuildJob(plain, "draft", ("class",)).info


def test_pigments_of_measured_surfaces_are_not_tuned(curves, write_recipe):
    own, plain = resolve_recipe(write_recipe(override=LEAF)).cultivar, resolve_recipe("barth2018").cultivar
    assert set(visible_surfaces(plain)) - set(visible_surfaces(own)) == {"leaf"}


def test_faults_of_a_curve_are_found_when_the_recipe_is_loaded(curves, write_recipe):
    recipe = write_recipe(override=LEAF)
    write_csv(curves / "leaf.csv", "wavelength_nm,reflectance,transmittance", NM, 0 * NM + 0.6, 0 * NM + 0.5)
    with pytest.raises(
        InputError, match=r"leaf\.csv: row 2, column transmittance = 0\.5: must be at most 0\.4"
    ):
        load_recipe(recipe)
    (curves / "leaf.csv").unlink()
    with pytest.raises(InputError, match=r"leaf\.csv: cannot be read"):
        load_recipe(recipe)
    wrong = write_recipe(override={"spectra": {"leaf": {"file": "leaf.csv", "scatter": 0.1}}})
    with pytest.raises(InputError, match=r"mine\.toml: override\.spectra\.leaf\.scatter: is not a known key"):
        load_recipe(wrong)
