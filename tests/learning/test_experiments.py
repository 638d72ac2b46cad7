"""The experiments: from a recipe and photographs to a page, and again after an interruption."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from commands import rejected, run
from painted_bands import paint_bands, write_bands
from toy_models import parse_page

pytest.importorskip("torch")

from stand_in import SceneStandIn

from pepperscene.building.execution.build import build
from pepperscene.building.scenes.frame_renderer import AssembledScene, FrameRenderer
from pepperscene.frame import Frame
from pepperscene.geometry import rectangle
from pepperscene.learning.experiments import sets
from pepperscene.learning.experiments.jobs import JobRunner
from pepperscene.learning.experiments.page import format_measure
from pepperscene.scene import assemble_scene

RECIPE = """
extends = "barth2018"
name = "shapes"
[plan]
sets = 4
rotations = 1
frames = 5
[row]
plants_front = 1
plants_back = 0
"""
QUICK = (
    "--labels", "published", "--model", "small,width=0.25", "--steps", 3, "--fine-steps", 2, "--batch", 2,
    "--crop", "32x32", "--width", 0, "--precision", "float32", "--frames", 12, "--size", "64x48",
    "--seeds", 1, "--validate", 2,
)  # fmt: skip


class ShapesRenderer(SceneStandIn):
    """Renders shapes that depend on the seed alone."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        (image,) = paint_bands(1, seed, (48, 64))
        images = {"colour": image.colour, "class": image.classes}
        return Frame(
            {name: images[name] for name in outputs}, {"camera": camera.to_metadata(), "instances": {}}
        )


def build_shapes(recipe, folder, frames, outputs, options, on_frame):
    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
        painted = replace(options, renderer=ShapesRenderer)
        return build(recipe, folder, frames, outputs, painted, on_frame)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Folder with a recipe, photographs and the results of the whole run; and what was printed."""
    folder = tmp_path_factory.mktemp("experiments")
    (folder / "shapes.toml").write_text(RECIPE)
    write_bands(folder / "real", 5, seed=9)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(sets, "build", build_shapes)
        result = run(*words_of(folder))
    assert result.exit_code == 0, result.output
    return folder, result


def words_of(folder, out="out"):
    return ("experiments", folder / "shapes.toml", "--real", folder / "real", "--out", folder / out, *QUICK)


@pytest.fixture
def content(finished):
    return json.loads((finished[0] / "out" / "experiments.json").read_bytes())


def test_all_experiments_but_d_have_results(finished, content):
    results = {item["key"]: item for item in content["experiments"]}
    assert list(results) == ["A", "A_merged", "B", "C", "D", "E"]
    assert [results[key]["images"] for key in ("A", "B", "C", "E")] == [3, 5, 5, 5]
    assert len(results["A"]["measures"]) == 9
    for key in ("A_merged", "B", "C", "E"):
        assert [item["name"] for item in results[key]["measures"]] == ["other", "fruit", "peduncle", "mean"]
    assert not results["D"]["ran"]
    pairs = [(item["first"], item["second"]) for item in content["differences"]]
    assert pairs == [("E", "C"), ("B", "C"), ("E", "B")]
    stdout = finished[1].stdout
    assert "D: unrelated, fine-tuned on real: not run, no unrelated set or model was named" in stdout
    assert "seed 1, fold 2, experiment E: step 2 of 2" in finished[1].stderr


def test_parts_share_no_plants_and_test_images_choose_no_state(content):
    (synthetic,) = content["synthetic"]
    assert synthetic["parts"] == {"train": 6, "validation": 3, "test": 3}
    assert "2 sets of plants train, 1 test and 1 validate" in synthetic["split"]
    assert content["real"]["folds"] == [
        {"train": 2, "validation": 0, "test": 3}, {"train": 3, "validation": 0, "test": 2},
    ]  # fmt: skip
    for training in content["trainings"]:
        if training["experiment"] in ("A", "B"):
            best = max(training["log"], key=lambda entry: entry["mean_iou"])
            assert training["validation_mean_iou"] == best["mean_iou"]
        else:
            assert training["used_step"] == training["steps"]
            assert training["validation_mean_iou"] is None


def test_page_has_the_values_of_the_json(finished, content):
    page = (finished[0] / "out" / "experiments.html").read_text()
    root = parse_page(page)
    rows = [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]
    results = {item["key"]: item for item in content["experiments"]}
    for key in ("A_merged", "B", "C", "E"):
        values = [format_measure(measure) for measure in results[key]["measures"]]
        assert any(row[0].startswith(f"{key[0]}: ") and row[2:] == values for row in rows)
    mean = content["differences"][0]["measures"][-1]
    assert f"E above C by {format_measure(mean, signed=True)}" in page
    assert "D was not run: no unrelated set or model was named (--other)" in page
    assert "2 sets of plants train" in page
    alts = [image.get("alt") for image in root.iter("img")]
    charts = [alt for alt in alts if "experiment" in alt]
    assert len(alts) - len(charts) == 3 * 5
    assert charts[0] == "IoU by class and experiment, in percent"
    # Loss of A, B, C and E, and validations of A and B.
    assert len(charts) == 1 + 6


def test_a_finished_run_is_not_repeated(finished, monkeypatch):
    folder = finished[0]
    monkeypatch.setattr(sets, "build", build_shapes)
    monkeypatch.setattr(JobRunner, "_train", None)
    monkeypatch.setattr(JobRunner, "_evaluate", None)
    before = {name: (folder / "out" / name).read_bytes() for name in ("experiments.json", "experiments.html")}
    assert run(*words_of(folder)).exit_code == 0
    assert before == {name: (folder / "out" / name).read_bytes() for name in before}


@pytest.mark.long
def test_an_interrupted_run_goes_on_to_the_same_result(finished, tmp_path, monkeypatch):
    folder = finished[0]
    monkeypatch.setattr(sets, "build", build_shapes)
    words = (*words_of(folder)[:5], tmp_path / "out", *QUICK, "--seeds", 2)
    lines = []

    def stop(text, _is_frequent):
        lines.append(text)
        if "fold 1, experiment E: testing" in text:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pepperscene.cli.learning._message_printer", lambda: stop)
        result = run(*words)
    assert result.exit_code == 130
    assert "run the same command again to resume" in result.stderr
    assert run(*words).exit_code == 0

    # Seed 1 among two seeds has the matrices that it has alone.
    for file in sorted((folder / "out" / "tests").iterdir()):
        assert file.read_bytes() == (tmp_path / "out" / "tests" / file.name).read_bytes()


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("settings.json: is of other experiments: options.fine_steps is 2 there and 3", ("--fine-steps", 3)),
        ("--seeds: must be 1 or more", ("--seeds", 0)),
        ("--crop: must be two numbers of pixels, 32 to 8192", ("--crop", "8x8")),
        ("--size: must be width and height", ("--size", "big")),
        ("--fine-rate: must be above 0", ("--fine-rate", -1)),
        ("--classes: 'nose' is none of", ("--classes", "nose,leaf")),
        ("must be a folder of images", ("--real", "/none")),
        ("must be a folder of images", ("--other", "/none")),
        ("holds no experiments", ("--out", "{folder}")),
    ],
)
def test_wrong_input(finished, message, words):
    words = [str(word).format(folder=finished[0]) for word in words]
    assert message in rejected(*words_of(finished[0]), *words)
