"""Surfaces of the ablation (benchmarks/learning_ablation.py): each lacks one thing, and nothing else."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from greenhouse import NM, camera, greenhouse, surfaces

from pepperscene.render import Renderer

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from learning_ablation import BAND_EDGES_NM, SURFACES, render_with


def changed_fields(before, after):
    values = (
        (field.name, getattr(before, field.name), getattr(after, field.name)) for field in fields(before)
    )
    return {
        name for name, first, second in values if first is not second and not np.array_equal(first, second)
    }


@pytest.mark.parametrize(
    ("variant", "changed"),
    [
        ("no gloss", {"ior", "wide_roughness"}),
        ("no relief", {"relief_mm"}),
        ("RGB light", {"reflectance", "transmittance"}),
    ],
)
def test_a_variant_lacks_one_thing_only(variant, changed):
    leaf = surfaces(NM)["leaf"]
    assert changed_fields(leaf, SURFACES[variant](leaf)) == changed


def test_three_bands_keep_the_mean_of_each_band():
    leaf = surfaces(NM)["leaf"]
    banded = SURFACES["RGB light"](leaf)
    edges = (400.0, *BAND_EDGES_NM, 700.1)
    for name in ("reflectance", "transmittance"):
        before, after = getattr(leaf, name), getattr(banded, name)
        for first, end in pairwise(edges):
            band = (first <= NM) & (end > NM)
            assert np.ptp(after[..., band], axis=-1).max() == 0
            np.testing.assert_allclose(after[..., band][..., 0], before[..., band].mean(axis=-1), atol=1e-12)
        # Three values at all, also outside the visible range.
        assert all(len(np.unique(spectrum)) <= 3 for spectrum in after.reshape(-1, NM.size))


def test_changed_surfaces_are_rendered():
    scene, view = greenhouse(), camera(columns=32, rows=24)

    def colour(renderer):
        return renderer.render(view, ("colour",), "draft", 1).images["colour"]

    plain = colour(Renderer(scene))
    assert np.array_equal(colour(render_with(lambda surface: surface, scene)), plain)
    pictures = {name: colour(render_with(change, scene)) for name, change in SURFACES.items()}
    assert all(not np.array_equal(picture, plain) for picture in pictures.values())
    # Without gloss, the picture is that of surfaces with an index of 1.
    matt = replace(scene, surfaces=tuple(replace(s, ior=1.0, wide_roughness=None) for s in scene.surfaces))
    assert np.array_equal(pictures["no gloss"], colour(Renderer(matt)))
