"""The output `amodal`: masks of whole organs, of cards with closed forms and of one plant."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera, body, card, sphere
from greenhouse import camera, digests, short_plant
from scipy.ndimage import binary_dilation, binary_erosion
from test_kernel_reuse import count_compiled
from trimesh.ray.ray_triangle import RayMeshIntersector

from pepperscene.camera import Distortion, look_at
from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import concatenate_meshes, mesh_plant
from pepperscene.render import Renderer
from pepperscene.render.aov import isolated
from pepperscene.scene import assemble_scene, build_skeleton
from pepperscene.truth.encodings import decode_rle

OUTPUTS = ["instance", "harvest", "amodal"]
FOCAL_PX = 4.16e-3 / 9e-6  # of `axis_camera`
VIEW = axis_camera(64, 48, flash=False)


def amodal_of(mesh, view=VIEW):
    """Entries of the output by value, and the instance image."""
    frame = Renderer(assemble_scene(mesh)).render(view, ["instance", "amodal"])
    assert frame["amodal"]["format"] == "pepperscene amodal 1"
    return {entry["instance"]: entry for entry in frame["amodal"]["organs"]}, frame["instance"]


def pixels_card(x0, y0, x1, y1, z):
    """A card at a depth whose image is these columns and rows."""
    size = z / FOCAL_PX
    centre = (0.5 * (x0 + x1) - 32) * size, (0.5 * (y0 + y1) - 24) * size
    return card(*centre, (x1 - x0) * size, (y1 - y0) * size, "matt", z)


def test_card_behind_a_card_has_its_hidden_part():
    front, back = pixels_card(10, 10, 30, 30, 0.4), pixels_card(20, 5, 50, 40, 0.6)
    entries, instance = amodal_of(concatenate_meshes([front, back]))
    expected = np.zeros((48, 64), bool)
    expected[5:40, 20:50] = True
    np.testing.assert_array_equal(decode_rle(entries[2]["amodal"]), expected)
    hidden = 10 * 20
    assert entries[2] == {
        "instance": 2, "class": OrganClass.LEAF, "kind": "test body", "box": [20, 5, 50, 40],
        "amodal_box": [20, 5, 50, 40], "visible_pixels": 35 * 30 - hidden, "amodal_pixels": 35 * 30,
        "visible_fraction": pytest.approx(1 - hidden / (35 * 30), abs=1e-6), "truncated": False,
        "occluders": [{"instance": 1, "pixels": hidden}], "amodal": entries[2]["amodal"],
    }  # fmt: skip
    # Nothing is in front of the other one.
    np.testing.assert_array_equal(decode_rle(entries[1]["amodal"]), instance == 1)
    assert (entries[1]["visible_fraction"], entries[1]["occluders"]) == (1.0, [])


def test_hidden_part_at_the_border_counts_as_truncated():
    front, back = pixels_card(0, 0, 20, 48, 0.4), pixels_card(-5, 20, 30, 28, 0.6)
    entries, instance = amodal_of(concatenate_meshes([front, back]))
    assert not (instance[:, 0] == 2).any()
    assert entries[2]["truncated"]
    assert entries[2]["amodal_box"] == [0, 20, 30, 28]
    assert amodal_of(pixels_card(100, 0, 110, 10, 0.5))[0] == {}


def test_sphere_has_the_disc_of_a_sphere_from_before_and_from_inside():
    half = pixels_card(0, 0, 32, 48, 0.2)
    entries, _ = amodal_of(concatenate_meshes([half, sphere((0, 0, 0.5), 0.02, "m")]))
    # A sphere is seen up to the tangents from the projection centre.
    radius_px = FOCAL_PX * 0.02 / np.sqrt(0.5**2 - 0.02**2)
    y, x = np.mgrid[:48, :64] + 0.5
    outside = np.hypot(x - 32, y - 24) - radius_px
    mask = decode_rle(entries[2]["amodal"])
    clear = np.abs(outside) > 0.1
    np.testing.assert_array_equal(mask[clear], (outside < 0)[clear])
    assert entries[2]["visible_fraction"] == pytest.approx(0.5, abs=0.02)
    # From inside it is everywhere, although no vertex behind the camera has a pixel.
    entries, _ = amodal_of(sphere((0, 0, 0), 0.3, "matt"))
    assert (entries[1]["amodal_pixels"], entries[1]["visible_fraction"]) == (48 * 64, 1.0)


def test_only_visible_organs_are_listed():
    cards = [pixels_card(5 * k, 5, 5 * k + 4, 20, 0.5) for k in range(5)]
    hidden = pixels_card(1, 6, 3, 10, 0.6)
    instances = [
        Instance(OrganClass.STEM, "internode"), Instance(OrganClass.BACKGROUND, "gutter"),
        Instance(OrganClass.LEAF, "lamina", ignored=True), Instance(OrganClass.CUT, "scar"),
        Instance(OrganClass.WIRE, "crop_wire"),
    ]  # fmt: skip
    meshes = [replace(mesh, instances=(item,)) for mesh, item in zip(cards, instances, strict=True)]
    entries, _ = amodal_of(concatenate_meshes([*meshes, hidden]))
    found = {value: (entry["class"], entry["kind"]) for value, entry in entries.items()}
    assert found == {1: (4, "internode"), 4: (7, "scar"), 5: (6, "crop_wire")}


@pytest.mark.parametrize("limit", ["_BATCH", "_PROJECTED", "_MOST_KEPT"])
def test_many_organs_are_divided(limit, monkeypatch):
    cards = [pixels_card(8 * k, 0, 8 * k + 16, 48, 0.3 + 0.05 * k) for k in range(6)]
    scene = assemble_scene(concatenate_meshes(cards))
    views = [VIEW, replace(VIEW, sensor=replace(VIEW.sensor, columns=30)), VIEW]
    renderer = Renderer(scene)
    whole = [renderer.render(view, ["amodal"])["amodal"] for view in views]
    monkeypatch.setattr(isolated, limit, 5)
    renderer = Renderer(scene)
    assert [renderer.render(view, ["amodal"])["amodal"] for view in views] == whole
    assert [len(one["organs"]) for one in whole] == [6, 4, 6]


@pytest.fixture(scope="module")
def plant():
    return short_plant(14, 3)


@pytest.fixture(scope="module")
def scene(plant):
    return assemble_scene(mesh_plant(plant, 0.5), skeleton=build_skeleton([plant]))


def aisle_camera(plant, distance_m=0.45, columns=160, rows=120):
    """A camera with a distorting lens, level with the largest fruit."""
    fruit = max(plant.of_form("fruit"), key=lambda organ: organ.measures["diameter_m"])
    target, view = fruit.curve.mean(axis=0), camera(columns=columns, rows=rows)
    lens = replace(view.lens, distortion=Distortion(k1=-0.1, k2=0.04, p1=1e-3, p2=-1e-3))
    sensor, pose = replace(view.sensor, binning=4), look_at(target - [0.0, distance_m, 0.0], target)
    return replace(view, lens=lens, sensor=sensor, pose=pose)


@pytest.fixture(scope="module")
def frame(plant, scene):
    return Renderer(scene).render(aisle_camera(plant), OUTPUTS)


def test_all_visible_organs_are_listed_with_their_pixels(frame):
    visible = np.unique(frame["instance"][frame["instance"] > 0]).tolist()
    organs = frame["amodal"]["organs"]
    assert [entry["instance"] for entry in organs] == visible
    assert {entry["class"] for entry in organs} >= {1, 2, 3, 4, 5}
    described = frame.metadata["instances"]
    for entry in organs:
        own = described[str(entry["instance"])]
        assert (entry["class"], entry["kind"]) == (own["class"], own["kind"])
        assert (entry["visible_pixels"], entry["box"]) == (own["pixels"], own["box"])
        mask = decode_rle(entry["amodal"])
        # What is visible is a part of the whole; the rest belongs to the occluders.
        assert mask[frame["instance"] == entry["instance"]].all()
        assert entry["amodal_pixels"] == mask.sum()
        rows, columns = np.nonzero(mask)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert entry["amodal_box"] == box
        hidden = {item["instance"]: item["pixels"] for item in entry["occluders"]}
        hidden[entry["instance"]] = entry["visible_pixels"]
        assert hidden == Counter(frame["instance"][mask].tolist())
        assert entry["truncated"] == bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())
    assert 0.2 < np.mean([entry["visible_fraction"] < 1 for entry in organs]) < 1


def test_masks_of_fruit_are_those_of_harvest(frame):
    organs = {entry["instance"]: entry for entry in frame["amodal"]["organs"]}
    fruit = [entry for entry in frame["harvest"]["fruit"] if entry["visible_pixels"]]
    assert len(fruit) >= 2
    for entry in fruit:
        shared = organs[entry["instance"]].keys() & entry.keys()
        assert len(shared) == 10
        assert {key: entry[key] for key in shared} == {key: organs[entry["instance"]][key] for key in shared}


def test_masks_are_those_of_a_ray_caster(plant, scene, frame):
    """Trimesh, in double precision; casters may differ where an outline meets a pixel's centre."""
    view = aisle_camera(plant)
    by_size = sorted(frame["amodal"]["organs"], key=lambda entry: entry["amodal_pixels"])
    # The largest one of each class.
    largest = {entry["class"]: entry for entry in by_size}
    assert largest.keys() >= {1, 2, 3, 4, 5}
    for entry in largest.values():
        part = scene.mesh.select_instances([entry["instance"] - 1])
        x0, y0, x1, y1 = entry["amodal_box"]
        rows, columns = (
            part.ravel()
            for part in np.mgrid[max(y0 - 3, 0) : min(y1 + 3, 120), max(x0 - 3, 0) : min(x1 + 3, 160)]
        )
        directions = view.pixel_directions()[rows, columns] @ view.pose[:3, :3].T
        origins = np.tile(view.pose[:3, 3], (len(directions), 1))
        caster = RayMeshIntersector(trimesh.Trimesh(part.vertices, part.faces, process=False))
        hit = np.zeros((120, 160), bool)
        hit[rows, columns] = caster.intersects_any(origins, directions)
        mask = decode_rle(entry["amodal"])
        outline = binary_dilation(mask) & ~binary_erosion(mask)
        differ = hit != mask
        assert not differ[~outline].any()
        assert differ.sum() <= 1


def test_outputs_do_not_depend_on_each_other(plant, scene, frame, monkeypatch):
    view = aisle_camera(plant)
    alone = Renderer(scene).render(view, ["amodal"])
    without = Renderer(scene).render(view, ["instance", "harvest"])
    for other in (without, alone):
        assert digests(other) == {name: digests(frame)[name] for name in other.images}
    json.dumps(frame["amodal"], allow_nan=False)
    # No organ is isolated unless an output needs it.
    monkeypatch.setattr(isolated.IsolatedOrgans, "__init__", None)
    Renderer(scene).render(view, ["instance", "class"])


def test_other_organs_and_image_sizes_compile_nothing(plant, scene, frame):
    other = short_plant(14, 8)
    render = Renderer(assemble_scene(mesh_plant(other, 0.5))).render
    assert count_compiled(lambda: render(aisle_camera(other, columns=84, rows=63), ["amodal"])) == 0
    closer = aisle_camera(plant, 0.3, columns=120, rows=90)
    assert count_compiled(lambda: Renderer(scene).render(closer, ["amodal"])) == 0


def test_thin_body_outside_the_image_is_not_searched():
    rod = trimesh.creation.cylinder(radius=0.002, height=0.1)
    rod.apply_translation([0.0, 0.0, -0.5])
    entries, _ = amodal_of(concatenate_meshes([body(rod, "matt"), pixels_card(0, 0, 9, 9, 0.5)]))
    assert list(entries) == [2]
