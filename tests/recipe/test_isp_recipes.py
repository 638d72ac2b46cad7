"""Image signal processors of recipes: presets, files, variation, and one sentence for what is not valid."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import load_processor
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe
from pepperscene.shipped import shipped_folder
from pepperscene.tuning.target import TuningTarget

HEAD = 'extends = "barth2018"\nname = "processed"\n'
CURVE = "light,code\n0,0\n0.25,0.5\n1,1\n"


def resolved(folder, text, head=HEAD):
    (folder / "processed.toml").write_text(head + text, encoding="utf-8")
    return resolve_recipe(folder / "processed.toml")


def processor(folder, text, head=HEAD):
    return resolved(folder, f"[developing.isp]\n{text}", head).camera.developing.isp


def test_shipped_presets_have_a_source_for_each_number():
    files = sorted((shipped_folder("materials") / "isps").glob("*.toml"))
    assert [file.stem for file in files] == ["machine_vision", "realsense_colour", "telephone", "webcam"]
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert "[sources]" in text
        assert 'licence = "MIT"' in text
        assert load_processor(file.stem) == load_processor(file)


def test_values_of_the_recipe_replace_those_of_the_preset(tmp_path):
    isp, preset = processor(tmp_path, 'preset = "webcam"\nsharpening = 0\n'), load_processor("webcam")
    assert isp.sharpening == 0.0
    assert isp.saturation == preset.saturation
    assert isp.preset == "webcam"
    assert isp.shading_cast == preset.shading_cast


def test_recipe_without_the_table_is_as_before(tmp_path):
    recipe = resolved(tmp_path, "")
    assert recipe.camera.developing.isp is None
    assert "isp" not in recipe.camera.developing.to_metadata()
    assert "isp" not in json.dumps(recipe.identity["recipe"])


def test_none_leaves_out_the_processor_of_the_recipe_that_is_extended(tmp_path):
    base, own = (
        resolved(tmp_path, text, 'extends = "randomised"\nname = "own"\n')
        for text in ("", '[developing]\nisp = "none"\n')
    )
    for index in (0, 3):
        first, second = (FrameSetups(one).at(one.recipe.plan.frame(index)).camera for one in (base, own))
        assert first.developing.isp is not None
        # Nothing else differs: no number is drawn twice.
        assert second.developing == replace(first.developing, isp=None)
        assert second.sensor.name == first.sensor.name
    with pytest.raises(InputError, match='must be a table, or "none"'):
        resolved(tmp_path, '[developing]\nisp = "nono"\n')


def test_preset_and_tone_curve_of_a_user_are_relative_to_their_file(tmp_path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mine.toml").write_text('name = "Mine"\nsharpening = 0.4\ntone_curve = "curve.csv"\n')
    for folder in (tmp_path, tmp_path / "own"):
        (folder / "curve.csv").write_text(CURVE)
    by_preset = processor(tmp_path, 'preset = "own/mine.toml"\n')
    by_key = processor(tmp_path, 'tone_curve = "curve.csv"\n')
    assert by_preset.tone_curve == by_key.tone_curve == ((0.0, 0.0), (0.25, 0.5), (1.0, 1.0))
    assert by_preset.sharpening == 0.4
    assert by_preset.preset == "mine"
    assert processor(tmp_path, "tone_curve = [[0, 0], [0.25, 0.5], [1, 1]]\n") == by_key


def test_identity_has_presets_and_curves_by_their_content(tmp_path):
    (tmp_path / "curve.csv").write_text(CURVE)
    text = '[developing.isp]\npreset = { webcam = 0.5, telephone = 0.5 }\ntone_curve = "curve.csv"\n'
    first = resolved(tmp_path, text)
    assert {"preset", "preset.telephone", "tone_curve"} <= first.identity["files"].keys()
    before = first.recipe.sha256()
    (tmp_path / "curve.csv").write_text(CURVE.replace("0.5", "0.6"))
    assert resolved(tmp_path, text).recipe.sha256() != before


def test_numbers_names_and_elements_of_lists_vary_by_frame(tmp_path):
    text = """
        preset = { webcam = 0.5, telephone = 0.5 }
        sharpening = { uniform = [0.2, 2.0] }
        shading_cast = [{ low = -0.1, high = 0.1 }, 0.02]
        jpeg_quality = { low = 60, high = 95 }
        tone_curve = { in_turn = ["srgb", "filmic"] }
        local_contrast = { mean = 0.3, sd = 0.1, low = 0, high = 0.6 }
    """
    recipe = resolved(tmp_path, f"[developing.isp]\n{text}")
    assert {varied.name.removeprefix("developing.isp.") for varied in recipe.recipe.variation} == {
        "preset", "sharpening", "shading_cast.0", "jpeg_quality", "tone_curve", "local_contrast"
    }  # fmt: skip
    setups = FrameSetups(recipe)
    frames = [setups.at(recipe.recipe.plan.frame(index)) for index in range(40)]
    isps = [frame.camera.developing.isp for frame in frames]
    assert {isp.preset for isp in isps} == {"webcam", "telephone"}
    assert [isp.tone_curve for isp in isps[:2]] == ["srgb", "filmic"]
    sharpening = np.array([isp.sharpening for isp in isps])
    assert 0.2 <= sharpening.min() < 0.7 < 1.5 < sharpening.max() <= 2.0
    assert {isp.shading_cast[1] for isp in isps} == {0.02}
    assert len({isp.shading_cast[0] for isp in isps}) == 40
    assert all(isinstance(isp.jpeg_quality, int) and 60 <= isp.jpeg_quality <= 95 for isp in isps)
    # Values that do not vary are those of the frame's own preset.
    assert {isp.saturation for isp in isps if isp.preset == "webcam"} == {load_processor("webcam").saturation}
    assert frames[3].drawn["developing.isp.sharpening"] == sharpening[3]
    assert (
        json.loads(json.dumps(frames[3].camera.developing.to_metadata()))["isp"]["preset"]
        in "webcam telephone"
    )


def test_twins_can_differ_in_a_step(tmp_path):
    text = '[twins]\n"developing.isp.sharpening" = [0.0, 1.0]\n[developing.isp]\nsharpening = 0\n'
    recipe = resolved(tmp_path, text)
    setups, plan = FrameSetups(recipe), recipe.recipe.plan
    seen = set()
    for index in range(0, 3000, 125):
        spec = plan.frame(index)
        seen.add(spec.twin)
        assert setups.at(spec).camera.developing.isp.sharpening == float(spec.twin)
    assert seen == {0, 1}


@pytest.mark.parametrize(
    ("text", "key", "problem"),
    [
        ('preset = "polaroid"', "developing.isp.preset", "shipped isps: machine_vision"),
        ("sharpening = 20", "developing.isp.sharpening", "less than or equal to 10"),
        ("sharpness = 1", "developing.isp.sharpness", "not a known key"),
        ("saturation = true", "developing.isp.saturation", "valid number"),
        ("shading_cast = [0.1, 0.1, 0.1]", "developing.isp.shading_cast", "at most 2"),
        ('jpeg_subsampling = "4:1:1"', "developing.isp.jpeg_subsampling", "4:2:2"),
        ("jpeg_quality = 101", "developing.isp.jpeg_quality", "less than or equal to 100"),
        ('tone_curve = "log"', "developing.isp.tone_curve", "srgb, linear, gamma, filmic"),
        ("tone_curve = 3", "developing.isp.tone_curve", "srgb, linear, gamma, filmic"),
        ("tone_curve = [[0, 1], [1, 0]]", "developing.isp", "must rise with light"),
        ('tone_curve = "missing.csv"', "", "missing.csv"),
        ("sharpening = { uniform = [1, 20] }", "developing.isp.sharpening", "less than or equal to 10"),
        ("contrast = { mean = 1 }", "developing.isp.contrast", "mean"),
    ],
)  # fmt: skip
def test_invalid_values_are_one_sentence(tmp_path, text, key, problem):
    with pytest.raises(InputError) as caught:
        processor(tmp_path, text)
    message = str(caught.value)
    assert key in caught.value.key
    # Long paths are shortened in messages.
    assert problem in f"{message} {caught.value.value}"
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("light,code\n0,0\n0.5,0.8\n1,0.7\n", "must rise with light"),
        ("light,red\n0,0\n1,1\n", "must be light,code"),
        ("dark,code\n0,0\n1,1\n", "must be named light"),
        ("light,code\n0,0\n1,2\n", "must be 0 to 1"),
        ("light,code\n0,x\n1,1\n", "row 2, column code"),
    ],
)
def test_invalid_tone_curve_files_are_one_sentence(tmp_path, content, problem):
    (tmp_path / "curve.csv").write_text(content)
    with pytest.raises(InputError, match=problem) as caught:
        processor(tmp_path, 'tone_curve = "curve.csv"')
    assert "curve.csv" in f"{caught.value.where} {caught.value.value}"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ('name = "x"\npreset = "webcam"\n', "preset.*is not a known key"),
        ('name = "x"\nsharp = 1\n', "sharp.*is not a known key"),
        ("sharpening = 1\n", "name.*required"),
        ('name = "x"\nsharpening = 1\n[sources]\ngamma = "chosen"\n', "sources"),
    ],
)
def test_invalid_presets_are_one_sentence(tmp_path, content, problem):
    (tmp_path / "mine.toml").write_text(content)
    with pytest.raises(InputError, match=problem) as caught:
        processor(tmp_path, 'preset = "mine.toml"')
    assert "mine.toml" in f"{caught.value.where} {caught.value.value}"


def test_sensors_with_bands_have_no_image_to_process(tmp_path):
    with pytest.raises(InputError, match="has bands, and so no colour image") as caught:
        processor(tmp_path, 'preset = "webcam"', 'extends = "multispectral"\nname = "x"\n')
    assert caught.value.key == "developing.isp"


def test_imagers_of_a_depth_camera_are_not_processed():
    recipe = resolve_recipe("realsense_depth", {"developing.isp.preset": "realsense_colour"})
    assert recipe.depth_camera.left.developing.isp is None
    assert recipe.camera.developing.isp is not None


def test_tuning_needs_linear_light():
    recipe = load_recipe("barth2018", {"developing.isp.preset": "webcam"})
    with pytest.raises(InputError, match="tuned to linear light") as caught:
        TuningTarget(recipe, None)
    assert caught.value.key == "developing.isp"
