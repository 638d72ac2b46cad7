"""The page and the JSON file of an evaluation."""

from __future__ import annotations

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image
from toy_models import ORGANS, ReadsRed, image_set, parse_page, random_masks

from pepperscene.classes import IGNORE_COLOUR
from pepperscene.errors import InputError, OutputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate
from pepperscene.learning.evaluation.page import write_evaluation
from pepperscene.learning.pages import ranked_examples


def picture(source):
    kind, content = re.fullmatch(r"data:image/(png|jpeg);base64,([A-Za-z0-9+/=]+)", source).groups()
    image = Image.open(io.BytesIO(base64.b64decode(content)))
    assert image.format.lower() == kind
    return np.array(image.convert("RGB"))


def graded_set():
    """Five images, of which a model that confuses pepper and peduncle gets ever fewer pixels right."""
    masks = []
    for number in (3, 0, 4, 1, 2):
        mask = np.zeros((20, 30), np.uint8)
        mask[: 3 * number], mask[-4:] = 2, 3
        masks.append(mask)
    return image_set(*masks, name="graded <b>")


MODEL = ReadsRed(changes={2: 3})


def test_page_is_one_valid_file_with_tables_and_three_images(tmp_path):
    images = graded_set()
    evaluation = evaluate(MODEL, images)
    files = write_evaluation(evaluation, MODEL, images, tmp_path / "new" / "out")
    assert json.loads(files.data.read_bytes()) == evaluation.to_json()
    page = files.page.read_text(encoding="utf-8")
    root = parse_page(page)
    sources = [image.get("src") for image in root.iter("img")]
    # Names of sets are text, not elements.
    assert "graded &lt;b&gt;" in page
    assert [len(list(root.iter(name))) for name in ("b", "table", "img")] == [0, 3, 9]
    assert all(image.get("alt") for image in root.iter("img"))
    # Nothing but the embedded pictures is loaded.
    assert not re.search(r"(?:href|src)=\"(?!data:)", page)
    assert "http" not in re.sub(r"http-equiv", "", page)
    # Best, median and worst, with mask and prediction in the colours of the classes.
    headings = re.findall(r"<h3>(\w+): (\w+) of", page)
    assert headings == [("Best", "image1"), ("Median", "image4"), ("Worst", "image2")]
    colours = ORGANS.colours
    median = images[4].classes
    np.testing.assert_array_equal(picture(sources[4]), colours[median])
    np.testing.assert_array_equal(picture(sources[5]), colours[np.where(median == 2, 3, median)])


def test_ignored_pixels_are_grey_and_in_the_legend(tmp_path):
    images = image_set(*random_masks(1))
    table = ClassTable.parse(FRUIT_CLASSES)
    page = write_evaluation(evaluate(ReadsRed(), images, classes=table), ReadsRed(), images, tmp_path).page
    text = page.read_text(encoding="utf-8")
    sources = [image.get("src") for image in parse_page(text).iter("img")]
    mask = picture(sources[1])
    np.testing.assert_array_equal((mask == IGNORE_COLOUR).all(axis=-1), images[0].classes == 255)
    assert "no label" in text
    # One image is the best and the worst.
    assert len(sources) == 3


def test_examples_are_the_best_the_median_and_the_worst_image():
    for values, chosen in (
        ([], []),
        ([0.5], [("best", 0)]),
        ([0.2, np.nan, 0.5], [("best", 2), ("worst", 0)]),
        ([0.4, 0.5, 0.1, 0.3], [("best", 1), ("median", 3), ("worst", 2)]),
    ):
        assert ranked_examples(np.array(values)) == chosen


def test_writes_both_files_or_none(tmp_path):
    images = graded_set()
    evaluation = evaluate(MODEL, images)
    (tmp_path / "evaluation.html").mkdir()
    with pytest.raises(OutputError, match=r"evaluation.html: is a folder"):
        write_evaluation(evaluation, MODEL, images, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["evaluation.html"]
    with pytest.raises(InputError, match="must be the evaluated ones: graded"):
        write_evaluation(evaluation, MODEL, image_set(*random_masks(5)), tmp_path / "other")
    assert not (tmp_path / "other").exists()
