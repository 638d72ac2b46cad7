"""Draws the pictures of the page "From nothing to your robot's data set" into docs/images/robot.

    python docs/figures/robot_data_set.py [FOLDER]

Runs the commands and programs of the page in a folder, by default a temporary one, and prints the processor
time that each takes. What a build finds complete in the folder is kept, as for a reader.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any, Final

import matplotlib
from PIL import Image

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "tutorials" / "robot_data_set.md"
PICTURES: Final = ROOT / "docs" / "images" / "robot"
MADE: Final = {
    "plan": "plan.png",
    "first_look": "out/first_look/colour.png",
    "photographs": "out/photographs.png",
    "yolo": "out/yolo.png",
    "coco": "out/coco.png",
    "depth": "out/depth.png",
    "nerfstudio": "out/nerfstudio.png",
    "torch": "out/torch.png",
}
"""The file that the page makes, by the name of the picture that shows it."""
MOST_WIDTH: Final = 1000


def blocks() -> Iterator[tuple[str, str]]:
    """Language and content of the fenced blocks of the page, in order."""
    text = PAGE.read_text(encoding="utf-8")
    yield from re.findall(r"^```(bash|python|toml)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def processor_s() -> float:
    """Seconds of all cores that this process and its finished children have used."""
    return sum(os.times()[:4])


def run_page() -> None:
    """Run the page in the current folder."""
    names: dict[str, Any] = {}
    for language, content in blocks():
        start = processor_s()
        if language == "toml":
            name = content.partition("\n")[0].removeprefix("# ")
            Path(name).write_text(content, encoding="utf-8")
        elif language == "python":
            exec(compile(content, str(PAGE), "exec"), names)
        else:
            for line in content.splitlines():
                _, *words = shlex.split(line)
                subprocess.run([sys.executable, "-P", "-m", "pepperscene", *words], check=True)
        sys.stderr.write(f"{processor_s() - start:.1f} s: {content.partition(chr(10))[0]}\n")


def main(folder: str) -> None:
    """Run the page and write its pictures."""
    matplotlib.use("agg")
    with chdir(folder):
        run_page()
        PICTURES.mkdir(exist_ok=True)
        for name, file in MADE.items():
            with Image.open(file) as picture:
                shown = picture.convert("RGB")
            shown.thumbnail((MOST_WIDTH, MOST_WIDTH), Image.Resampling.LANCZOS)
            shown.save(PICTURES / f"{name}.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(sys.argv[1])
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(temporary)
