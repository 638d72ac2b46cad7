"""Meshes of plants are sound whatever the parameters, and the same wherever they are made.

Rationale: the grid of an organ is fit for its usual size and shape; a blade of 1 mm, a fruit of 300 mm,
laws of ten times the variance stretch it. A face without area has no normal, an open fruit no inside, and
a mesh that differs from machine to machine cannot be compared.

Set-up: Hypothesis changes shipped cultivars: stems of 1 to 200 parts, blades of 1 to 600 mm, fruit of 5 to
300 mm, the variance of every law nothing, as it is, or tenfold; details .3 to 2.

Expected: what every mesh of an organ must have (after Botsch et al. 2010, Polygon Mesh Processing, ch. 1):
finite, no face without area and no face twice, at most two faces at an edge, which run through it in opposite
directions, solids that are closed balls of a positive volume, and normals on the faces' side.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pepperscene.cultivar import Cultivar, Distribution, OrganModel, Stem, load_cultivar
from pepperscene.geometry import Mesh, mesh_plant
from pepperscene.grammar import grow

SHEETS = ("blade", "flower")
"""Forms that are single sheets; all others are closed."""

CAP = 0.012
"""Part of a tube's length in v that a cap takes."""

CHECKED = 60  # instances of a plant that trimesh looks at one by one


@dataclass(frozen=True)
class Changes:
    """What is extreme about a plant."""

    cultivar: str = "kaite"
    seed: int = 0
    parts: int = 3
    blade_mm: float = 130.0
    fruit_mm: float = 84.0
    variance: float = 1.0
    detail: float = 1.0
    young: int = 1


def changed(cultivar: Cultivar, to: Changes) -> Cultivar:
    """The cultivar with other means, and with laws of another variance that keep to what can be."""
    organs = {name: _organ(one, to) for name, one in cultivar.organs.items()}
    stem = {**_fields(cultivar.stem), "parts": to.parts, "young_nodes": min(to.young, to.parts)}
    stem |= {name: _spread(law, to.variance) for name, law in stem.items() if isinstance(law, Distribution)}
    return Cultivar(**{**_fields(cultivar), "stem": Stem(**stem), "organs": organs})


def _organ(one: OrganModel, to: Changes) -> OrganModel:
    laws = dict(one.distributions)
    if one.form == "blade":
        scale = to.blade_mm / 1e3 / laws["length"].mean
        small = ("length", "width", "margin_wave", "blister", "vein")
        laws |= {name: _scaled(laws[name], scale) for name in small}
    if one.form == "fruit":
        laws["diameter"] = _scaled(laws["diameter"], to.fruit_mm / 1e3 / laws["diameter"].mean)
    # Shares of ripe fruit hang together, and concern colours alone.
    kept = ("ripe_fraction", "ripe_descent", "breaker_fraction")
    spread = {name: law if name in kept else _spread(law, to.variance) for name, law in laws.items()}
    return type(one)(**{**_fields(one), **spread})


def _fields(model: object) -> dict[str, object]:
    return {name: getattr(model, name) for name in type(model).model_fields}  # type: ignore[attr-defined]


def _scaled(law: Distribution, by: float) -> Distribution:
    numbers = {name: by * getattr(law, name) for name in ("mean", "sd", "low", "high")}
    return Distribution(**{**_fields(law), **numbers})


def _spread(law: Distribution, variance: float) -> Distribution:
    """The law at so many times its variance: an even one, cut where lengths and ratios end."""
    if variance == 1.0 or law.sd == 0.0 or law.family == "curve":
        return law
    if variance == 0.0:
        return Distribution(family="value", mean=law.mean, sd=0.0, low=law.mean, high=law.mean, chosen="test")
    reach = np.sqrt(3.0 * variance) * law.sd
    low, high = law.mean - reach, law.mean + reach
    if law.low > 0.0 or (law.low == 0.0 and law.mean > 0.0):
        low = max(low, 0.02 * law.mean)
    if law.low >= 0.0 and law.high <= 1.0:
        high = min(high, 1.0)
    mean, sd = 0.5 * (low + high), (high - low) / np.sqrt(12.0)
    return Distribution(family="uniform", mean=mean, sd=sd, low=low, high=high, chosen="test")


CHANGES = st.builds(
    Changes,
    seed=st.integers(0, 2**63 - 1),
    parts=st.sampled_from([1, 1, 2, 3, 5]),
    blade_mm=st.sampled_from([1.0, 10.0, 130.0, 600.0]),
    fruit_mm=st.sampled_from([5.0, 84.0, 300.0]),
    variance=st.sampled_from([0.0, 1.0, 10.0]),
    detail=st.floats(0.3, 2.0),
    young=st.integers(0, 2),
)


@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@example(Changes(parts=200, detail=0.3))
@example(Changes(parts=200, blade_mm=1.0, detail=0.3, variance=10.0))
@example(Changes(parts=40, young=4, detail=1.0, variance=10.0))
@example(Changes(parts=40, young=4, detail=2.0, fruit_mm=300.0))
@example(Changes(parts=1, blade_mm=1.0, fruit_mm=300.0, detail=2.0))
@example(Changes(cultivar="tomato", parts=16, detail=0.5))
@example(Changes(cultivar="tomato", parts=16, detail=0.5, variance=10.0))
@example(Changes(cultivar="orange_pointed", parts=8, fruit_mm=300.0))
@given(CHANGES)
def test_meshes_are_sound(changes: Changes) -> None:
    cultivar = changed(load_cultivar(changes.cultivar), changes)
    plant = grow(cultivar, np.random.default_rng(changes.seed))
    assert len(plant.of_form("internode")) == changes.parts
    mesh = mesh_plant(plant, changes.detail)
    assert len(mesh.instances) == len(plant.organs)
    check_numbers(mesh)
    # Blades of ten times the variance fold over themselves.
    check_faces(mesh, creased=0.002 if changes.variance <= 1.0 else 0.02)
    sheets = [cultivar.kinds[one.kind].form in SHEETS for one in mesh.instances]
    chosen = np.unique(np.linspace(0, len(sheets) - 1, CHECKED).astype(int))
    for index in chosen:
        check_body(mesh, int(index), sheet=sheets[index])


def check_numbers(mesh: Mesh) -> None:
    """Everything is finite and in its range."""
    for name in ("vertices", "normals", "uv", "state"):
        assert np.isfinite(getattr(mesh, name)).all(), name
    assert 0.0 <= mesh.uv.min() <= mesh.uv.max() <= 1.0
    assert 0.0 <= mesh.state.min() <= mesh.state.max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
    assert set(np.unique(mesh.face_instance)) == set(range(len(mesh.instances)))


def check_faces(mesh: Mesh, creased: float) -> None:
    """No face without area, none twice, and the normals on their side."""
    corners = mesh.vertices.astype(float)[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(across, axis=1)
    flat = np.flatnonzero(~(area > 0.0))
    assert not len(flat), f"{len(flat)} faces without area, of {kinds_of(mesh, flat)}"
    once = {tuple(row) for row in np.sort(mesh.faces, axis=1).tolist()}
    assert len(once) == len(mesh.faces)
    # The normals of a face's corners point to its front. Caps lie inside what a tube joins, and are lit as if
    # it went on; a blade or a calyx may be creased so sharply that a small face is turned over.
    facing = np.einsum("fi,fci->fc", across / (2.0 * area[:, None]), mesh.normals.astype(float)[mesh.faces])
    height = mesh.uv[mesh.faces][..., 1]
    cap = (height.min(axis=1) < CAP) | (height.max(axis=1) > 1.0 - CAP)
    behind = np.flatnonzero((facing.sum(axis=1) <= 0.0) & ~cap)
    assert len(behind) <= creased * len(facing), f"{len(behind)} faces turned over, {kinds_of(mesh, behind)}"


def kinds_of(mesh: Mesh, faces: np.ndarray) -> set[str]:
    return {mesh.instances[index].kind for index in mesh.face_instance[faces]}


def check_body(mesh: Mesh, index: int, *, sheet: bool) -> None:
    """One organ as trimesh sees it, with the vertices of seams made one."""
    faces = mesh.faces[mesh.face_instance == index].astype(np.int64)
    first = faces.min()
    points, same = np.unique(mesh.vertices[first : faces.max() + 1], axis=0, return_inverse=True)
    body = trimesh.Trimesh(points, same.ravel()[faces - first], process=False, validate=False)
    kind = mesh.instances[index].kind
    assert body.is_winding_consistent, kind
    edges = np.sort(body.edges, axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert uses.max() <= 2, f"{kind}: an edge of {uses.max()} faces"
    if sheet:
        return
    assert body.body_count == 1, f"{kind}: {body.body_count} pieces"
    assert body.is_watertight, f"{kind}: open along {(uses == 1).sum()} edges"
    assert body.volume > 0.0, f"{kind}: inside out"
    assert body.euler_number == 2, f"{kind}: not a ball, Euler number {body.euler_number}"


# --- the same everywhere ----------------------------------------------------------------------------------


def digest(seed: int) -> str:
    """Of all arrays of a plant."""
    mesh = mesh_plant(grow(load_cultivar("kaite"), np.random.default_rng(seed)), 0.5)
    names = ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface")
    told = hashlib.sha256(repr((mesh.surfaces, mesh.instances)).encode())
    for name in names:
        array = getattr(mesh, name)
        told.update(str(array.dtype).encode() + np.ascontiguousarray(array).tobytes())
    return told.hexdigest()


def digests(seeds: list[int]) -> list[str]:
    return [digest(seed) for seed in seeds]


@pytest.fixture(scope="module")
def here() -> list[str]:
    return digests([3, 4])


@pytest.mark.parametrize(("hash_seed", "threads"), [("0", "1"), ("1", "2"), ("random", "4")])
def test_other_processes_make_the_same_vertices(here: list[str], hash_seed: str, threads: str) -> None:
    counts = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads)
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed, **counts}
    code = f"import sys; sys.path.insert(0, {os.path.dirname(__file__)!r}); import {__name__} as test; "
    # In the other order, so that nothing is carried from one plant to the next.
    code += "print(*test.digests([4, 3]))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == here[::-1]


def test_workers_make_the_same_vertices(here: list[str]) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(digest, [3, 4, 3, 4], chunksize=1) == here * 2


def test_another_seed_is_another_plant(here: list[str]) -> None:
    assert here[0] != here[1]
