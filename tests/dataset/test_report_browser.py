"""The report as a reader meets it: in a browser without a network, by mouse, by keys, on a telephone."""

from __future__ import annotations

import json

import numpy as np
import pytest
from chromium import Browser, chromium

from pepperscene.classes import OrganClass
from pepperscene.dataset import write_report
from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage
from pepperscene.dataset.store.dataset import FORMAT, FRAMES, MARK, file_name, written_image
from pepperscene.frame import OUTPUTS

pytestmark = pytest.mark.skipif(chromium() is None, reason="there is no Chromium on this machine")

SIZE = (120, 160)
FRAMES_MADE = 40
SHOWN = 3
PICTURES = 4
"""Colour, class, instance and distance of each frame."""


class Photographs(ImageSet):
    """Two photographs in which only fruit is labelled."""

    def names(self):
        return tuple(f"photo {item}" for item in self.items)

    def read(self, item):
        colour = np.full((90, 120, 3), (40, 120, 60), np.uint8)
        classes = np.full((90, 120), 255, np.uint8)
        classes[20:50, 30:70], colour[20:50, 30:70] = 2, (190, 40 + 50 * item, 20)
        return LabelledImage(f"photo {item}", colour, classes)


def frame(index):
    """Bands of classes, each in a colour of its own, brightest in the middle."""
    height, width = SIZE
    rows, columns = np.mgrid[:height, :width]
    classes = ((rows // 15 + index) % len(OrganClass)).astype(np.uint8)
    light = np.exp(-((rows / height - 0.5) ** 2 + (columns / width - 0.5) ** 2) * 4)
    palette = np.array(
        [[90, 80, 140], [60, 160, 40], [220, 190, 20], [90, 150, 30], [120, 160, 60], [100, 150, 50],
         [200, 200, 190], [160, 130, 60]]
    )  # fmt: skip
    colour = (palette[classes] * light[..., None]).astype(np.uint8)
    return {
        "colour": colour,
        "class": classes,
        "instance": (classes.astype(np.uint16) * 7 + columns.astype(np.uint16) // 40),
        "distance": (0.3 + rows / height).astype(np.float32),
    }


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "set with a long name_that_cannot_be_broken_anywhere"
    for name in (FRAMES, *frame(0)):
        (folder / name).mkdir(parents=True, exist_ok=True)
    recipe = {
        "name": "striped", "cultivar": "kaite", "seed": 1, "plan": {"sets": 1, "rotations": 1, "frames": 100},
        "row": {"plants_front": 1, "plants_back": 0, "spacing_mm": 200.0}, "camera": {"exposure_us": 50.0},
        "daylight": None,
    }  # fmt: skip
    about = {
        "format": FORMAT,
        "quality": "draft",
        "version": "1",
        "recipe_sha256": "0" * 64,
        "recipe": recipe,
    }
    (folder / MARK).write_text(json.dumps(about))
    for index in range(FRAMES_MADE):
        images = frame(index)
        outputs = {name: written_image(folder / file_name(index, name), image, name, file_name(index, name))
                   for name, image in images.items() if name in OUTPUTS}  # fmt: skip
        counts = np.bincount(images["class"].ravel(), minlength=len(OrganClass))
        facts = {
            "index": index, "set": 0, "rotation": 0, "step": index, "outputs": outputs,
            "class_pixels": {one.name.lower(): int(counts[one]) for one in OrganClass},
            "sampling": {"error_codes": 1 + index / 50, "noise_codes": 9.0, "samples_per_pixel": 8 + index},
            "camera": {"pose": np.eye(4).tolist()},
        }  # fmt: skip
        (folder / FRAMES / f"{index:06d}.json").write_text(json.dumps(facts))
    beside = Photographs(name="photographs", items=(0, 1), fields=FIELDS)
    return write_report(folder, SHOWN, beside).page


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def browser(started, page):
    """A browser that has opened the page without a network, and has nothing to complain of in the end."""
    started.open(page)
    yield started
    requested = {
        event["request"]["url"].partition(",")[0] for event in started.told("Network.requestWillBeSent")
    }
    assert {url for url in requested if not url.startswith("data:")} == {page.resolve().as_uri()}
    assert started.told("Runtime.exceptionThrown") == []
    assert started.told("Runtime.consoleAPICalled") == []
    assert started.told("Log.entryAdded") == []


def opened(browser):
    """What the large view shows, how wide, and whether all of it is on the screen; None when it is shut."""
    return browser.run(
        """(() => {
          const dialog = document.querySelector("dialog"), image = dialog.querySelector("img");
          if (!dialog.open) return null;
          const box = image.getBoundingClientRect();
          return {alt: image.alt, told: dialog.querySelector("p").textContent, width: image.naturalWidth,
            shown: box.width, within: box.left >= 0 && box.top >= 0 && box.right <= innerWidth
              && box.bottom <= innerHeight};
        })()"""
    )


def test_it_opens_and_every_picture_is_there(browser):
    widths = browser.run(
        "Promise.all([...document.querySelectorAll('main img')]"
        ".map(image => image.decode().then(() => image.naturalWidth)))"
    )
    frames = [SIZE[1]] * (SHOWN * PICTURES)
    # Frames, photographs with their masks, places of eight classes and of one, both mean intensities.
    assert sorted(widths) == sorted([*frames, *[120] * 4, *[SIZE[1]] * 8, 120, SIZE[1], 120])
    assert browser.run("document.title").startswith("striped")


def test_a_click_opens_the_picture_large(browser):
    assert opened(browser) is None
    browser.click(".card:nth-child(2) .picture")
    found = opened(browser)
    assert found["alt"] == found["told"] == "Colour of frame 000020"
    assert found["width"] == SIZE[1]
    assert found["shown"] > 900
    assert found["within"]
    browser.click("dialog img")
    assert opened(browser) is None


def test_arrows_go_on_and_escape_closes(browser):
    browser.click(".card .picture")
    seen = []
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "ArrowDown", "ArrowDown", "ArrowUp", "ArrowLeft"):
        browser.press(key)
        seen.append(opened(browser)["alt"])
    assert seen == [
        "Class of frame 000000", "Organ instance of frame 000000", "Class of frame 000000",
        "Class of frame 000020", "Class of frame 000039", "Class of frame 000020", "Colour of frame 000020",
    ]  # fmt: skip
    browser.press("Escape")
    assert opened(browser) is None
    # One goes on in the page where one has gone to.
    browser.until("document.activeElement.querySelector('img')?.alt == 'Colour of frame 000020'")
    browser.press("Enter")
    assert opened(browser)["alt"] == "Colour of frame 000020"
    browser.click("dialog .after")
    assert opened(browser)["alt"] == "Class of frame 000020"
    browser.click("dialog .close")
    assert opened(browser) is None


def test_the_ends_meet(browser):
    browser.click(".card .picture")
    browser.press("ArrowLeft")
    assert opened(browser)["alt"] == "Mean intensity of photographs"
    browser.press("ArrowRight")
    assert opened(browser)["alt"] == "Colour of frame 000000"
    browser.press("ArrowUp")
    assert opened(browser)["alt"] == "Colour of frame 000000"


def test_every_picture_can_be_reached_and_opened_by_keys(browser):
    browser.run("document.querySelector('#frames .picture').focus()")
    reached = []
    for _ in range(PICTURES):
        reached.append(browser.run("document.activeElement.querySelector('img')?.dataset.kind"))
        browser.press("Tab")
    assert reached == ["colour", "class", "instance", "distance"]
    names = browser.run("[...document.querySelectorAll('button')].map(b => b.getAttribute('aria-label'))")
    assert all(names)


def test_photographs_are_brightened_and_labels_are_not(browser):
    def filters():
        return browser.run(
            "['colour', 'class'].map(n => getComputedStyle(document.querySelector('img.' + n)).filter)"
        )

    assert filters() == ["none", "none"]
    browser.click("#bright")
    assert filters() == ["brightness(2.2)", "none"]
    browser.click(".card .picture")
    assert browser.run("getComputedStyle(document.querySelector('dialog img')).filter") == "brightness(2.2)"


def test_a_row_of_the_table_leads_to_its_picture(browser):
    browser.click("summary")
    browser.click("details tr:last-child a")
    top = "document.querySelector('#a-000039').getBoundingClientRect().top"
    # Not below the bar that stays at the top.
    browser.until(f"{top} > 40 && {top} < innerHeight")
    assert browser.run("location.hash") == "#a-000039"


@pytest.mark.parametrize("width", [320, 375, 800, 1440])
@pytest.mark.parametrize("dark", [False, True])
def test_it_reads_well_on_every_screen(started, page, width, dark):
    started.open(page, width, 800, dark)
    started.run("document.querySelectorAll('details').forEach(one => one.open = true)")
    across, inner = started.run("[document.documentElement.scrollWidth, innerWidth]")
    assert across <= inner == width
    # Small print is no smaller than 10 px, and stands out from its ground as WCAG 2.2 wants of text (4.5).
    smallest, faintest = started.run(
        """(() => {
          const channel = v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
          const luminance = colour => colour.match(/[\\d.]+/g).slice(0, 3).map(Number).map(channel)
            .reduce((sum, v, k) => sum + v * [.2126, .7152, .0722][k], 0);
          const ground = one => { for (; one; one = one.parentElement) {
            const colour = getComputedStyle(one).backgroundColor;
            if (!/, 0\\)$|transparent/.test(colour) && !/, 0?\\.\\d+\\)$/.test(colour)) return colour;
          } return "rgb(255, 255, 255)"; };
          let smallest = 99, faintest = 99;
          const walk = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
          while (walk.nextNode()) {
            const one = walk.currentNode.parentElement;
            if (!walk.currentNode.textContent.trim() || !one.getClientRects().length) continue;
            if (["TITLE", "DESC"].includes(one.tagName.toUpperCase())) continue;
            const style = getComputedStyle(one), drawn = one.ownerSVGElement;
            smallest = Math.min(smallest, parseFloat(style.fontSize) * (drawn ? drawn.getScreenCTM().a : 1));
            const ink = luminance(drawn ? style.fill : style.color);
            const both = [ink, luminance(ground(one))].sort((a, b) => b - a);
            faintest = Math.min(faintest, (both[0] + .05) / (both[1] + .05));
          }
          return [smallest, faintest];
        })()"""
    )
    assert smallest >= 10
    assert faintest >= 4.5


def test_the_large_view_fits_a_telephone(started, page):
    started.open(page, 375, 700)
    started.click(".card .picture")
    found = opened(started)
    assert found["within"]
    assert found["shown"] > 330


def test_on_paper_there_is_nothing_to_click(started, page):
    started.open(page, 800, 1100, dark=True)
    started.call("Emulation.setEmulatedMedia", media="print")
    shown = started.run(
        "['.bar', 'dialog', '.card', '.chart', 'svg.length']"
        ".map(name => document.querySelector(name).checkVisibility())"
    )
    assert shown == [False, False, True, True, True]
    assert started.run("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
