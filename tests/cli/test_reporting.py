"""`pepperscene report`, with and without a second set."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image

from pepperscene.errors import EXIT_BAD_INPUT


@pytest.fixture(scope="module")
def built(command, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reporting") / "set"
    one_plant = ("--set", "row={plants_front=1, plants_back=0}")
    done = command("build", "--out", folder, "--frames", "0:3", "--outputs", "class,distance", *one_plant)
    assert done.exit_code == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two photographs with masks, without a table of labels."""
    folder = tmp_path_factory.mktemp("photographs")
    for number in (1, 2):
        Image.fromarray(np.full((20, 30, 3), 90 * number, np.uint8)).save(folder / f"img{number}.png")
        mask = np.zeros((20, 30), np.uint8)
        mask[5:10] = 3
        Image.fromarray(mask).save(folder / f"mask{number}.png")
    return folder


def test_report_prints_what_it_shows_and_measures(command, built):
    done = command("report", built, "--limit", 1, "--sample", 2)
    assert done.exit_code == 0, done.stderr
    assert "1 of 3 frames shown, 2 measured" in done.stdout
    assert done.stdout.splitlines()[1:] == [f"  {built / 'contact_sheet.png'}", f"  {built / 'index.html'}"]


def test_report_compares_with_a_folder_of_photographs(command, built, photographs):
    done = command("report", built, "--beside", photographs, "--labels", "montoya2021")
    assert done.exit_code == 0, done.stderr
    text = (built / "index.html").read_text(encoding="utf-8")
    assert re.search(rf"{photographs.name}</span>, 2 images", text)
    # A quarter of them is labelled, as peduncle.
    assert "25.00\u00a0%" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--labels", "montoya2021"), "--labels: applies only with --beside"),
        (("--half", "empirical"), "--half: applies only with --beside"),
        (("--beside", "nowhere"), "nowhere"),
    ],
)
def test_rejects_options_that_do_not_apply(command, built, options, message):
    done = command("report", built, *options)
    assert done.exit_code == EXIT_BAD_INPUT
    assert message in done.stderr


def test_rejects_masks_without_labels(command, built, photographs):
    done = command("report", built, "--beside", photographs)
    assert done.exit_code == EXIT_BAD_INPUT
    assert "mask1.png" in done.stderr
