"""`pepperscene compare`: what it prints, what it writes, and what it refuses."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS
from pepperscene.errors import EXIT_BAD_INPUT


def photographs(folder, values, green):
    """Two photographs and the masks of them."""
    folder.mkdir(parents=True)
    for number in (1, 2):
        colour = np.full((24, 32, 3), (90, green, 20 * number), np.uint8)
        Image.fromarray(colour).save(folder / f"img{number}.png")
        mask = np.zeros((24, 32), np.uint8)
        mask[: 6 * number] = values
        Image.fromarray(mask).save(folder / f"mask{number}.png")
    return folder


def explained(folder):
    (folder / "classes.toml").write_text('0 = "background"\n5 = "pepper"\n', encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def silent(tmp_path_factory):
    """Masks that nobody explains; they are meant as those of montoya2021."""
    return photographs(tmp_path_factory.mktemp("compare") / "silent", 1, 140)


@pytest.fixture(scope="module")
def telling(tmp_path_factory):
    """Masks with a table, in which the values mean something else."""
    return explained(photographs(tmp_path_factory.mktemp("compare") / "telling", 5, 60))


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """Both halves of the published layout, two pictures each."""
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


def test_without_a_terminal_it_prints_plain_lines(command, silent):
    done = command("compare", silent, silent, "--labels", "montoya2021")
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert any(line.startswith("pepper ") and "1.00" in line for line in lines)
    for figure in (10, 11, 12, 13):
        assert f"Fig. {figure}" in done.stdout
    assert not any(line.endswith(" ") for line in lines)


def test_on_standard_output_there_is_json_alone(command, silent, telling, tmp_path):
    figure = tmp_path / "deep" / "figure.svg"
    arguments = ("compare", silent, telling, "--labels", "montoya2021", "--json", "--figure", figure)
    done = command(*arguments)
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["format"] == "pepperscene compare 1"
    assert found["one"] == {"name": "silent", "measured": 2, "of": 2}
    pepper = found["kinds"]["pepper"]
    assert pepper["delta_e_2000"]["value"] > 5
    assert pepper["hue_emd_deg"]["low"] <= pepper["hue_emd_deg"]["value"] <= pepper["hue_emd_deg"]["high"]
    assert pepper["one"]["share"]["value"] == pepper["other"]["share"]["value"] == 0.375
    # The masks that explain themselves mean by 0 the background, those of montoya2021 leave it open.
    background = found["kinds"]["background"]["one"]["share"]
    assert background["value"] is None
    assert background["why"] == "not labelled in silent"
    assert found["kinds"]["background"]["other"]["share"]["value"] == 0.625
    assert str(figure) in done.stderr
    ElementTree.parse(figure)
    # The same command gives the same bytes.
    before = figure.read_bytes()
    assert command(*arguments).stdout == done.stdout
    assert figure.read_bytes() == before


def test_labels_are_told_for_each_side_by_its_place(command, silent, telling):
    done = command("compare", telling, silent, "--labels", ",montoya2021", "--json")
    assert done.exit_code == 0, done.stderr
    # Told for both where both explain themselves, it overrides their tables.
    done = command("compare", telling, telling, "--labels", "published", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["kinds"]["shoot"]["one"]["share"]["value"] == 0.375


def test_both_halves_of_the_published_set_are_compared(command, published):
    done = command("compare", published, published, "--half", "synthetic,empirical", "--json")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["one"]["name"] != found["other"]["name"]
    assert found["kinds"]["leaf"]["delta_e_2000"]["value"] > 5
    assert found["kinds"]["leaf"]["place_correlation"]["value"] == pytest.approx(1.0)


def test_of_many_pictures_some_are_measured(command, silent):
    done = command("compare", silent, silent, "--labels", "montoya2021", "--limit", 1, "--json")
    found = json.loads(done.stdout)
    assert found["other"] == {"name": "silent (B)", "measured": 1, "of": 2}
    assert found["kinds"]["pepper"]["delta_e_2000"] == {"value": 0.0, "low": None, "high": None}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--labels", "nobody"), "must be a table or one of"),
        (("--labels", "montoya2021", "--half", "empirical"), "--half: goes only with the published data set"),
        ((), "whose classes nobody tells"),
        (("--labels", "montoya2021", "--figure", "page.png"), "only .svg is written"),
    ],
)
def test_what_does_not_go_is_refused_in_one_sentence(command, silent, options, told):
    done = command("compare", silent, silent, *options)
    assert done.exit_code == EXIT_BAD_INPUT
    assert told in done.stderr
    assert done.stderr.startswith("error: ")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


def test_what_is_not_there_is_refused(command, silent):
    done = command("compare", silent, "nowhere", "--labels", "montoya2021")
    assert done.exit_code == EXIT_BAD_INPUT
    assert "nowhere: must be a folder of images, or a file of patches" in done.stderr
