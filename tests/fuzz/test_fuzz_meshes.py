"""Changed copies of mesh files: each is one closed fruit, or refused in one sentence."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from fuzzing import EXAMPLES, attempt_file
from malformed_scans import png, textured

from pepperscene.geometry.fruit import scan as scans

BALL = trimesh.creation.icosphere(subdivisions=1, radius=30.0)
FILES = {
    "obj": BALL.export(file_type="obj").encode(),
    "text.ply": BALL.export(file_type="ply", encoding="ascii"),
    "binary.ply": BALL.export(file_type="ply"),
    "text.stl": BALL.export(file_type="stl_ascii").encode(),
    "binary.stl": BALL.export(file_type="stl"),
    "textured.glb": textured(png(2, 2, bytes([0, *6 * [200], 0, *6 * [90]]))),
}


def read(path):
    # Two changes within the resolution of the file system's times would be one for the cache.
    scans._load.cache_clear()
    scan = scans.load_scan(path, colour="textured" in path.name)
    assert np.isfinite(scan.points).all()
    assert np.isfinite(scan.normals).all()
    assert np.isfinite(scan.uv).all()
    assert scan.faces.max() < len(scan.points)


@EXAMPLES
@pytest.mark.parametrize("name", FILES)
def test_scan(examples, tmp_path, name):
    attempt_file(examples, tmp_path / f"fruit.{name}", [FILES[name]], read)
