"""Cultivar files: the shipped one has the values of Table 1, and errors of a file name its key."""

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from pepperscene.classes import OrganClass
from pepperscene.cultivar import Cultivar, Distribution, load_cultivar
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

KAITE = shipped_folder("plants") / "kaite.toml"
TABLE = read_toml(KAITE)
SHIPPED = sorted(file.stem for file in KAITE.parent.glob("*.toml"))


@pytest.fixture
def table() -> dict[str, Any]:
    return copy.deepcopy(TABLE)


def load(table: dict[str, Any], folder: Path, name: str = "plant.toml") -> Cultivar:
    path = folder / name
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return load_cultivar(path)


def distribution(cultivar: Cultivar, name: str) -> Distribution:
    kind, key = name.split(".")
    return cultivar.stem.diameter if kind == "stem" else cultivar.organs[kind].distributions[key]


# Barth et al. 2018, Table 1, with L-4 and L-5 as corrected in the cultivar file.
TABLE_1 = {
    "internode.length": (99, 14),
    "node.width": (16, 2),
    "petiole.length": (97, 12),
    "lamina.length": (135, 16),
    "lamina.width": (112, 11),
    "side_shoot.length": (48, 30),
    "shoot_petiole.length": (97, 12),
    "shoot_lamina.length": (123, 16),
    "shoot_lamina.width": (102, 12),
    "peduncle.length": (46, 6),
    "fruit.diameter": (84, 11),
    "stem.diameter": (9, 1),
}


def test_the_file_has_table_1_with_its_source(kaite: Cultivar) -> None:
    for name, (mean, sd) in TABLE_1.items():
        value = distribution(kaite, name)
        assert (1e3 * value.mean, 1e3 * value.sd) == (pytest.approx(mean), pytest.approx(sd)), name
        assert "Table 1" in value.source
        # These rows of the table are misprinted.
        assert bool(value.as_printed and value.used) == (name in ("petiole.length", "lamina.length"))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_files_load_and_every_distribution_has_an_origin(name: str) -> None:
    cultivar = load_cultivar(name)
    for organ in cultivar.organs.values():
        for value in organ.distributions.values():
            assert value.source or value.chosen
    assert {"internode", "node", "fruit"} <= set(cultivar.present_kinds) <= set(cultivar.kinds)
    assert ("calyx" in cultivar.present_kinds) == (name != "cucumber")


def test_kinds_have_the_default_class_and_surface_of_their_form(kaite: Cultivar) -> None:
    assert kaite.kinds["shoot_petiole"].organ_class is OrganClass.SHOOT
    assert kaite.kinds["lamina"].surface == "leaf"
    # The calyx is part of the fruit; flowers have parameters but do not grow in April.
    assert kaite.kinds["calyx"].form == "calyx"
    assert set(kaite.kinds) - set(kaite.present_kinds) == {"pedicel", "flower"}


def test_pigment_paths_run_from_start_to_end(kaite: Cultivar) -> None:
    surfaces = ["calyx", "dry_shoot", "fruit", "leaf", "peduncle", "petal", "petiole", "stem"]
    assert sorted(kaite.pigments) == surfaces
    for path in kaite.pigments.values():
        for name, values in path.at([0.0, 1.0]).items():
            assert values.tolist() == [getattr(path.start, name), getattr(path.end, name)]
    # Ripening fruit loses its chlorophyll.
    fruit = kaite.pigments["fruit"].at(np.linspace(0.0, 1.0, 50))
    assert np.all(np.diff(fruit["chlorophyll_ug_cm2"]) < 0)


NODE = "organs.node.width"
LEAF = "organs.node.bears.0"
FRUIT = "organs.node.bears.2"
ERRORS: dict[str, tuple[str, Any, str]] = {
    "a fruit of a metre": (
        "organs.fruit.diameter",
        {"value_mm": 1000, "chosen": "test"},
        "fruit must be at most 600 mm wide",
    ),
    "unknown key": ("organs.node.girth", {"mean_mm": 1, "sd_mm": 0.1, "chosen": "x"}, "not a known key"),
    "angle for a length": (NODE, {"mean_deg": 16, "sd_deg": 2, "chosen": "x"}, "wrong unit"),
    "unit on a ratio": ("organs.fruit.taper", {"value_mm": 0.8, "chosen": "x"}, "wrong unit"),
    "no unit on a length": (NODE, {"value": 0.8, "chosen": "x"}, "wrong unit"),
    "no origin": (NODE, {"mean_mm": 16, "sd_mm": 2}, "needs a source"),
    "two distributions": (NODE, {"value_mm": 16, "mean_mm": 16, "chosen": "x"}, "only one of them"),
    "mean alone": (NODE, {"mean_mm": 16, "chosen": "x"}, "only one of them"),
    "an sd of 0": (NODE, {"mean_mm": 16, "sd_mm": 0, "chosen": "x"}, "for a constant use value_mm"),
    "bounds too narrow for the sd": (
        NODE, {"mean_mm": 16, "sd_mm": 2, "low_mm": 15, "high_mm": 17, "chosen": "x"}, "no normal"
    ),
    "negative lengths": (NODE, {"mean_mm": 16, "sd_mm": 20, "chosen": "x"}, "needs low_mm"),
    "a state beyond 1": ("organs.node.state", {"uniform": [0.5, 1.2], "chosen": "x"}, "from 0 to 1"),
    "text for a number": (NODE, {"value_mm": "16", "chosen": "x"}, "finite number"),
    "infinite": (NODE, {"value_mm": math.inf, "chosen": "x"}, "finite number"),
    "histogram that does not sum to 1": (
        f"{LEAF}.azimuth", {"histogram_deg": [[0, 180, 0.5], [180, 360, 0.49]], "chosen": "x"}, "sum to 0.99"
    ),
    "histogram with a negative weight": (
        f"{LEAF}.azimuth", {"histogram_deg": [[0, 180, 1.5], [180, 360, -0.5]], "chosen": "x"}, "at least 0"
    ),
    "histogram that overlaps": (
        f"{LEAF}.azimuth", {"histogram_deg": [[0, 180, 0.5], [170, 360, 0.5]], "chosen": "x"}, "overlap"
    ),
    "curve that does not reach the top": (
        NODE, {"along_mm": [[0, 16], [0.9, 12]], "chosen": "x"}, "ascend from 0"
    ),
    "height for a fixed value": (NODE, {"value_mm": 16, "with_height": 0.4, "chosen": "x"}, "needs a normal"),
    "height for what is drawn once": (
        "stem.diameter", {"mean_mm": 9, "sd_mm": 1, "with_height": 0.4, "chosen": "x"}, "once per plant"
    ),
    "perfect correlation": (
        NODE, {"mean_mm": 9, "sd_mm": 1, "with_height": 1.0, "chosen": "x"}, "less than 1"
    ),
    "negative probability": (f"{LEAF}.what", {"petiole": 1.2, "none": -0.2, "chosen": "x"}, "from 0 to 1"),
    "probabilities that do not sum to 1": (
        f"{LEAF}.what", {"petiole": 0.9, "none": 0.2, "chosen": "x"}, "sum to 1.1"
    ),
    "shares of residue that do not sum to 1": (
        "organs.lamina.residue_shares", {"dust": 0.5, "spray": 0.1, "mildew": 0.1}, "sum to 0.7"
    ),
    "a kind that is not there": (f"{LEAF}.what", {"petiol": 1, "none": 0, "chosen": "x"}, "of the organs"),
    "a stem on a node": (f"{LEAF}.what", {"internode": 1, "chosen": "x"}, "only the stem"),
    "thirteen": ("organs.side_shoot.bears.0.count", {"thirteen": 1, "chosen": "x"}, "one of one, two"),
    "one slot without its list": ("organs.node.bears", {"name": "leaf"}, "must be a list"),
    "a number for a scan": ("organs.fruit.scan", 3, "must be a path"),
    "a weight without a scan": ("organs.fruit.scan_weights", [1.0], "one weight for each scan: 0, not 1"),
    "an unknown unit of a scan": ("organs.fruit.scan_unit", "km", "must be 'm', 'cm', 'mm' or 'in'"),
    "a word for the colour of a scan": ("organs.fruit.scan_colour", "red", "scan_colour"),
    "a misspelt kind": ("organs.friut", {"calyx": False}, "no kind of this name is inherited"),
    "six lobes": ("organs.fruit.lobes", {"six": 1, "chosen": "x"}, "one of two, three, four, five"),
    "flush too strong": (
        f"{FRUIT}.flush.strength", {"value": 0.99, "chosen": "x"}, "at most 1"
    ),
    "descent of a kind that does not grow": (f"{FRUIT}.descent.of", "petiole", "one of the kinds"),
    "ripe fraction above 1": ("organs.fruit.ripe_descent", {"value": 0.6, "chosen": "x"}, "within [0, 1]"),
    "no such form": ("organs.node.form", "knot", "must be one of internode"),
    "a stem of nodes": ("stem.internode", "node", "of the form internode"),
    "no such surface": ("organs.petiole.surface", "bark", "one of the pigments"),
    "a slot on a blade": (
        "organs.lamina.bears", [{"name": "a", "what": {"cut": 1, "chosen": "x"}}], "bears nothing"
    ),
    "no azimuth on a node": (f"{FRUIT}.azimuth", None, "required but missing"),
    "an azimuth on a shoot": (
        "organs.side_shoot.bears.0.azimuth", {"value_deg": 0, "chosen": "x"}, "only nodes have"
    ),
    "a place on a node": (f"{LEAF}.at", [0.5], "no node has"),
    "after a later slot": (f"{LEAF}.after", "fruit", "a slot before this one"),
    "two slots of a name": (f"{FRUIT}.name", "leaf", "must be unique"),
    "endless shoots": ("organs.side_shoot.depth", None, "can follow itself"),
    "an organ called none": ("organs.none", {"like": "cut"}, "another name"),
    "like an unknown kind": ("organs.shoot_petiole.like", "stalk", "another of the organs"),
    "like itself": ("organs.shoot_petiole.like", "shoot_petiole", "not form a cycle"),
    "knots that do not ascend": ("pigments.fruit.path", Ellipsis, "must ascend"),
}  # fmt: skip


def put(table: Any, name: str, value: Any) -> None:
    *above, key = name.split(".")
    for part in above:
        table = table[int(part)] if isinstance(table, list) else table.setdefault(part, {})
    if value is Ellipsis:
        table[key].reverse()
    elif value is None:
        del table[key]
    else:
        table[key] = value


@pytest.mark.parametrize("error", ERRORS)
def test_errors_name_the_key(table: dict[str, Any], tmp_path: Path, error: str) -> None:
    name, value, allowed = ERRORS[error]
    put(table, name, value)
    with pytest.raises(InputError) as caught:
        load(table, tmp_path)
    message = str(caught.value)
    assert allowed in message
    assert "\n" not in message
    # The key is that of the value, or of the table with two incompatible keys.
    assert name.startswith(caught.value.key) or caught.value.key.startswith(name)
    assert caught.value.key.count(".") >= 1
    assert "plant.toml" in message


@pytest.mark.parametrize("name", ["organs.node.width", f"{LEAF}.what", "pigments.leaf.ior", "name"])
def test_raises_on_missing_keys(table: dict[str, Any], tmp_path: Path, name: str) -> None:
    put(table, name, None)
    with pytest.raises(InputError, match="required but missing") as caught:
        load(table, tmp_path)
    assert caught.value.key == name


CHANGES: list[Callable[[dict[str, Any]], object]] = [
    lambda t: t["organs"].clear(),
    lambda t: t.update(organs=[1, 2]),
    lambda t: t.update(organs={"node": 3}),
    lambda t: t["organs"]["node"].update(bears="leaf"),
    lambda t: t["organs"]["node"].update(bears=[3]),
    lambda t: t["organs"]["node"].update(form=["node"]),
    lambda t: t["organs"]["node"].update(like=7),
    lambda t: t["organs"]["node"]["bears"][0].update(what=[1]),
    lambda t: t["organs"]["node"]["bears"][0].update(what={"petiole": True}),
    lambda t: t["organs"].update({"a b": t["organs"]["cut"]}),
    lambda t: t["organs"].update({"calyx": t["organs"]["cut"]}),
    lambda t: t.update(pigments=5),
    lambda t: t["pigments"].pop("calyx"),
    lambda t: t.update(stem=0),
    lambda t: t["stem"].update(parts=0),
    lambda t: t.update(date="spring"),
]


@pytest.mark.parametrize("change", range(len(CHANGES)))
def test_raises_on_malformed_tables(table: dict[str, Any], tmp_path: Path, change: int) -> None:
    CHANGES[change](table)
    with pytest.raises(InputError, match=r"plant\.toml"):
        load(table, tmp_path)
