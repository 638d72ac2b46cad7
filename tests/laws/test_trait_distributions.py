"""The distributions of traits over organs are recovered from the maps of 200 frames."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import axis_camera
from scipy.stats import ks_2samp

from pepperscene.camera import look_at
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.materials import organ_surfaces
from pepperscene.materials.tissue import tissue_states
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

PLANTS = 100
SIDES = (0.0, np.pi)  # of the views of each plant: a fruit is not equally ripe all around
SIGNIFICANCE = 1.0 - (1.0 - 0.01) ** (1.0 / 2.0)
"""Of each of two tests; 0.01 of all together (Sidak 1967)."""
POINTS = 60_000  # over the area of a plant, about 150 on each leaf
LEAST_PIXELS = {"lamina": 40, "fruit": 40}
TRAIT = {"lamina": "chlorophyll", "fruit": "ripeness"}


def whole_organs(mesh, surfaces, rng):
    """`(i, 2)` mean chlorophyll and ripeness over the area of each organ, and its number of points."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, face = trimesh.sample.sample_surface(solid, POINTS, seed=rng)
    weights = trimesh.triangles.points_to_barycentric(solid.triangles[face], points)
    corners, instance = mesh.faces[face], mesh.face_instance[face]
    uv = np.einsum("nk,nkd->nd", weights, mesh.uv[corners].astype(float))
    state = np.einsum("nk,nk->n", weights, mesh.state[corners].astype(float))
    ageing, variant = (
        np.array([getattr(item, name) for item in mesh.appearances])[mesh.face_appearance[face]]
        for name in ("ageing", "variant")
    )
    values = np.full((2, len(face)), np.nan)
    for number, name in enumerate(mesh.surfaces):
        at, surface = np.flatnonzero(mesh.face_surface[face] == number), surfaces[name]
        mixed = tissue_states(surface, state[at], uv[at], variant[at], ageing[at])
        for row, trait in enumerate(("chlorophyll", "ripeness")):
            if trait in surface.contents:
                values[row, at] = np.interp(mixed, surface.states, surface.contents[trait])
    count = np.bincount(instance, minlength=len(mesh.instances))
    sums = [np.bincount(instance, row, minlength=len(mesh.instances)) for row in values]
    return np.stack(sums, axis=1) / np.maximum(count, 1)[:, None], count


@pytest.fixture(scope="module")
def organs():
    """Of leaves and fruit below the growing top: mean over the organ, mean over its pixels."""
    cultivar = load_cultivar("kaite")
    surfaces = organ_surfaces(cultivar, [500.0, 600.0])
    mature = cultivar.stem.parts - cultivar.stem.young_nodes
    found = {kind: [] for kind in TRAIT}
    for seed in range(PLANTS):
        plant = grow(cultivar, np.random.default_rng([77, seed]))
        mesh = mesh_plant(plant, 0.3)
        whole, points = whole_organs(mesh, surfaces, seed)
        renderer = Renderer(assemble_scene(mesh, surfaces))
        frames = [
            renderer.render(whole_plant_view(mesh, seed, side), ["instance", *TRAIT.values()])
            for side in SIDES
        ]
        number = np.stack([frame["instance"] for frame in frames])
        images = {trait: np.stack([frame[trait] for frame in frames]) for trait in TRAIT.values()}
        pixels = np.bincount(number.ravel(), minlength=len(mesh.instances) + 1)[1:]
        for index, organ in enumerate(plant.organs):
            if organ.kind not in TRAIT or organ.phytomer >= mature or points[index] < 20:
                continue
            trait = TRAIT[organ.kind]
            is_seen = pixels[index] >= LEAST_PIXELS[organ.kind]
            shown = images[trait][number == index + 1].mean() if is_seen else np.nan
            found[organ.kind].append((whole[index, list(TRAIT).index(organ.kind)], shown))
    return {kind: np.array(rows) for kind, rows in found.items()}


def whole_plant_view(mesh, seed, side):
    """A camera beside a plant that sees all of it in 180 x 480 pixels, `side` beyond a random azimuth."""
    low, high = mesh.bounds.astype(float)
    centre, height = 0.5 * (low + high), float(high[2] - low[2])
    azimuth = np.random.default_rng([78, seed]).uniform(0.0, 2.0 * np.pi) + side
    distance = 2.0 * height
    position = centre + distance * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    view = axis_camera(180, 480)
    pitch = view.lens.focal_length_m * 1.1 * height / distance / 480 / view.sensor.binning
    return replace(view, sensor=replace(view.sensor, pitch_m=pitch), pose=look_at(position, centre))


@pytest.mark.long
@pytest.mark.parametrize("kind", TRAIT)
def test_maps_have_the_distribution_of_the_organs_that_they_show(organs, kind):
    every, seen = organs[kind], organs[kind][np.isfinite(organs[kind][:, 1])]
    assert len(seen) > 500
    assert ks_2samp(seen[:, 1], every[:, 0]).pvalue > SIGNIFICANCE
    # A leaf or a fruit is seen in parts.
    assert seen[:, 1].mean() == pytest.approx(seen[:, 0].mean(), rel=0.02)
    assert seen[:, 1].std() == pytest.approx(seen[:, 0].std(), rel=0.04)
    assert np.corrcoef(seen.T)[0, 1] > 0.97
