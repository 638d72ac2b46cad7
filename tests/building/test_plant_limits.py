"""Cultivars whose plants do not fit into memory are refused before a plant is built, whatever multiplies."""

from __future__ import annotations

import os
import resource
import subprocess
import sys

import numpy as np
import pytest
from stand_in import PYTHONPATH

from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.execution.memory import MEMORY
from pepperscene.building.execution.memory_check import check_memory
from pepperscene.building.scenes.plant_size import plant_triangles
from pepperscene.building.scenes.plants import grow_plant
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import InputError, SetupError
from pepperscene.geometry import mesh_plant
from pepperscene.geometry.triangle_counts import most_triangles
from pepperscene.grammar import build_plant, draw_parameters
from pepperscene.recipe.resolve.load import resolve_recipe

CHOSEN = 'chosen = "a test"'
SMALL = {"row.plants_front": 1, "row.plants_back": 0}


def bearing(kind, positions, count="twelve", **keys):
    """The changes of a recipe whose petioles bear organs of a kind, `count` at each of some positions."""
    slot = {
        "name": "many",
        "what": {kind: 1.0, "chosen": "a test"},
        "count": {count: 1.0, "chosen": "a test"},
    }
    slot |= {"at": np.linspace(0, 1, positions).tolist(), "spread": {"value_deg": 20.0, "chosen": "a test"}}
    return {"override": {"organs": {"petiole": {"bears": [slot | keys]}}}}


def shape(**values):
    """The changes of a recipe whose laminae have some plain numbers."""
    chosen = {name: {"value": number, "chosen": "a test"} for name, number in values.items()}
    return {"override": {"organs": {"lamina": chosen}}}


HUGE = {
    "laminae on stalks": bearing("lamina", 100),
    "stalks on stalks": bearing("pedicel", 50),
    "lobes": shape(lobes=100_000.0, lobe_depth=0.2),
}


@pytest.mark.parametrize("name", HUGE)
def test_a_build_is_refused_by_the_size_of_its_plants(name, tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "2 GB")
    resolved = resolve_recipe("demo", {**SMALL, **HUGE[name]})
    job = BuildJob.create(resolved, tmp_path / "set", ("class",), BuildOptions())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SetupError, match=r"demo: a frame of .* needs about .* GB of memory, and 2\.0 GB"):
        check_memory(job)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 400_000


@pytest.mark.parametrize("name", HUGE)
def test_a_scene_that_is_built_without_a_check_refuses_such_a_plant(name, monkeypatch):
    monkeypatch.setenv(MEMORY, "1 GB")
    resolved = resolve_recipe("demo", {**SMALL, **HUGE[name]})
    with pytest.raises(SetupError, match=r"a plant of .* organs and up to .* triangles needs about"):
        SceneBuilder(resolved.recipe, resolved.cultivar, processes=1).scene(0, 0)
    with pytest.raises(SetupError, match="let its organs bear fewer"):
        grow_plant(resolved.cultivar, 1)


def test_items_are_counted_before_they_are_drawn():
    # Most of them become nothing.
    changes = bearing("lamina", 30_000)
    slot = changes["override"]["organs"]["petiole"]["bears"][0]
    slot["what"] = {"lamina": 0.001, "none": 0.999, "chosen": "a test"}
    cultivar = resolve_recipe("demo", {**SMALL, **changes}).cultivar
    with pytest.raises(InputError, match=r"organs\.petiole\.bears\.\d: draws up to .* organs .* 2,000,000"):
        draw_parameters(cultivar, np.random.default_rng(1))


@pytest.mark.parametrize("cultivar", ["kaite", "tomato", "cucumber", "eggplant"])
@pytest.mark.parametrize("detail", [0.3, 1.0, 2.2])
def test_the_bound_of_triangles_holds_and_is_close(cultivar, detail):
    parameters = draw_parameters(load_cultivar(cultivar), np.random.default_rng(5))
    triangles = len(mesh_plant(build_plant(parameters), detail).faces)
    bound = most_triangles(parameters, detail)
    assert triangles <= bound
    assert detail < 1.0 or bound <= 1.3 * triangles


@pytest.mark.parametrize(
    "changes",
    [
        bearing("lamina", 5),
        bearing("pedicel", 3),
        bearing("fruit", 2, "two"),
        shape(lobes=40.0, lobe_depth=0.2),
        {
            "override": {
                "organs": {"lamina": {"palmate": True, "teeth": {"value": 400.0, "chosen": "a test"}}}
            }
        },
    ],
    ids=["laminae", "stalks", "fruit", "lobes", "teeth"],
)
def test_the_bound_holds_for_other_cultivars(changes):
    cultivar = resolve_recipe("demo", changes).cultivar
    parameters = draw_parameters(cultivar, np.random.default_rng(2))
    triangles = len(mesh_plant(build_plant(parameters)).faces)
    assert triangles <= most_triangles(parameters) <= 1.4 * triangles
    assert plant_triangles(cultivar, 1) > 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs `ulimit -v`")
def test_the_command_ends_in_one_sentence(tmp_path):
    kinds = ", ".join(f"{at / 300:.4f}" for at in range(301))
    slot = (
        f'{{name="m", what={{lamina=1.0, {CHOSEN}}}, count={{twelve=1.0, {CHOSEN}}}, at=[{kinds}], '
        f"spread={{value_deg=0.0, {CHOSEN}}}}}"
    )
    command = [
        sys.executable,
        "-m",
        "pepperscene",
        "render",
        "demo",
        "--out",
        tmp_path / "t",
        "--outputs",
        "class",
    ]
    command += ["--set", "row.plants_front=1", "--set", "row.plants_back=0"]
    command += ["--set", f"override.organs.petiole.bears=[{slot}]"]
    process = subprocess.run(
        ["sh", "-c", 'ulimit -v 4000000; exec "$0" "$@"', *map(str, command)],
        env={**os.environ, "PYTHONPATH": PYTHONPATH, MEMORY: "2 GB"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 2, process.stderr
    assert process.stderr.startswith("error: ")
    assert process.stderr.count("\n") == 1
    assert not (tmp_path / "t").exists()
