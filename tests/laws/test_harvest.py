"""The harvest truth of each fruit against an independent ray caster and its own triangles.

Rays of trimesh through the pixels' centres hit the isolated fruit where the amodal mask is, and in the
complete scene where it is visible; the cut goes through the middle of the stalk's triangles; the attachment
is on the parent organ. Casters may disagree where an outline passes a pixel's centre: one in 500 is allowed.
"""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation, binary_erosion
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, Distortion
from pepperscene.classes import OrganClass
from pepperscene.geometry import Mesh
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer
from pepperscene.truth.encodings import decode_rle

CROPS = ("kaite", "red_blocky", "tomato", "orange_pointed")
DISTORTION = Distortion(k1=-0.1, k2=0.04, p1=1e-3, p2=-1e-3)


@dataclass
class View:
    """A small row, a camera in front of it, and the rendered truth."""

    mesh: Mesh
    camera: Camera
    instance: np.ndarray
    distance: np.ndarray
    harvest: dict

    def rays(self, row, column):
        """Origins and unit directions through the centres of pixels."""
        directions = self.camera.pixel_directions()[row, column] @ self.camera.pose[:3, :3].T
        return np.tile(self.camera.pose[:3, 3], (len(directions), 1)), directions

    def body(self, value):
        """The triangles of one value of the instance image."""
        part = self.mesh.select_instances([value - 1])
        # Merge coincident vertices, so that a section is a closed ring.
        return trimesh.Trimesh(part.vertices, part.faces, process=True)

    @cached_property
    def extents(self):
        """Least and greatest pixel coordinates `(f, 2)` and depths `(f,)` of each face."""
        camera, faces = self.camera, self.mesh.faces
        pixels = camera.project(self.mesh.vertices)
        depth = (self.mesh.vertices - camera.pose[:3, 3]) @ camera.pose[:3, 2]
        # Points that cannot be projected may be anywhere.
        known = np.isfinite(pixels).all(axis=1)[:, None]
        low, high = (np.where(known, pixels, limit)[faces] for limit in (-np.inf, np.inf))
        return low.min(axis=1), high.max(axis=1), depth[faces].min(axis=1), depth[faces].max(axis=1)


def render_view(crop, seed, step, front=3, back=2):
    changes = {"cultivar": crop, "seed": seed, "row.plants_front": front, "row.plants_back": back}
    recipe = load_recipe("barth2018", changes)
    frames, spec = FrameRenderer(recipe), recipe.plan.frame(step)
    scene, camera = frames.scene(spec, traced=False), frames.camera(spec)
    # The paper's field of view with a quarter of the pixels.
    lens = replace(camera.lens, focal_length_m=0.5 * camera.lens.focal_length_m, distortion=DISTORTION)
    camera = replace(camera, lens=lens, sensor=replace(camera.sensor, columns=400, rows=300))
    frame = Renderer(scene).render(camera, ["instance", "distance", "harvest"])
    return View(scene.mesh, camera, frame["instance"], frame["distance"], frame["harvest"])


def faces_in_box(view, box, max_depth_m):
    """Faces of the scene that rays through the pixels of a box may hit up to a depth."""
    low, high, nearest, farthest = view.extents
    x0, y0, x1, y1 = box
    near = (nearest < max_depth_m) & (farthest > 0.0)
    inside = (low < [x1 + 2, y1 + 2]).all(axis=1) & (high > [x0 - 2, y0 - 2]).all(axis=1)
    return np.flatnonzero(near & inside)


def edge(mask):
    """The pixels on either side of a mask's outline."""
    padded = np.pad(mask, 1)
    return (binary_dilation(padded) & ~binary_erosion(padded))[1:-1, 1:-1]


def compare(view, fruit, most=None):
    """Check one fruit; return counts of disagreeing pixels.

    Args:
        view: that contains it.
        fruit: its harvest truth.
        most: number of random pixels to cast; None for all.
    """
    value, stalk = fruit["instance"], fruit["peduncle"]
    mask = decode_rle(fruit["amodal"])
    assert mask.sum() == fruit["amodal_pixels"]
    rows, columns = np.nonzero(mask)
    x0, y0, x1, y1 = fruit["amodal_box"]
    assert [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1] == [x0, y0, x1, y1]
    assert (view.instance == value)[mask].sum() == fruit["visible_pixels"] == (view.instance == value).sum()
    assert fruit["visible_fraction"] == pytest.approx(fruit["visible_pixels"] / len(rows), abs=1e-6)
    occluders = Counter({item["instance"]: item["pixels"] for item in fruit["occluders"]})
    assert occluders == Counter(view.instance[mask & (view.instance != value)].tolist())

    # The isolated fruit, in its box and around it.
    alone, rng = view.body(value), np.random.default_rng(value)
    box = np.mgrid[max(y0 - 4, 0) : min(y1 + 4, 300), max(x0 - 4, 0) : min(x1 + 4, 400)].reshape(2, -1)
    row, column = rng.permutation(box, axis=1)[:, :most]
    hit = RayMeshIntersector(alone).intersects_any(*view.rays(row, column))
    amodal_off = hit != mask[row, column]
    assert not amodal_off[~edge(mask)[row, column]].any()

    # The fruit in the scene: first hits through the pixels of its mask.
    deepest = ((alone.vertices - view.camera.pose[:3, 3]) @ view.camera.pose[:3, 2]).max()
    faces = faces_in_box(view, fruit["amodal_box"], deepest)
    caster = RayMeshIntersector(trimesh.Trimesh(view.mesh.vertices, view.mesh.faces[faces], process=False))
    rows, columns = rng.permutation(np.stack([rows, columns]), axis=1)[:, :most]
    first = np.zeros(len(rows), dtype=int)
    for begin in range(0, len(rows), 200):  # in small batches: each ray has many candidates
        part = slice(begin, begin + 200)
        hits, ray = caster.intersects_id(*view.rays(rows[part], columns[part]), multiple_hits=False)
        first[begin + ray] = view.mesh.face_instance[faces[hits]] + 1
    visible_off = first != view.instance[rows, columns]
    if most is None:
        assert abs((first == value).mean() - fruit["visible_fraction"]) < 0.01
    assert_pose_and_box(view, fruit, alone)
    if stalk is not None:
        assert_cut_and_attachment(view, stalk)
    return {
        "outline": edge(mask)[row, column].sum(),
        "amodal_off": amodal_off.sum(),
        "visible_off": visible_off.sum(),
        "stalks": stalk is not None,
    }


def assert_pose_and_box(view, fruit, alone):
    """They equal those of its triangles."""
    to_world = view.camera.pose @ np.array(fruit["pose"])
    local = (alone.vertices - to_world[:3, 3]) @ to_world[:3, :3]
    box = fruit["box_3d"]
    np.testing.assert_allclose(box["rotation"], np.array(fruit["pose"])[:3, :3])
    centre = np.linalg.inv(np.array(fruit["pose"])) @ [*box["centre"], 1.0]
    for sign, end in ((-0.5, local.min(axis=0)), (0.5, local.max(axis=0))):
        np.testing.assert_allclose(centre[:3] + sign * np.array(box["size"]), end, atol=5e-6)
    # It starts at the origin and points along z.
    skin = view.mesh.face_instance == fruit["instance"] - 1
    used = np.unique(view.mesh.faces[skin])
    pole = view.mesh.vertices[used[view.mesh.uv[used, 1].argmin()]]
    assert np.linalg.norm(pole - to_world[:3, 3]) < 0.15 * fruit["diameter_m"]
    assert 0.5 * fruit["length_m"] < local[:, 2].max() < 1.3 * fruit["length_m"]


def assert_cut_and_attachment(view, stalk):
    """The cut goes through the middle of the stalk; the attachment is on its parent."""
    body, cut = view.body(stalk["instance"]), stalk["cut"]
    assert view.mesh.instances[stalk["instance"] - 1].organ_class == OrganClass.PEDUNCLE
    point = np.array(cut["world_m"])
    tangent = view.camera.pose[:3, :3] @ cut["tangent"]
    section = trimesh.intersections.mesh_plane(body, tangent, point).reshape(-1, 3)
    # A bent stalk may cross the plane again, farther away.
    section = section[np.linalg.norm(section - point, axis=1) < 2.5 * stalk["radius_m"]]
    assert np.linalg.norm(centroid(section, tangent) - point) < 0.3e-3
    parent = view.mesh.instances[stalk["instance"] - 1].parent + 1
    attachment = np.array(stalk["attachment"]["world_m"])
    distance = trimesh.proximity.closest_point(view.body(parent), [attachment])[1][0]
    radius = 0.5 * np.sort(view.body(parent).bounding_box_oriented.primitive.extents)[1]
    assert distance < 0.5 * radius
    # Visibility of both points by the other caster.
    for landmark, own in ((stalk["attachment"], {stalk["instance"], parent}), (cut, {stalk["instance"]})):
        pixel = view.camera.project(landmark["world_m"])[0]
        inside = bool((pixel >= 0).all() and (pixel < [400, 300]).all())
        assert (landmark["px"] is not None) == inside
        if not inside:
            assert not landmark["visible"]
            continue
        # A micrometre is a hundredth of a pixel at most.
        np.testing.assert_allclose(landmark["px"], pixel, atol=0.01)
        column, row = (int(value) for value in pixel)
        faces = faces_in_box(view, (column, row, column + 1, row + 1), landmark["camera_m"][2])
        triangles = trimesh.Trimesh(view.mesh.vertices, view.mesh.faces[faces], process=False)
        hits, _, hit_faces = RayMeshIntersector(triangles).intersects_location(*view.rays([row], [column]))
        if not len(hits):
            assert not landmark["visible"]
            continue
        distance = np.linalg.norm(hits - view.camera.pose[:3, 3], axis=1)
        nearest = distance.argmin()
        instance = int(view.mesh.face_instance[faces[hit_faces[nearest]]]) + 1
        close = abs(distance[nearest] - np.linalg.norm(landmark["camera_m"])) < 3.0 * stalk["radius_m"]
        if abs(distance[nearest] - view.distance[row, column]) < 1e-4:
            assert landmark["visible"] == (instance in own and bool(close))


def centroid(points, normal):
    """The centroid of the area inside a ring of points in a plane, which goes once around their mean."""
    mean = points.mean(axis=0)
    x = np.cross(normal, points[0] - mean)
    y = np.cross(normal, x)
    ring = points[np.argsort(np.arctan2((points - mean) @ y, (points - mean) @ x))] - mean
    following = np.roll(ring, -1, axis=0)
    area = np.cross(ring, following) @ normal
    return mean + area @ (ring + following) / (3.0 * area.sum())


FEW = (("kaite", 1, 110, 2, 1), ("tomato", 2, 40, 1, 0))
LONG_FRUIT = (("cucumber", 1, 30, 1, 0),)
MANY = tuple(
    (crop, 10 * seed + number, step)
    for number, crop in enumerate(CROPS)
    for seed, step in ((1, 30), (2, 125), (3, 210))
)


@pytest.mark.parametrize(
    ("views", "count", "most", "seed"),
    [
        pytest.param(FEW, 8, 80, 5, id="few"),
        pytest.param(LONG_FRUIT, 4, 60, 7, marks=pytest.mark.long, id="long fruit"),
        pytest.param(MANY, 40, None, 6, marks=pytest.mark.long, id="many"),
    ],
)
def test_harvest_truth_equals_that_of_another_ray_caster(views, count, most, seed):
    rendered = [render_view(*view) for view in views]
    fruit = [(view, f) for view in rendered for f in view.harvest["fruit"] if f["amodal_pixels"] >= 20]
    chosen = np.random.default_rng(seed).permutation(len(fruit))[:count]
    assert len(chosen) == count
    results = [compare(*fruit[index], most) for index in chosen]
    total = {name: sum(result[name] for result in results) for name in results[0]}
    assert total["amodal_off"] <= 0.002 * total["outline"]
    assert total["visible_off"] <= 0.002 * total["outline"]
    assert total["stalks"] > 0.9 * count
