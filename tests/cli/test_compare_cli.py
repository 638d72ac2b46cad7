"""`pepperscene compare`: tables, JSON, figure, options and errors."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """Both halves of the published data set, two pictures each."""
    folder = tmp_path_factory.mktemp("compare") / "published"
    classes = np.full((24, 32), 2, np.uint8)
    classes[:12] = 1
    for half, green in (("synthetic", 150), ("empirical", 110)):
        images, labels = folder / f"{half}_image_color", folder / f"{half}_label_class_colorscale"
        images.mkdir(parents=True)
        labels.mkdir()
        for number in (1, 2):
            colour = np.full((24, 32, 3), (80, green, 30), np.uint8)
            Image.fromarray(colour).save(images / f"{images.name}_{number}.png")
            Image.fromarray(np.array(CLASS_COLOURS, np.uint8)[classes]).save(
                labels / f"{labels.name}_{number}.png"
            )
    return folder


def test_prints_plain_tables_without_a_terminal(command, without_table, tmp_path):
    result = command("compare", without_table, without_table, "--labels", "montoya2021")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert any(line.startswith("pepper ") and "1.00" in line for line in lines)
    for figure in (10, 11, 12, 13):
        assert f"Fig. {figure}" in result.stdout
    assert not any(line.endswith(" ") for line in lines)
    # Photographs without masks give a short output.
    for number in range(3):
        image = np.random.default_rng(number).integers(0, 255, (45, 60, 3), np.uint8)
        Image.fromarray(image).save(tmp_path / f"img{number}.png")
    lines = command("compare", tmp_path, tmp_path).stdout.splitlines()
    assert sum("no masks" in line for line in lines) == 1
    assert len(lines) < 30
    assert not any(re.search(r" -( |$)", line) for line in lines)


def test_json_option_prints_json_only_and_reproducibly(command, without_table, with_table, tmp_path):
    figure = tmp_path / "deep" / "figure.svg"
    options = ("--labels", "montoya2021", "--json", "--figure", figure)
    result = command("compare", without_table, with_table, *options)
    assert result.exit_code == 0, result.stderr
    content = json.loads(result.stdout)
    assert content["format"] == "pepperscene compare 1"
    sizes = [{"width": 32, "height": 24, "centre": 12, "texture_width": None}]
    assert content["one"] == {"name": "plain", "measured": 2, "of": 2, "sizes": sizes}
    pepper = content["kinds"]["pepper"]
    assert pepper["delta_e_2000"]["value"] > 5
    assert pepper["hue_emd_deg"]["low"] <= pepper["hue_emd_deg"]["value"] <= pepper["hue_emd_deg"]["high"]
    assert pepper["one"]["share"]["value"] == pepper["other"]["share"]["value"] == 0.375
    # 0 is background in the table of labels, and unlabelled in montoya2021.
    background = content["kinds"]["background"]["one"]["share"]
    assert background["value"] is None
    assert background["why"] == "not labelled in plain"
    assert content["kinds"]["background"]["other"]["share"]["value"] == 0.625
    assert str(figure) in result.stderr
    ElementTree.parse(figure)
    before = figure.read_bytes()
    assert command("compare", without_table, with_table, *options).stdout == result.stdout
    assert figure.read_bytes() == before


def test_labels_apply_to_each_set_by_position(command, without_table, with_table):
    result = command("compare", with_table, without_table, "--labels", ",montoya2021", "--json")
    assert result.exit_code == 0, result.stderr
    limited = json.loads(
        command(
            "compare", with_table, without_table, "--labels", ",montoya2021", "--limit", 1, "--json"
        ).stdout
    )
    assert (limited["other"]["measured"], limited["other"]["of"]) == (1, 2)
    # If both have a table, one name overrides both.
    result = command("compare", with_table, with_table, "--labels", "published", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["kinds"]["shoot"]["one"]["share"]["value"] == 0.375


def test_compares_both_halves_of_the_published_set(command, published):
    result = command("compare", published, published, "--half", "synthetic,empirical", "--json")
    assert result.exit_code == 0, result.stderr
    content = json.loads(result.stdout)
    assert content["one"]["name"] != content["other"]["name"]
    assert content["kinds"]["leaf"]["delta_e_2000"]["value"] > 5
    assert content["kinds"]["leaf"]["place_correlation"]["value"] == pytest.approx(1.0)


def test_textures_are_measured_at_the_scale_of_the_options(command, without_table):
    base = ("compare", without_table, without_table, "--labels", "montoya2021", "--json")
    narrow = json.loads(command(*base).stdout)["appearance"]["image"]["one"]
    assert narrow["patch_lightness_sd"]["why"] == "no image is 580 pixels wide"
    result = command(*base, "--width", 32)
    assert result.exit_code == 0, result.stderr
    pixels = json.loads(result.stdout)["appearance"]["image"]["one"]["pixels"]
    assert pixels == narrow["pixels"]
    halved = json.loads(command(*base, "--pixel-mm", "1,2").stdout)["appearance"]["image"]
    assert 4 * halved["one"]["pixels"] == halved["other"]["pixels"] == pixels


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--labels", "unknown"), "must be a table or one of"),
        (
            ("--labels", "montoya2021", "--half", "empirical"),
            "--half: applies only to the published data set",
        ),
        ((), "mask1.png"),
        (("--labels", "montoya2021", "--pixel-mm", "1.2"), "--pixel-mm: must be two numbers such as"),
    ],
)
def test_rejects_invalid_options(rejects, without_table, options, message):
    rejects(message, "compare", without_table, without_table, *options)
