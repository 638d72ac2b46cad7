"""The report in a browser without a network: by mouse, by keys, and on a phone."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from chromium import find_chromium
from data_sets import RandomImages, set_without_plants
from hostile_set import FILE_NAME, TEXT, make_hostile, make_photographs, make_plain_set
from stand_in import PYTHONPATH, SceneStandIn

from pepperscene.classes import OrganClass
from pepperscene.frame import Frame
from pepperscene.review.report import write_report

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_chromium() is None, reason="there is no Chromium on this machine"),
]

SIZE = (120, 160)
FRAME_COUNT = 40
SHOWN = 3
PANELS = ("colour", "class", "instance", "distance")


class BandRenderer(SceneStandIn):
    """Renders bands of classes, each in its own colour, brightest in the centre."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        images = band_images(round(camera.pose[2, 3] * 100))
        sampling = {"error_codes": 1 + seed % 50 / 50, "noise_codes": 9.0, "samples_per_pixel": 8.0}
        metadata = {"camera": camera.to_metadata(), "instances": {}, "sampling": sampling}
        return Frame({name: images[name] for name in outputs}, metadata)


def band_images(shift):
    height, width = SIZE
    rows, columns = np.mgrid[:height, :width]
    classes = ((rows // 15 + shift) % len(OrganClass)).astype(np.uint8)
    light = np.exp(-((rows / height - 0.5) ** 2 + (columns / width - 0.5) ** 2) * 4)
    palette = np.array(
        [[90, 80, 140], [60, 160, 40], [220, 190, 20], [90, 150, 30], [120, 160, 60], [100, 150, 50],
         [200, 200, 190], [160, 130, 60]]
    )  # fmt: skip
    return {
        "colour": (palette[classes] * light[..., None]).astype(np.uint8),
        "class": classes,
        "instance": (classes.astype(np.uint16) * 7 + columns.astype(np.uint16) // 40),
        "distance": (0.3 + rows / height).astype(np.float32),
    }


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "set with a long name_that_cannot_be_broken_anywhere"
    changes = {"name": "striped", "plan.sets": 1, "plan.rotations": 1, "plan.frames": 100}
    set_without_plants(folder, range(FRAME_COUNT), PANELS, BandRenderer, changes)
    return write_report(folder, SHOWN, RandomImages(name="photographs", items=(0, 1))).page


@pytest.fixture
def browser(started, page):
    """A browser with the page, which must make no requests, errors or log entries."""
    started.open(page)
    started.wait_until("document.body.dataset.labelled === 'true'")
    yield started
    started.assert_quiet(page)


def dialog(browser):
    """Content, width and visibility of the enlarged image; None if it is closed."""
    return browser.run(
        """(() => {
          const dialog = document.querySelector("dialog"), image = dialog.querySelector("img");
          if (!dialog.open) return null;
          const box = image.getBoundingClientRect();
          return {alt: image.alt, caption: dialog.querySelector("p").textContent, width: image.naturalWidth,
            shown: box.width, within: box.left >= 0 && box.top >= 0 && box.right <= innerWidth
              && box.bottom <= innerHeight};
        })()"""
    )


def test_page_opens_with_all_images(browser):
    widths = browser.run(
        "Promise.all([...document.querySelectorAll('main img')]"
        ".map(image => image.decode().then(() => image.naturalWidth)))"
    )
    frames = [SIZE[1]] * (SHOWN * len(PANELS))
    # Frames, photographs with their masks, maps of eight classes and of one, both mean intensities.
    assert sorted(widths) == sorted([*frames, *[40] * 4, *[SIZE[1]] * 8, 40, SIZE[1], 40])
    assert browser.run("document.title").startswith("striped")


def test_click_enlarges_the_image(browser):
    assert dialog(browser) is None
    browser.click(".card:nth-child(2) .picture")
    enlarged = dialog(browser)
    assert enlarged["alt"] == enlarged["caption"] == "Colour of frame 000020"
    assert enlarged["width"] == SIZE[1]
    assert enlarged["shown"] > 900
    assert enlarged["within"]
    browser.click("dialog img")
    assert dialog(browser) is None


def test_arrow_keys_browse_and_escape_closes(browser):
    browser.click(".card .picture")
    shown = []
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "ArrowDown", "ArrowDown", "ArrowUp", "ArrowLeft"):
        browser.press(key)
        shown.append(dialog(browser)["alt"])
    assert shown == [
        "Class of frame 000000", "Organ instance of frame 000000", "Class of frame 000000",
        "Class of frame 000020", "Class of frame 000039", "Class of frame 000020", "Colour of frame 000020",
    ]  # fmt: skip
    browser.press("Escape")
    assert dialog(browser) is None
    # The focus is on the last image shown.
    browser.wait_until("document.activeElement.querySelector('img')?.alt == 'Colour of frame 000020'")
    browser.press("Enter")
    assert dialog(browser)["alt"] == "Colour of frame 000020"
    browser.click("dialog .after")
    assert dialog(browser)["alt"] == "Class of frame 000020"
    browser.click("dialog .close")
    assert dialog(browser) is None
    # Browsing wraps around.
    browser.click(".card .picture")
    for key, alt in (
        ("ArrowLeft", "Mean intensity of photographs"),
        ("ArrowRight", "Colour of frame 000000"),
    ):
        browser.press(key)
        assert dialog(browser)["alt"] == alt


def test_switch_brightens_photographs_but_not_labels(browser):
    script = "['colour', 'class'].map(n => getComputedStyle(document.querySelector('img.' + n)).filter)"
    assert browser.run(script) == ["none", "none"]
    browser.click("#bright")
    assert browser.run(script) == ["brightness(2.2)", "none"]
    browser.click(".card .picture")
    assert browser.run("getComputedStyle(document.querySelector('dialog img')).filter") == "brightness(2.2)"


@pytest.mark.parametrize("width", [320, 1440])
@pytest.mark.parametrize("dark", [False, True])
def test_text_is_readable_on_every_screen(started, page, width, dark):
    started.open(page, width, 800, dark)
    started.run("document.querySelectorAll('details').forEach(details => details.open = true)")
    scroll_width, inner_width = started.run("[document.documentElement.scrollWidth, innerWidth]")
    assert scroll_width <= inner_width == width
    # All text has at least 10 px, and the contrast that WCAG 2.2 requires of text (4.5).
    font_size, contrast = started.run(
        """(() => {
          const channel = v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
          const luminance = colour => colour.match(/[\\d.]+/g).slice(0, 3).map(Number).map(channel)
            .reduce((sum, v, k) => sum + v * [.2126, .7152, .0722][k], 0);
          const background = element => { for (; element; element = element.parentElement) {
            const colour = getComputedStyle(element).backgroundColor;
            if (!/, 0\\)$|transparent/.test(colour) && !/, 0?\\.\\d+\\)$/.test(colour)) return colour;
          } return "rgb(255, 255, 255)"; };
          let fontSize = 99, contrast = 99;
          const walker = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
          while (walker.nextNode()) {
            const element = walker.currentNode.parentElement;
            if (!walker.currentNode.textContent.trim() || !element.getClientRects().length) continue;
            if (["TITLE", "DESC"].includes(element.tagName.toUpperCase())) continue;
            const style = getComputedStyle(element), svg = element.ownerSVGElement;
            fontSize = Math.min(fontSize, parseFloat(style.fontSize) * (svg ? svg.getScreenCTM().a : 1));
            const text = luminance(svg ? style.fill : style.color);
            const both = [text, luminance(background(element))].sort((a, b) => b - a);
            contrast = Math.min(contrast, (both[0] + .05) / (both[1] + .05));
          }
          return [fontSize, contrast];
        })()"""
    )
    assert font_size >= 10
    assert contrast >= 4.5
    started.click(".card .picture")
    assert dialog(started)["within"]


@pytest.fixture(scope="module")
def hostile_page(tmp_path_factory):
    """The page, by the command line, of a data set and photographs whose texts and names are hostile."""
    parent = tmp_path_factory.mktemp("hostile")
    folder = make_plain_set(parent).rename(parent / FILE_NAME)
    make_hostile(folder)
    photographs = make_photographs(parent, f"{FILE_NAME}2", FILE_NAME)
    command = [sys.executable, "-m", "pepperscene", "report", folder, "--beside", photographs, "--limit", "2"]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "PYTHONPATH": PYTHONPATH})
    return folder / "index.html"


def test_no_script_of_a_hostile_data_set_runs(started, hostile_page):
    started.open(hostile_page)
    # All interactions that copy text.
    started.click(".card .picture")
    for _ in range(12):
        started.press("ArrowRight")
    assert FILE_NAME in dialog(started)["caption"]
    started.press("Escape")
    started.click("summary")
    started.click("details tr:last-child a")
    started.wait_until("location.hash !== '' && document.getElementById(location.hash.slice(1)) !== null")
    assert started.run("document.querySelector('h1').textContent") == TEXT
    assert started.run("typeof window.attacked") == "undefined"
    started.assert_quiet(hostile_page)
