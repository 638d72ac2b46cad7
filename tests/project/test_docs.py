"""README and documentation: examples run, reference pages are complete, and Sphinx builds."""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np
import pytest
import row_cache
import typer
from pydantic import BaseModel
from typer.models import OptionInfo

import pepperscene
from pepperscene.building.scenes.plants import PROCESSES
from pepperscene.building.subprocess_rpc import THREADS
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.cli import app
from pepperscene.cultivar import Cultivar, Distribution
from pepperscene.outputs import OUTPUTS, Output
from pepperscene.recipe.recipe import Recipe
from pepperscene.units import is_table, table_fields

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
REFERENCE = DOCS / "reference"
PAGES = [ROOT / "README.md", *sorted(page for page in DOCS.rglob("*.md") if "_build" not in page.parts)]
NOT_RUN = re.compile(r"<!-- not run: .+ -->")
"""Marks the next block as an example that is only shown, with the reason (it takes a day, say)."""
RUN_WITH = re.compile(r"<!-- tested with: (.+) -->")
"""Options that the commands of the next block have in tests only: smaller images, fewer plants."""
FILE_NAME = re.compile(r"# (\w+\.(?:toml|py|csv|yaml))")
"""First line of a block that is a file of the reader's."""
EXTENDED = re.compile(r'^extends = "(\w+)"$', re.MULTILINE)
NEED_TORCH = {"api.md", "learn.md", "robot_data_set.md"}
"""Pages whose examples need torch, which cannot be installed everywhere."""
SEARCHES = {
    "field of view": "how-to/camera", "resolution": "how-to/camera", "RealSense": "how-to/camera",
    "exposure": "how-to/camera", "motion blur": "how-to/motion", "bounding boxes": "how-to/read",
    "resume": "how-to/build", "YOLO": "how-to/export", "COCO": "how-to/export", "depth": "how-to/export",
    "nerfstudio": "how-to/export", "FiftyOne": "how-to/troubleshooting", "Slurm": "how-to/cluster",
    "own photos": "how-to/read", "torch": "how-to/read", "domain randomisation": "how-to/vary",
    "cucumber": "how-to/own_crop",
}  # fmt: skip
"""What readers search for, and a page with a heading about it."""
RECIPES = {recipe.stem for recipe in (ROOT / "recipes").glob("*.toml")}

RUN_COMMAND = """
def _run(*words):
    from pepperscene.cli import app
    exit_code = app(list(words), standalone_mode=False)
    assert not exit_code, f"exit code {exit_code}: pepperscene {' '.join(words)}"
"""
"""Runs a command in the page's process, which has loaded the libraries and compiled the kernels already."""


class Block(NamedTuple):
    """A fenced block: its language, the number of its first line on the page, its lines, options of tests."""

    language: str
    first_line: int
    lines: list[str]
    options: list[str]


def _blocks(page: Path) -> list[Block]:
    """The blocks of a page that are to be run."""
    blocks, fence, lines, skipped, options = [], None, [], False, []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if fence is not None and line.strip() == fence[0]:
            if not skipped:
                blocks.append(Block(fence[1], fence[2], lines, options))
            fence, skipped, options = None, False, []
        elif fence is not None:
            lines.append(line)
        elif opening := re.fullmatch(r"(`{3,})(.*)", line):
            fence, lines = (opening[1], opening[2].strip(), number + 1), []
        elif line.strip():
            skipped = NOT_RUN.fullmatch(line.strip()) is not None
            options = shlex.split(found[1]) if (found := RUN_WITH.fullmatch(line.strip())) else []
    assert fence is None, f"{page.name}: a block is not closed"
    return blocks


def _commands(block: Block) -> list[tuple[int, str]]:
    """(offset, command) of each shell line of a block; in a console block those after the prompt."""
    if block.language in ("bash", "sh"):
        return [(i, line) for i, line in enumerate(block.lines) if line.strip() and not line.startswith("#")]
    return [(i, line[2:]) for i, line in enumerate(block.lines) if line.startswith("$ ")]


def _program(page: Path) -> str:
    """A page as one Python program, with every line at its line number on the page."""
    program = [""] * (len(page.read_text(encoding="utf-8").splitlines()) + 1)
    for block in _blocks(page):
        start = block.first_line - 1
        text = "\n".join(block.lines)
        name, extended = FILE_NAME.fullmatch(block.lines[0] if block.lines else ""), EXTENDED.search(text)
        if name or (block.language == "toml" and extended and extended[1] in RECIPES):
            file = name[1] if name else "recipe.toml"
            program[start] = f"open({file!r}, 'w', encoding='utf-8').write({text!r})"
            if extended and extended[1] in RECIPES:
                program[start] += f"; __import__('pepperscene').load_recipe({file!r})"
        elif block.language == "python":
            program[start : start + len(block.lines)] = block.lines
        elif block.language in ("bash", "sh", "console"):
            for offset, command in _commands(block):
                words = shlex.split(command, comments=True)
                if words[0] == "pepperscene":
                    # Commands of the block that do not have these options go without.
                    options = [] if _unknown_words([words[1], *block.options]) else block.options
                    program[start + offset] = f"_run(*{[*words[1:], *options]!r})"
    return "\n".join(program)


IN_CI = {"README.md", "quickstart.md"}
"""Pages whose examples run in every test run; the others are of the long tier, and run if they changed."""
SINCE = os.environ.get("PEPPERSCENE_SINCE")
"""A revision: the examples of pages that changed since then are run too (`make test SINCE=main`)."""


def _changed_pages() -> set[str]:
    """Paths of the pages that changed since the revision, relative to the root."""
    if not SINCE:
        return set()
    command = ["git", "diff", "--name-only", SINCE, "--", "*.md"]
    return set(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split())


_CHANGED = _changed_pages()
_RUN = [
    pytest.param(page, id=page.stem)
    if page.name in IN_CI or str(page.relative_to(ROOT)) in _CHANGED
    else pytest.param(page, id=page.stem, marks=pytest.mark.long)
    for page in PAGES
]


@pytest.mark.parametrize("page", _RUN)
def test_examples_run(page: Path, tmp_path: Path, rows: Path) -> None:
    program = _program(page)
    if not program.strip():
        return
    if page.name in NEED_TORCH:
        pytest.importorskip("torch")
    script = tmp_path / f"{page.stem}_examples.py"
    script.write_text(program, encoding="utf-8")
    folder = tmp_path / "work"
    folder.mkdir()
    prelude = row_cache.install_code(rows) + RUN_COMMAND
    run_page = f"{prelude}\nexec(compile(open({str(script)!r}).read(), {str(script)!r}, 'exec'))"
    command = [sys.executable, "-c", run_page]
    # `make test` limits threads and processes; one page runs without a limit, as for a reader.
    limits = (*THREADS, PROCESSES) if page.name == "README.md" else ()
    environment = {name: value for name, value in os.environ.items() if name not in limits}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"{page.name} (line numbers are the page's)\n{done.stderr[-4000:]}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_name_what_exists(page: Path) -> None:
    """Every page in every run: Python compiles and uses public names, commands have these options."""
    program = ast.parse(_program(page), page.name)
    modules = {
        alias.asname
        for node in ast.walk(program)
        if isinstance(node, ast.Import)
        for alias in node.names
        if alias.name == "pepperscene"
    }
    for node in ast.walk(program):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            assert hasattr(pepperscene, node.attr), f"{page.name}:{node.lineno}: {node.attr}"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pepperscene"):
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                assert hasattr(module, alias.name), f"{page.name}:{node.lineno}: {alias.name}"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "_run":
            (argument,) = node.args
            assert isinstance(argument, ast.Starred)
            words = ast.literal_eval(argument.value)
            assert _unknown_words(words) == [], f"{page.name}:{node.lineno}: pepperscene {' '.join(words)}"


def _unknown_words(words: list[str]) -> list[str]:
    """The command, or those options, that the command line does not have."""
    commands = typer.main.get_command(app).commands
    if words[0] not in commands:
        return words[:1] if words[0] not in ("--help", "--version") else []
    options = commands[words[0]].params
    known = {"--help", *(flag for one in options for flag in (*one.opts, *one.secondary_opts))}
    return [word for word in words[1:] if word.startswith("--") and word.partition("=")[0] not in known]


def test_make_targets_and_files_of_links_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in (*PAGES, ROOT / "CONTRIBUTING.md"):
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"`make ([a-z-]+)|^\$? ?make ([a-z-]+)", text, re.MULTILINE):
            assert "".join(target) in targets, f"{page.name}: make {''.join(target)}"
        for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
            assert link.startswith("http") or (page.parent / link).exists(), f"{page.name}: {link}"


@pytest.mark.long
def test_sphinx_builds_without_warnings_and_search_finds_what_readers_look_for(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", "-b", "html",
        # The notebooks are executed by tests of their own.
        "-D", "nb_execution_mode=off",
        "-d", str(tmp_path / "doctrees"), str(DOCS), str(tmp_path / "html"),
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "html" / "index.html").is_file()
    # Sphinx is installed for the long tier only.
    from search_index import SearchIndex

    index = SearchIndex(tmp_path / "html")
    for query, page in SEARCHES.items():
        assert page in index.pages_by_heading(query), f"{query}: {index.pages_by_heading(query)}"
        assert page in index.pages(query)
    assert index.pages("photogrammetric theodolite") == set()


def _keys(model: type[BaseModel]) -> Iterator[str]:
    """All keys that a file of this model can hold, including those of its tables."""
    for name, annotation in table_fields(model).items():
        yield name
        for part in (annotation, *get_args(annotation)):
            if is_table(part) and part is not Distribution:
                yield from _keys(part)


def _code(page: Path) -> str:
    """What a page sets as code: inline code, and the lines of its TOML blocks without comments."""
    text = page.read_text(encoding="utf-8")
    blocks = [
        line.partition("#")[0] for block in _blocks(page) if block.language == "toml" for line in block.lines
    ]
    return "\n".join([*re.findall(r"`([^`\n]+)`", text), *blocks])


@pytest.mark.parametrize(("page", "model"), [("recipe.md", Recipe), ("cultivar.md", Cultivar)])
def test_every_key_of_a_file_is_documented(page: str, model: type[BaseModel]) -> None:
    code = _code(REFERENCE / page)
    keys = sorted(set(_keys(model)))
    assert keys
    # A unit may follow a key (`length_mm`), and a key may be part of a table's name.
    assert [key for key in keys if not re.search(rf"(?<![a-z_]){key}(_[a-z0-9]+)?(?![a-z_])", code)] == []


def _file_of(output: Output) -> str:
    """The file of an output, as the page of outputs describes it."""
    if output.suffix == ".json":
        return "JSON"
    if output.suffix in (".png", ".jpg"):
        bits = f"{8 * np.dtype(output.dtype).itemsize} bit"
        return ("JPEG, " if output.suffix == ".jpg" else "PNG, ") + ("3 × " if output.channels else "") + bits
    channels = " ".join(f"`{name}`" for name in output.channel_names or (output.name,))
    if output.has_channels:
        channels = "`B01.475nm` …" if "bands" in output.needs else channels + ", or `Y`"
    return f"EXR, {output.dtype} {channels}" + (", or of bands" if output.name == "electrons" else "")


def test_every_output_is_documented() -> None:
    text = (REFERENCE / "outputs.md").read_text(encoding="utf-8")
    rows = [f"| `{one.name}` | {_file_of(one)} | {one.unit} | {one.meaning} |" for one in OUTPUTS.values()]
    assert re.findall(r"^\| `.+ \|$", text.split("## Images")[1].split("By default")[0], re.M) == rows
    for organ_class in OrganClass:
        red, green, blue = CLASS_COLOURS[organ_class]
        row = rf"\| {organ_class:d} \| {organ_class.name.lower()} \| .+ \| {red}, {green}, {blue} \|"
        assert re.search(row, text)


def _options(command: Callable[..., Any]) -> list[str]:
    """Names of a command's options."""
    hints = get_type_hints(command, include_extras=True)
    metadata = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return [
        name for name, values in metadata.items() if any(isinstance(value, OptionInfo) for value in values)
    ]


def test_every_command_and_option_is_documented() -> None:
    text, readme = (page.read_text(encoding="utf-8") for page in (REFERENCE / "command_line.md", PAGES[0]))
    first_cells = "\n".join(line.split("|")[1] for line in readme.splitlines() if line[:1] == "|")
    for command in app.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__
        assert f"`{name}`" in first_cells
        assert f"## `pepperscene {name}" in text
        section = text.split(f"## `pepperscene {name}")[1].split("\n## ")[0]
        options = _options(command.callback)
        assert options or name in ("cultivars", "doctor", "recipes")
        for option in options:
            flag = "--" + option.replace("_", "-")
            assert f"`{flag}" in section, f"{name} {flag}"


def test_every_public_name_is_documented_and_every_function_has_an_example() -> None:
    page = REFERENCE / "api.md"
    text, examples = page.read_text(encoding="utf-8"), _program(page)
    for name in pepperscene.__all__:
        if name != "__version__":
            assert re.search(rf"^\.\. (auto\w+|data):: {name}$", text, re.MULTILINE), name
        if inspect.isfunction(getattr(pepperscene, name)):
            assert f"ps.{name}(" in examples, name
