"""Meshes of plants are identical in all processes: data sets are built on many machines."""

import hashlib

import numpy as np
from processes import run_python

from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow


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
