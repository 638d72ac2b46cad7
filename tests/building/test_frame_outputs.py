"""Images alone are read without a check of the metadata; damaged frames are the same errors as with it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pepperscene.dataset.readers import open_images
from pepperscene.errors import InputError

REFUSED = {
    "empty": b"",
    "truncated": lambda text: text[: len(text) // 2].encode(),
    "latin": lambda text: text.replace("}", ', "note": "\xe9"}', 1).encode("latin-1"),
    "no_index": lambda text: changed(text, index=None),
    "other_index": lambda text: changed(text, index=3),
    "no_outputs": lambda text: changed(text, outputs=None),
    "outputs_list": lambda text: changed(text, outputs=["colour"]),
    "other_digest": lambda text: changed(text, outputs={"colour": {"bytes": 3, "sha256": "a" * 63}}),
}
ACCEPTED = {
    "surrogate": lambda text: text.replace("{", r'{"note": "\ud800",', 1).encode(),
    "nan": lambda text: text.replace("{", '{"note": NaN,', 1).encode(),
    "twice": lambda text: text.replace("{", '{"index": 77,', 1).encode(),
    "utf_16": lambda text: text.encode("utf-16"),
}


def changed(text, **values):
    content = {**json.loads(text), **values}
    return json.dumps({key: value for key, value in content.items() if value is not None}).encode()


def damage(copied, small, content):
    """A copy of the data set whose first frame has another JSON."""
    dataset = copied(small)
    path = dataset.frame_path(0)
    path.write_bytes(content if isinstance(content, bytes) else content(path.read_text()))
    return open_images(dataset.folder)


@pytest.mark.parametrize("case", REFUSED)
def test_damaged_frames_are_the_same_error_with_and_without_metadata(case, copied, small):
    images = damage(copied, small, REFUSED[case])
    messages = []
    for fields in (("colour",), ("colour", "metadata")):
        with pytest.raises(InputError) as caught:
            images.select(*fields)[0]
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert "frames/000000.json" in messages[0]


def test_a_missing_frame_is_the_same_error_with_and_without_metadata(copied, small):
    dataset = copied(small)
    images = open_images(dataset.folder)
    dataset.frame_path(0).unlink()
    for fields in (("colour",), ("colour", "metadata")):
        with pytest.raises(InputError, match=r"000000\.json: cannot be read"):
            images.select(*fields)[0]


@pytest.mark.parametrize("case", ACCEPTED)
def test_what_python_reads_as_json_is_read_without_metadata(case, copied, small):
    images = damage(copied, small, ACCEPTED[case])
    expected = open_images(small.folder)[0]
    for fields in (("colour", "classes"), ("colour", "classes", "metadata")):
        image = images.select(*fields)[0]
        np.testing.assert_array_equal(image.colour, expected.colour)
        np.testing.assert_array_equal(image.classes, expected.classes)


def test_instances_are_checked_only_with_the_metadata(copied, small):
    images = damage(copied, small, lambda text: changed(text, instances="text"))
    assert images.select("classes")[0].classes is not None
    with pytest.raises(InputError, match=r"000000\.json: instances = 'text'"):
        images[0]
