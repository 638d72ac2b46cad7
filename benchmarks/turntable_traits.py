"""Leaf area of a plant on a turntable, measured from the points of its views, against its true leaf area.

    pepperscene build turntable --out out/turntable --quality draft --outputs colour,class,instance,distance
    pepperscene export out/turntable --format ply --out out/turntable_points
    python benchmarks/turntable_traits.py out/turntable_points [--recipe turntable]

Points of all views of a leaf are one sheet, whichever side they show. It is cut into patches that are nearly
flat. Their points are triangulated in the plane of the patch (Delaunay, SciPy), without triangles that bridge
gaps, and the areas of the triangles in space are summed. Only reading the truth needs this package.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

TYPES = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}
LEAF = 1
"""Class of leaf blades."""


def read_points(file: Path) -> np.ndarray:
    """The vertices of a binary PLY file."""
    header, _, body = file.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in header.decode().splitlines()]
    return np.frombuffer(body, [(line[2], TYPES[line[1]]) for line in lines if line[0] == "property"])


def thinned(points: np.ndarray, voxel_m: float) -> np.ndarray:
    """One of the points of each voxel."""
    _, chosen = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(chosen)]


def sheet_area(points: np.ndarray, patch_m: float, gap_m: float) -> float:
    """Area of a thin sheet of points `(n, 3)`, m2."""
    # Middles of patches: the means of the points in large voxels.
    cells = np.floor(points / patch_m).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.ravel()
    sums = np.stack([np.bincount(cell, column) for column in points.T], axis=1)
    middles = sums / np.bincount(cell)[:, None]
    tree, nearest = cKDTree(points), cKDTree(middles)
    total = 0.0
    for number, middle in enumerate(middles):
        # With a margin, so that triangles across the borders of patches are made by both and counted by one.
        near = points[tree.query_ball_point(middle, 1.2 * patch_m)]
        if len(near) < 4:
            continue
        axes = np.linalg.svd(near - near.mean(0), full_matrices=False)[2]
        try:
            corners = near[Delaunay(near @ axes[:2].T).simplices]
        except QhullError:
            continue
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        belongs = nearest.query(corners.mean(1))[1] == number
        kept = corners[belongs & (edges.max(1) < gap_m)]
        cross = np.cross(kept[:, 1] - kept[:, 0], kept[:, 2] - kept[:, 0])
        total += float(np.linalg.norm(cross, axis=1).sum()) / 2.0
    return total


def main() -> None:
    """Print the areas."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("export", type=Path)
    parser.add_argument("--recipe", default="turntable")
    parser.add_argument("--voxel-mm", type=float, default=0.5)
    parser.add_argument("--patch-mm", type=float, default=8.0)
    parser.add_argument("--gap-mm", type=float, default=3.0)
    options = parser.parse_args()
    files = sorted((options.export / "points").glob("*.ply"))
    vertices = np.concatenate([cloud[cloud["class"] == LEAF] for cloud in map(read_points, files)])
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(float)
    area = 0.0
    for leaf in np.unique(vertices["instance"]):
        sheet = thinned(points[vertices["instance"] == leaf], 1e-3 * options.voxel_mm)
        area += sheet_area(sheet, 1e-3 * options.patch_mm, 1e-3 * options.gap_mm)

    import pepperscene as ps

    true = ps.plant_traits(options.recipe).plants["leaf_area_m2"][0].as_py()
    print(f"{len(files)} views, {len(points)} points of leaves: {1e4 * area:.1f} cm2")
    print(f"true leaf area: {1e4 * true:.1f} cm2; error {100 * (area / true - 1):+.1f} %")


if __name__ == "__main__":
    main()
