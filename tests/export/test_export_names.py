"""Names of recipes, cultivars, devices and splits with a meaning in YAML, Markdown, HTML or a shell."""

from __future__ import annotations

import json
import shlex

import pytest
from data_sets import D435, set_without_plants
from markdown_it import MarkdownIt
from painted_set import ALL, Painter

from pepperscene.errors import InputError
from pepperscene.export import export_dataset

yaml = pytest.importorskip("yaml", reason="a reader of YAML")

SYNTAX = "a | <b>b</b> [c](http:d) ![](e) `f` *g* _h_ ~~i~~ &amp; \\ $j$"
NAMES = (
    SYNTAX,
    "--- # comment",
    "a: &anchor [b, *anchor]",
    '"\\n---\\nlicense: other"',
    "{a: b}, [c]",
    "https://example.org and www.example.org",
    "\\| \\\\ \\`",
    "a\x7fb\x85c\u2028d\u2029e\ufefff",
    "[^1] [ ] [x]",
)


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """A data set whose recipe and cultivar have names that are hostile, and its files."""
    folder = tmp_path_factory.mktemp("named")
    cultivar = folder / f"{SYNTAX.replace('/', ' ')}.toml"
    cultivar.write_text('extends = "kaite_february"\n', encoding="utf-8")
    changes = {"name": SYNTAX, "cultivar": str(cultivar), **D435}
    return set_without_plants(folder / "set", range(3), ALL, Painter, changes)


def rename(dataset, name):
    """Give a recipe and its parts another name."""
    path = dataset.folder / "dataset.json"
    info = json.loads(path.read_text())
    info["recipe"] |= {"name": name, "cultivar": name}
    info["recipe"]["camera"] |= {"sensor": name, "lens": name}
    path.write_text(json.dumps(info))


def card(folder):
    """Front matter and page of a card."""
    start, front, page = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    assert start == ""
    return yaml.safe_load(front), page


def shown(page):
    """The title and the cells of the first table as a reader sees them, with the types of their parts."""
    tokens = MarkdownIt("commonmark").enable(["table", "strikethrough"]).parse(page)
    inline = [token for token in tokens if token.type == "inline"]
    texts = ["".join(child.content for child in token.children) for token in inline]
    types = {child.type for token in inline[:1] for child in token.children}
    table = next(number for number, token in enumerate(inline) if texts[number] == "recipe")
    return texts[0], types, dict(zip(texts[table::2], texts[table + 1 :: 2], strict=False))


def check_card(folder, name, cultivar, parts):
    front, page = card(folder)
    title = f"{name}: rendered sweet-pepper plants"
    assert front["pretty_name"] == title
    assert front["license"] == "mit"
    shown_title, types, cells = shown(page)
    assert shown_title == title
    assert types == {"text"}
    assert cells["recipe"].startswith(f"{name}, seed ")
    assert cells["cultivar"] == cultivar
    assert parts is None or cells["camera"] == f"{parts} with {parts}"


def test_card_shows_the_names_of_a_recipe_and_its_cultivar(named, tmp_path):
    out = export_dataset(named.folder, "huggingface", tmp_path / "out", frames="0:1").folder
    assert named.info["recipe"]["name"] == SYNTAX
    check_card(out, SYNTAX, named.info["recipe"]["cultivar"], None)


def test_cards_show_any_name(named, copied, tmp_path):
    dataset = copied(named)
    for number, name in enumerate(NAMES):
        rename(dataset, name)
        out = export_dataset(dataset.folder, "huggingface", tmp_path / f"{number}", frames="0:1").folder
        check_card(out, name, name, name)
        # No link that a reader of GitHub's Markdown makes of a bare address.
        assert "https://" not in card(out)[1]
        assert "www." not in card(out)[1]


@pytest.mark.parametrize("split", ["no", "null"])
def test_names_of_splits_are_text(split, named, tmp_path):
    for format_name in ("yolo", "huggingface"):
        result = export_dataset(named.folder, format_name, tmp_path / format_name, f"{split}=0:2,train=2:3")
        assert result.splits == {split: 2, "train": 1}
    description = yaml.safe_load((tmp_path / "yolo" / "data.yaml").read_text())
    assert description[split] == f"images/{split}"
    front, _ = card(tmp_path / "huggingface")
    assert [size["name"] for size in front["dataset_info"]["splits"]] == [split, "train"]


def test_the_command_that_adds_an_output_can_be_pasted_into_a_shell(named, copied, tmp_path):
    dataset = copied(named)
    rename(dataset, "a; echo $(id) 'b'")
    (dataset.folder / "class" / "000001.png").unlink()
    with pytest.raises(InputError) as caught:
        export_dataset(dataset.folder, "huggingface", tmp_path / "out")
    command = str(caught.value).split("`")[1]
    # No recipe of that name is shipped, and where its file is is not known.
    assert shlex.split(command)[:3] == ["pepperscene", "build", "RECIPE"]
    assert "$(id)" not in command
