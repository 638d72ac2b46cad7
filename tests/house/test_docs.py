"""What the README and the pages show is run: every Python block, every `pepperscene` command, and Sphinx."""

from __future__ import annotations

import inspect
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from pydantic import BaseModel
from typer.models import OptionInfo

import pepperscene
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.cli import app
from pepperscene.cultivar import Cultivar, Distribution
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.frame import OUTPUTS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOT_RUN = re.compile(r"<!-- not run: .+ -->")
"""A reader does not see it: the next block is shown only, and why (it takes a day, say)."""


def _blocks(page: Path) -> list[tuple[str, int, list[str]]]:
    """(language, number of the first line inside, lines) of a page's fenced blocks that are to be run."""
    blocks, fence, lines, shown_only = [], None, [], False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if fence is not None and line.strip() == fence[0]:
            if not shown_only:
                blocks.append((fence[1], fence[2], lines))
            fence, shown_only = None, False
        elif fence is not None:
            lines.append(line)
        elif opening := re.fullmatch(r"(`{3,})(.*)", line):
            fence, lines = (opening[1], opening[2].strip(), number + 1), []
        elif line.strip():
            shown_only = NOT_RUN.fullmatch(line.strip()) is not None
    assert fence is None, f"{page.name}: a block is not closed"
    return blocks


def _commands(language: str, lines: list[str]) -> list[tuple[int, str]]:
    """(offset, command) of the shell lines of a block; in a console block those behind the prompt."""
    if language in ("bash", "sh"):
        return [(i, line) for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    return [(i, line[2:]) for i, line in enumerate(lines) if line.startswith("$ ")]


def _script(page: Path) -> str:
    """A page as one Python program, its lines where they stand on the page; prose becomes empty lines."""
    program = [""] * (len(page.read_text(encoding="utf-8").splitlines()) + 1)
    for language, first, lines in _blocks(page):
        if language == "python":
            program[first - 1 : first - 1 + len(lines)] = lines
        elif language in ("bash", "sh", "console"):
            for offset, command in _commands(language, lines):
                words = shlex.split(command, comments=True)
                if words[0] == "pepperscene":
                    call = f"[__import__('sys').executable, '-m', 'pepperscene', *{words[1:]!r}]"
                    program[first - 1 + offset] = f"__import__('subprocess').run({call}, check=True)"
    return "\n".join(program)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_examples_of_a_page_run(page: Path, tmp_path: Path) -> None:
    program = _script(page)
    if not program.strip():
        return
    script = tmp_path / f"{page.stem}_examples.py"
    script.write_text(program, encoding="utf-8")
    workplace = tmp_path / "work"
    workplace.mkdir()
    done = subprocess.run(
        [sys.executable, str(script)], cwd=workplace, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, f"{page.name} (line numbers are the page's)\n{done.stderr[-4000:]}"


def test_the_make_targets_that_pages_name_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in (*PAGES, ROOT / "CONTRIBUTING.md"):
        for target in re.findall(
            r"`make ([a-z-]+)|^\$? ?make ([a-z-]+)", page.read_text(encoding="utf-8"), re.M
        ):
            assert "".join(target) in targets, f"{page.name}: make {''.join(target)}"


def test_the_readme_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md"):
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert link.startswith("http") or (ROOT / link).exists(), f"{page.name}: {link}"


def test_sphinx_builds_without_a_warning(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", "-b", "html",
        # The notebooks are executed by a test of their own.
        "-D", "nb_execution_mode=off",
        "-d", str(tmp_path / "doctrees"), str(ROOT / "docs"), str(tmp_path / "html"),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "html" / "index.html").is_file()


def _keys(model: type[BaseModel]) -> set[str]:
    """All keys that a file of this model can hold, those of its tables included."""
    found: set[str] = set()
    for name, field in model.model_fields.items():
        found.add(field.alias or name)
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel) and kind is not Distribution:
                found |= _keys(kind)
    return found


@pytest.mark.parametrize(("page", "model"), [("recipe.md", Recipe), ("cultivar.md", Cultivar)])
def test_every_key_of_a_file_is_told(page: str, model: type[BaseModel]) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    # A key stands between backticks, as an own word in an example, or as a part of a table's name.
    untold = [key for key in sorted(_keys(model)) if not re.search(rf"(?<![a-z_]){key}(?![a-z_])", text)]
    assert not untold


def test_every_output_is_told() -> None:
    text = (ROOT / "docs" / "outputs.md").read_text(encoding="utf-8")
    assert [name for name in OUTPUTS if f"| `{name}` | " not in text] == []
    for organ_class in OrganClass:
        red, green, blue = CLASS_COLOURS[organ_class]
        row = rf"\| {organ_class:d} \| {organ_class.name.lower()} \| .+ \| {red}, {green}, {blue} \|"
        assert re.search(row, text)


def _options(command: Callable[..., Any]) -> list[str]:
    """Names of a command's options, wherever their annotation is written."""
    hints = get_type_hints(command, include_extras=True)
    kinds = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return [name for name, kind in kinds.items() if any(isinstance(one, OptionInfo) for one in kind)]


def test_every_command_and_option_is_told() -> None:
    text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    for command in app.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__
        assert f"## `pepperscene {name}" in text
        section = text.split(f"## `pepperscene {name}")[1].split("\n## ")[0]
        options = _options(inspect.unwrap(command.callback))
        assert options or name in ("cultivars", "doctor", "recipes")
        for option in options:
            flag = "--" + option.replace("_", "-")
            assert flag in section, f"{name} {flag}"


def test_every_public_name_is_told_and_every_function_has_an_example() -> None:
    page = ROOT / "docs" / "api.md"
    text, examples = page.read_text(encoding="utf-8"), _script(page)
    for name in pepperscene.__all__:
        if name != "__version__":
            assert re.search(rf"^\.\. (auto\w+|data):: {name}$", text, re.MULTILINE), name
        if inspect.isfunction(getattr(pepperscene, name)):
            assert f"ps.{name}(" in examples, name
