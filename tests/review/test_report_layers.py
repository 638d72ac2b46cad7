"""Overlays and the 3D view of a report in a browser without a network: by mouse and by keys."""

from __future__ import annotations

import base64
import io
import shutil

import numpy as np
import pytest
from chromium import find_chromium
from PIL import Image

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.review.report import write_report
from pepperscene.review.report.colours import instance_colours

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_chromium() is None, reason="there is no Chromium on this machine"),
]

PEPPER = int(OrganClass.PEPPER)
OPACITY = 0.6


@pytest.fixture(scope="module")
def labelled_page(painted, tmp_path_factory):
    folder = shutil.copytree(painted.folder, tmp_path_factory.mktemp("layers") / "set")
    return write_report(folder, limit=3).page


@pytest.fixture(scope="module")
def scene_page(grown, tmp_path_factory):
    folder = shutil.copytree(grown.folder, tmp_path_factory.mktemp("view") / "set")
    return write_report(folder, limit=2, scene=True).page


@pytest.fixture
def browser(started, labelled_page):
    started.open(labelled_page)
    started.wait_until("document.body.dataset.labelled === 'true'")
    yield started
    started.assert_quiet(labelled_page)


@pytest.fixture
def viewer(started, scene_page):
    started.open(scene_page)
    started.wait_until("document.getElementById('scene').dataset.drawn === 'true'")
    started.run("document.querySelector('#scene canvas').scrollIntoView({block: 'center'})")
    yield started
    # Drivers of a software WebGL comment on its speed.
    started.assert_quiet(scene_page, allowed=("rendering",))


def pixels(browser, script):
    """`(h, w, 4)` pixels of an image or canvas, given as an expression."""
    size, values = browser.run(
        f"""(() => {{
          const source = {script}, canvas = document.createElement("canvas");
          canvas.width = source.naturalWidth ?? source.width;
          canvas.height = source.naturalHeight ?? source.height;
          const context = canvas.getContext("2d");
          context.drawImage(source, 0, 0);
          const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
          return [[canvas.height, canvas.width], Array.from(data)];
        }})()"""
    )
    return np.array(values, np.uint8).reshape(*size, 4)


def overlay(browser, card=1):
    """`(h, w, 4)` pixels of the overlay of a card."""
    return pixels(browser, f"document.querySelector('.card:nth-child({card}) .overlay')")


def test_images_of_labels_are_drawn_exactly(browser, painted):
    index = painted.indices()[0]
    drawn = pixels(browser, "document.querySelector('.card img[data-kind=class]')")
    np.testing.assert_array_equal(drawn[..., :3], np.array(CLASS_COLOURS)[painted.image(index, "class")])
    drawn = pixels(browser, "document.querySelector('.card img[data-kind=instance]')")
    np.testing.assert_array_equal(drawn[..., :3], instance_colours(painted.image(index, "instance")))


def test_masks_are_drawn_by_key_and_mouse_one_kind_at_a_time(browser, painted):
    checked = "['class-masks', 'instance-masks'].map(id => document.getElementById(id).checked)"
    assert not overlay(browser).any()
    browser.press("c")
    assert browser.run(checked) == [True, False]
    drawn, classes = overlay(browser), painted.image(painted.indices()[0], "class")
    assert drawn.any()
    # The pixel of the labels in which the centre of each drawn pixel is.
    rows, columns = (
        ((np.arange(drawn_size) + 0.5) * size / drawn_size).astype(int)
        for drawn_size, size in zip(drawn.shape, classes.shape, strict=False)
    )
    organ = classes[np.ix_(rows, columns)]
    for number in np.unique(organ):
        colour, seen = np.array(CLASS_COLOURS[number]), drawn[organ == number]
        opacity = 0 if number == OrganClass.BACKGROUND else round(255 * OPACITY)
        agree = np.abs(seen[:, 3].astype(int) - opacity) <= 1
        if opacity:
            agree &= (np.abs(seen[:, :3].astype(int) - colour) <= 3).all(axis=1)
        # The browser may choose the neighbour at the edge between two pixels of the labels.
        assert agree.mean() > 0.97
    browser.click("#instance-masks")
    assert browser.run(checked) == [False, True]
    assert (overlay(browser) != drawn).any()
    browser.press("i")
    assert not overlay(browser).any()


def test_classes_are_switched_by_key_mouse_and_button(browser):
    browser.press("c")
    complete = overlay(browser)
    browser.press(str(PEPPER))
    yellow = (complete[..., 0] > 240) & (complete[..., 1] > 240) & (complete[..., 2] < 90)
    assert yellow.any()
    assert not overlay(browser)[yellow].any()
    browser.click(f"#overlays input[value='{PEPPER}']")
    np.testing.assert_array_equal(overlay(browser), complete)
    # Of the classes only the background is off: the button switches it on, then all off.
    browser.click("#all-classes")
    assert overlay(browser)[..., 3].all()
    browser.press("a")
    assert not overlay(browser).any()


def test_boxes_and_keypoints_are_drawn(browser):
    for key in ("b", "k"):
        browser.press(key)
        assert overlay(browser)[..., 3].mean() > 1
        browser.press(key)
        assert not overlay(browser).any()


def test_overlays_are_drawn_in_the_enlarged_image_too(browser, painted):
    large = "document.querySelector('dialog .overlay')"
    browser.press("c")
    browser.click(".card .picture")
    assert pixels(browser, large).any()
    assert browser.run("document.querySelector('dialog #overlays') !== null")
    browser.press("c")
    assert not pixels(browser, large).any()
    browser.click("dialog #boxes")
    assert browser.run("document.querySelector('dialog').open")
    assert pixels(browser, large).any()
    # Other images have no overlay.
    browser.press("ArrowRight")
    assert browser.run(f"{large}.hidden")
    # The caption names what is below the pointer.
    instance = painted.image(painted.indices()[0], "instance")
    height, width = instance.shape
    row, column = height // 2, width // 2
    left, top, shown = browser.run(
        "(box => [box.left, box.top, box.width])(document.querySelector('.stage').getBoundingClientRect())"
    )
    scale = shown / width
    browser.move(left + (column + 0.5) * scale, top + (row + 0.5) * scale)
    number, organ = instance[row, column], painted.image(painted.indices()[0], "class")[row, column]
    expected = OrganClass(organ).name.lower() + (f", instance {number}" if number else "")
    assert browser.run("document.querySelector('dialog p').textContent").endswith(f": {expected}")
    browser.press("Escape")
    browser.wait_until("document.querySelector('#overlay-home #overlays') !== null")
    assert overlay(browser).any()


STATUS = "document.querySelector('#scene .status').textContent"
FRAME = "document.querySelector('#scene canvas').dataset.frame"


def area(viewer):
    """Left, top, width and height of the 3D view in the window."""
    box = "document.querySelector('#scene canvas').getBoundingClientRect()"
    return viewer.run(f"(box => [box.left, box.top, box.width, box.height])({box})")


def picture(viewer):
    """`(h, w, 3)` of the 3D view."""
    viewer.run("new Promise(next => requestAnimationFrame(() => requestAnimationFrame(next)))")
    left, top, width, height = area(viewer)
    top += viewer.run("scrollY")
    clip = {"x": left + 20, "y": top + 20, "width": width - 40, "height": height - 40, "scale": 1}
    data = viewer.call("Page.captureScreenshot", format="png", clip=clip)["data"]
    with Image.open(io.BytesIO(base64.b64decode(data)), formats=["PNG"]) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_view_shows_plants_in_the_colours_of_their_classes(viewer):
    def blue_pixels():
        red, green, blue = np.moveaxis(picture(viewer), -1, 0)
        return int(np.count_nonzero((blue > 90) & (red < 30) & (green < 80)))

    leaves = blue_pixels()
    assert leaves > 500
    viewer.click(f"#scene input[value='{int(OrganClass.LEAF)}']")
    assert blue_pixels() < leaves / 20


def test_mouse_rotates_and_zooms_the_view(viewer):
    left, top, width, height = area(viewer)
    middle = (left + width / 2, top + height / 2)
    first = picture(viewer)
    viewer.drag(middle, (middle[0] + 150, middle[1] + 40))
    rotated = picture(viewer)
    assert (rotated != first).any()
    wheel = {"x": middle[0], "y": middle[1], "deltaX": 0, "deltaY": -100}
    viewer.run("document.activeElement.blur()")
    start = viewer.run("scrollY")
    viewer.call("Input.dispatchMouseEvent", type="mouseWheel", **wheel)
    # Without the focus, the wheel scrolls the page.
    viewer.wait_until(f"scrollY < {start}")
    viewer.run("document.querySelector('#scene canvas').focus({preventScroll: true})")
    scrolled = viewer.run("scrollY")
    viewer.call("Input.dispatchMouseEvent", type="mouseWheel", **wheel)
    assert viewer.run("scrollY") == scrolled
    assert (picture(viewer) != rotated).any()
    viewer.click("#scene [data-action=reset]")
    viewer.run("document.querySelector('#scene canvas').scrollIntoView({block: 'center'})")
    np.testing.assert_array_equal(picture(viewer), first)


def test_pointing_at_a_camera_names_its_frame(viewer):
    # Cameras are white lines and grey points; each cell that has one is pointed at.
    left, top, *_ = area(viewer)
    drawn = picture(viewer)
    rows, columns = np.nonzero((drawn.min(axis=-1) > 90) & (np.ptp(drawn, axis=-1) < 40))
    found = {}
    for row, column in np.unique(np.column_stack([rows, columns]) // 12, axis=0) * 12 + 6:
        viewer.move(left + 20 + float(column), top + 20 + float(row))
        found.setdefault(viewer.run(FRAME), viewer.run(STATUS))
        if len(found) > 3:
            break
    assert {"0", "1", "2"} <= found.keys()
    assert all(found[str(number)].startswith(f"Frame 00000{number}, camera at (") for number in range(3))


def test_keys_rotate_move_and_zoom_the_view(viewer):
    viewer.run("document.querySelector('#scene canvas').focus({preventScroll: true})")
    first = picture(viewer)
    for key in ("ArrowLeft", "ArrowUp", "+"):
        before = picture(viewer)
        viewer.press(key)
        assert (picture(viewer) != before).any()
    viewer.press("Home")
    np.testing.assert_array_equal(picture(viewer), first)


def test_keys_select_cameras_and_shown_ones_are_links(viewer):
    viewer.click("#scene canvas")
    frames = []
    for key in ("n", "n", "n", "n", "p"):
        viewer.press(key)
        frames.append(viewer.run(FRAME))
    assert frames == ["0", "1", "2", "0", "2"]
    viewer.press("n")
    assert viewer.run(STATUS).startswith("Frame 000000, camera at (")
    viewer.click("#scene .status a")
    viewer.wait_until("location.hash === '#a-000000'")
    assert viewer.run("document.querySelector(location.hash) !== null")
