r"""Photograph a report in a browser for the page about reports, into docs/images.

It needs Chromium. Run it after a change that affects the picture:

pepperscene build demo --out out/report --set plan.select=[10,60,110,160,210] \
    --outputs colour,class,instance,distance,harvest
pepperscene report out/report --scene
python docs/figures/report.py out/report
"""

from __future__ import annotations

import argparse
import base64
import io
import sys
import tempfile
from pathlib import Path
from typing import Final

from overview import IMAGES
from PIL import Image

# The browser of the tests.
sys.path.append(str(Path(__file__).parents[2] / "tests" / "dataset"))
from chromium import Browser

WINDOW: Final = (1200, 900)
NARROW: Final = (560, 900)
"""Width and height of the browser's window for the photograph and for the 3D view, pixels."""
OUT_HEIGHT: Final = 640
GAP: Final = 8  # pixels between the two pictures
OTHER_CLASSES: Final = (1, 3, 4, 5, 6, 7)
"""Keys of the classes that are switched off: all but fruit."""


def screenshot(browser: Browser, selector: str) -> Image.Image:
    """A picture of an element."""
    box = f"document.querySelector({selector!r}).getBoundingClientRect()"
    left, top, width, height = browser.run(f"(box => [box.x, box.y + scrollY, box.width, box.height])({box})")
    clip = {"x": left, "y": top, "width": width, "height": height, "scale": 1}
    data = browser.call("Page.captureScreenshot", format="png", clip=clip)["data"]
    return Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")


def frame_with_labels(browser: Browser) -> Image.Image:
    """The first photograph, enlarged, with masks, boxes and keypoints of its fruit."""
    browser.run("document.querySelector('.card .picture').click()")
    for key in ("i", "b", "k", *map(str, OTHER_CLASSES)):
        browser.press(key)
    browser.run("new Promise(next => setTimeout(next, 500))")
    picture = screenshot(browser, "dialog")
    browser.press("Escape")
    return picture


def scene(browser: Browser) -> Image.Image:
    """The 3D view with a selected camera."""
    browser.run("document.querySelector('#scene canvas').scrollIntoView({block: 'center'})")
    browser.run("document.querySelector('#scene canvas').focus()")
    for key in ("n", "+"):
        browser.press(key)
    browser.run("new Promise(next => setTimeout(next, 500))")
    return screenshot(browser, "#scene canvas")


def take_pictures(page: Path) -> list[Image.Image]:
    """The enlarged photograph and the 3D view of a page."""
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        try:
            browser.open(page, *WINDOW, dark=True)
            browser.wait_until("document.body.dataset.labelled === 'true'")
            photograph = frame_with_labels(browser)
            browser.open(page, *NARROW, dark=True)
            browser.wait_until("document.getElementById('scene').dataset.drawn === 'true'")
            return [photograph, scene(browser)]
        finally:
            browser.close()


def main() -> None:
    """Write the picture of the report of a data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, help="data set with a report that has a 3D view")
    parts = [
        part.resize((round(OUT_HEIGHT * part.width / part.height), OUT_HEIGHT), Image.Resampling.LANCZOS)
        for part in take_pictures(parser.parse_args().folder / "index.html")
    ]
    sheet = Image.new("RGB", (sum(part.width for part in parts) + GAP, OUT_HEIGHT), "white")
    left = 0
    for part in parts:
        sheet.paste(part, (left, 0))
        left += part.width + GAP
    sheet.save(IMAGES / "report.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
