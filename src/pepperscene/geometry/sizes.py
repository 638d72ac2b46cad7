"""Areas, volumes, centres and tilts of organs, from their triangles, of all organs of a plant together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepperscene.geometry.mesh import FloatArray, IndexArray, Mesh


@dataclass(frozen=True, eq=False)
class OrganSizes:
    """Sizes of n instances of a mesh; 0, and nan for centres and tilts, of those without triangles.

    Attributes:
        area_m2: `(n,)` of all triangles: of a blade, which is a single sheet, its one-sided area.
        volume_m3: `(n,)` enclosed by the triangles; it has no meaning for a sheet.
        surface_centre_m: `(n, 3)` centroid of the surface.
        body_centre_m: `(n, 3)` centroid of the enclosed body.
        tilt_rad: `(n,)` mean angle of the triangles to the horizontal, weighted by area, 0 to pi / 2.
        top_m: `(n,)` z of the highest corner; -inf without triangles.
    """

    area_m2: FloatArray
    volume_m3: FloatArray
    surface_centre_m: FloatArray
    body_centre_m: FloatArray
    tilt_rad: FloatArray
    top_m: FloatArray


def organ_sizes(mesh: Mesh, instances: IndexArray) -> OrganSizes:
    """Measure some instances `(n,)` of a mesh."""
    rows, owner = mesh.face_runs.rows_of(instances)
    corners = mesh.vertices[mesh.faces[rows]].astype(float)

    def total(values: FloatArray) -> FloatArray:
        """Sums `(n,)` or `(n, k)` over the triangles of each instance."""
        columns = values.reshape(len(values), -1).T
        sums = [np.bincount(owner, column, len(instances)) for column in columns]
        return np.asarray(np.stack(sums, axis=-1).reshape(len(instances), *values.shape[1:]), dtype=float)

    # Twice the area along the normal.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    area = 0.5 * double
    tilt = np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), np.abs(normal[:, 2]))
    areas = total(area)
    with np.errstate(invalid="ignore", divide="ignore"):
        centre = total(area[:, None] * corners.mean(axis=1)) / areas[:, None]
        mean_tilt = total(area * tilt) / areas
        # The tetrahedra between the triangles and a point in the middle, where rounding is least.
        offset = corners - centre[owner][:, None]
        volume = np.einsum("nj,nj->n", offset[:, 0], np.cross(offset[:, 1], offset[:, 2])) / 6.0
        volumes = total(volume)
        body = centre + total(volume[:, None] * offset.sum(axis=1) / 4.0) / volumes[:, None]
    top = np.full(len(instances), -np.inf)
    np.maximum.at(top, owner, corners[..., 2].max(axis=1, initial=-np.inf))
    return OrganSizes(areas, volumes, centre, body, mean_tilt, top)
