"""The table of absorbed light against pixels: python benchmarks/absorbed_pixels.py

The light of each organ in the table is compared with the integral of the pixel output `absorbed` over views
all round. Each pixel stands for the surface at its centre: its value over the number of pixels per area,
of all views that see this place. So the integral is that over all places that some view sees. The rest of an
organ is inside of others, as the end of a petiole in the stem, or in narrow gaps.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace

import numpy as np

import pepperscene as ps
from pepperscene.building.scenes.light_tables import lit_scene
from pepperscene.render import Renderer

_SAME_M = 1e-5  # chosen: a ray that ends so near to a place has reached it; twigs are 0.5 mm thick


def directions(count: int) -> np.ndarray:
    """`(count, 3)` evenly spread over the sphere."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * np.pi * (1.0 + np.sqrt(5.0))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)


def pixels_per_area(
    renderer: Renderer, camera: ps.Camera, places: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """`(n,)` pixels of a view per m2 of the surface at places `(n, 3)`; 0 where it does not see them."""
    origin = camera.pose[:3, 3]
    ray = places - origin
    distance = np.linalg.norm(ray, axis=1)
    ray /= distance[:, None]
    first, _ = renderer.cast_rays(origin, ray)
    x, y, z = (ray @ camera.pose[:3, :3] @ camera.intrinsics.T).T
    is_inside = (z > 0) & (abs(x / z * 2 - camera.width) < camera.width)
    is_inside &= abs(y / z * 2 - camera.height) < camera.height
    per_steradian = camera.intrinsics[0, 0] * camera.intrinsics[1, 1] / z**3
    density = per_steradian * np.abs((ray * normals).sum(axis=1)) / distance**2
    return np.where(is_inside & (np.abs(first - distance) < _SAME_M), density, 0.0)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", default="barth2018", help="its first frame is used")
    parser.add_argument("--plants", type=int, default=1, help="in the front row; there is no back row")
    parser.add_argument("--views", type=int, default=64)
    parser.add_argument("--size", type=int, default=500, help="pixels of a side of each view")
    parser.add_argument("--target-error", type=float, default=0.01)
    options = parser.parse_args()

    changes = {"row.plants_front": options.plants, "row.plants_back": 0}
    changes |= {"camera.sensor": "generic_rgb", "camera.lens": "none", "camera.hfov_deg": 45}
    changes |= {"camera.width": options.size, "camera.height": options.size}
    frames = ps.FrameRenderer(ps.load_recipe(options.recipe, changes))
    spec = frames.recipe.plan.frame(0)
    scene, camera = lit_scene(frames, spec, (300.0, 1100.0)), frames.camera(spec, traced=False)
    mesh, tracer = scene.mesh, ps.LightTracer(scene, ["par"])
    light = tracer.trace(target_error=options.target_error)
    organs = light.instances

    own = np.isin(mesh.face_instance, organs)
    corners = mesh.vertices[np.unique(mesh.faces[own])]
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre, distance = (low + high) / 2.0, 1.25 * np.linalg.norm(high - low)
    views = [
        replace(camera, pose=ps.look_at(centre + distance * direction, centre))
        for direction in directions(options.views)
    ]
    renderer, parts = Renderer(scene), []
    for seed, view in enumerate(views):
        frame = renderer.render(view, ["absorbed", "instance", "position"], seed=seed)
        hit = np.isin(frame["instance"], organs + 1)
        parts.append(
            (frame["instance"][hit] - 1, frame["position"][hit].astype(float), frame["absorbed"][hit])
        )
        origin = view.pose[:3, 3]
        _, face = renderer.cast_rays(origin, parts[-1][1] - origin)
        sides = mesh.vertices[mesh.faces[face]].astype(float)
        normal = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
        parts[-1] += (normal / np.linalg.norm(normal, axis=1)[:, None],)
    instance, places, values, normals = (np.concatenate(part) for part in zip(*parts, strict=True))
    density = sum(pixels_per_area(renderer, view, places, normals) for view in views)
    is_clear = density > 0.0  # but for a few on edges
    owner = np.searchsorted(organs, instance[is_clear])
    area = np.bincount(owner, 1.0 / density[is_clear], len(organs))
    by_pixels = np.bincount(owner, values[is_clear] / density[is_clear], len(organs))  # W
    share = area / light.area_m2
    table, error = light.amounts.watts[0], light.amounts.watts_error[0]

    kinds = defaultdict(list)
    for k, number in enumerate(organs):
        kinds[mesh.instances[number].kind].append(k)
    print(f"{len(organs)} organs, {len(values):,} pixels of {options.views} views")
    print("kind          organs  area seen   W of the table   by pixels   difference   standard error")
    for kind, members in sorted(kinds.items()):
        total, other = table[members].sum(), by_pixels[members].sum()
        seen_area = np.average(share[members], weights=light.area_m2[members])
        spread = np.sqrt((error[members] ** 2).sum()) / total
        print(
            f"{kind:<14}{len(members):>6}{seen_area:>11.1%}{total:>17.4f}{other:>12.4f}"
            f"{other / total - 1.0:>+13.2%}{spread:>17.2%}"
        )


if __name__ == "__main__":
    main()
