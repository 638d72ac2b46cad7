"""Meshes of plants are valid for extreme parameters, and identical in all processes.

Hypothesis changes shipped cultivars: stems of 1 to 120 parts, blades of 1 to 600 mm, fruit of 5 to 300 mm,
all variances 0, unchanged or tenfold, details of .3 to 2. Expected, after Botsch et al. 2010, ch. 1: finite
values, no face without area or twice, at most two faces at an edge with opposite directions, closed solids of
positive volume with the topology of a ball, and normals on the front of the faces.
"""

import hashlib
from dataclasses import dataclass

import numpy as np
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from processes import run_python

from pepperscene.cultivar import Cultivar, Distribution, OrganModel, Stem, load_cultivar
from pepperscene.geometry import Mesh, mesh_plant
from pepperscene.grammar import grow

SHEETS = ("blade", "flower")  # forms that are single surfaces; all others are closed
CAP = 0.012  # length of a tube's cap in v
CHECKED = 60  # instances of a plant that trimesh checks one by one


@dataclass(frozen=True)
class Changes:
    """Changes of a cultivar, and how to grow and mesh it."""

    cultivar: str = "kaite"
    seed: int = 0
    parts: int = 3
    blade_mm: float = 130.0
    fruit_mm: float = 84.0
    variance: float = 1.0
    detail: float = 1.0
    young: int = 1


def change_cultivar(cultivar: Cultivar, changes: Changes) -> Cultivar:
    """The cultivar with other means and variances, within possible ranges."""
    organs = {name: _change_organ(organ, changes) for name, organ in cultivar.organs.items()}
    stem = _fields(cultivar.stem)
    stem |= {k: _widen(v, changes.variance) for k, v in stem.items() if isinstance(v, Distribution)}
    stem |= {"parts": changes.parts, "young_nodes": min(changes.young, changes.parts)}
    return Cultivar(**{**_fields(cultivar), "stem": Stem(**stem), "organs": organs})


def _change_organ(organ: OrganModel, changes: Changes) -> OrganModel:
    values = dict(organ.distributions)
    if organ.form == "blade":
        scale = changes.blade_mm / 1e3 / values["length"].mean
        lengths = ("length", "width", "margin_wave", "blister", "vein")
        values |= {name: _scale(values[name], scale) for name in lengths}
    if organ.form == "fruit":
        values["diameter"] = _scale(values["diameter"], changes.fruit_mm / 1e3 / values["diameter"].mean)
    # Fractions of ripe fruit depend on each other, and affect colours only.
    unchanged = ("ripe_fraction", "ripe_descent", "breaker_fraction")
    values |= {k: _widen(v, changes.variance) for k, v in values.items() if k not in unchanged}
    return type(organ)(**{**_fields(organ), **values})


def _fields(model: object) -> dict[str, object]:
    return {name: getattr(model, name) for name in type(model).model_fields}  # type: ignore[attr-defined]


def _scale(value: Distribution, factor: float) -> Distribution:
    numbers = {name: factor * getattr(value, name) for name in ("mean", "sd", "low", "high")}
    return Distribution(**{**_fields(value), **numbers})


def _widen(value: Distribution, factor: float) -> Distribution:
    """A uniform distribution of `factor` times the variance, clipped to possible lengths and ratios."""
    mean = value.mean
    if factor == 1.0 or value.sd == 0.0 or value.family == "curve":
        return value
    if factor == 0.0:
        return Distribution(family="value", mean=mean, sd=0.0, low=mean, high=mean, chosen="test")
    half_width = np.sqrt(3.0 * factor) * value.sd
    low, high = mean - half_width, mean + half_width
    if value.low > 0.0 or (value.low == 0.0 and mean > 0.0):
        low = max(low, 0.02 * mean)
    if value.low >= 0.0 and value.high <= 1.0:
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


@settings(max_examples=10)
@example(Changes(parts=120, blade_mm=1.0, detail=0.3, variance=10.0))
@example(Changes(parts=16, young=4, detail=2.0, fruit_mm=300.0))
@example(Changes(parts=1, blade_mm=1.0, fruit_mm=300.0, detail=2.0))
@example(Changes(cultivar="tomato", parts=16, detail=0.5, variance=10.0))
@example(Changes(cultivar="orange_pointed", parts=8, fruit_mm=300.0))
@given(CHANGES)
def test_meshes_are_valid(changes: Changes) -> None:
    cultivar = change_cultivar(load_cultivar(changes.cultivar), changes)
    plant = grow(cultivar, np.random.default_rng(changes.seed))
    assert len(plant.of_form("internode")) == changes.parts
    mesh = mesh_plant(plant, changes.detail)
    assert len(mesh.instances) == len(plant.organs)
    check_numbers(mesh)
    # Blades of ten times the variance fold over themselves.
    check_faces(mesh, creased=0.002 if changes.variance <= 1.0 else 0.02)
    sheets = [cultivar.kinds[instance.kind].form in SHEETS for instance in mesh.instances]
    chosen = np.unique(np.linspace(0, len(sheets) - 1, CHECKED).astype(int))
    for index in chosen:
        check_body(mesh, int(index), sheet=sheets[index])


def check_numbers(mesh: Mesh) -> None:
    """All values are finite and in their ranges."""
    for name in ("vertices", "normals", "uv", "state"):
        assert np.isfinite(getattr(mesh, name)).all(), name
    assert 0.0 <= mesh.uv.min() <= mesh.uv.max() <= 1.0
    assert 0.0 <= mesh.state.min() <= mesh.state.max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
    assert set(np.unique(mesh.face_instance)) == set(range(len(mesh.instances)))


def check_faces(mesh: Mesh, creased: float) -> None:
    """No face without area, no duplicates, and normals on the front."""
    corners = mesh.vertices.astype(float)[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    empty = np.flatnonzero(~(area > 0.0))
    assert not len(empty), f"{len(empty)} faces without area, of {kinds_of(mesh, empty)}"
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)
    # The normals of a face's corners point to its front. Caps are inside other organs and have the normals of
    # a longer tube; a blade or a calyx may be creased so sharply that a small face is inverted.
    cosine = np.einsum("fi,fci->fc", normal / (2.0 * area[:, None]), mesh.normals.astype(float)[mesh.faces])
    height = mesh.uv[mesh.faces][..., 1]
    cap = (height.min(axis=1) < CAP) | (height.max(axis=1) > 1.0 - CAP)
    inverted = np.flatnonzero((cosine.sum(axis=1) <= 0.0) & ~cap)
    assert len(inverted) <= creased * len(area), f"{len(inverted)} inverted, of {kinds_of(mesh, inverted)}"


def kinds_of(mesh: Mesh, faces: np.ndarray) -> set[str]:
    return {mesh.instances[index].kind for index in mesh.face_instance[faces]}


def check_body(mesh: Mesh, index: int, *, sheet: bool) -> None:
    """Check one organ with trimesh; the vertices of seams are merged."""
    faces = mesh.faces[mesh.face_instance == index].astype(np.int64)
    first = faces.min()
    points, merged = np.unique(mesh.vertices[first : faces.max() + 1], axis=0, return_inverse=True)
    body = trimesh.Trimesh(points, merged.ravel()[faces - first], process=False, validate=False)
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


def digest(seed: int) -> str:
    """Digest of all arrays of a plant."""
    mesh = mesh_plant(grow(load_cultivar("kaite"), np.random.default_rng(seed)), 0.5)
    names = ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface")
    result = hashlib.sha256(repr((mesh.surfaces, mesh.instances)).encode())
    for name in names:
        array = getattr(mesh, name)
        result.update(str(array.dtype).encode() + np.ascontiguousarray(array).tobytes())
    return result.hexdigest()


def test_other_processes_make_the_same_vertices() -> None:
    digests = [digest(3), digest(4)]
    assert digests[0] != digests[1]
    counts = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    # In reverse order, so that no state is carried over.
    code = "import json; from test_plant_meshes import digest; print(json.dumps([digest(4), digest(3)]))"
    assert run_python(code, PYTHONHASHSEED="1", **counts) == digests[::-1]
