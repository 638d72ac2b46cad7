"""Surfaces of the ablation (benchmarks/learning_ablation.py): each lacks one thing, and nothing else."""

from __future__ import annotations

import sys
from dataclasses import fields
from itertools import pairwise
from pathlib import Path

import numpy as np
from greenhouse import NM, greenhouse

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from learning_ablation import BAND_EDGES_NM, SURFACES


def changed_fields(before, after):
    values = (
        (field.name, getattr(before, field.name), getattr(after, field.name)) for field in fields(before)
    )
    return {name for name, a, b in values if a is not b and not np.array_equal(a, b)}


def test_a_variant_lacks_one_thing_only_and_three_bands_keep_the_mean_of_each_band():
    leaf = greenhouse().surfaces[[surface.name for surface in greenhouse().surfaces].index("leaf")]
    for variant, changed in (
        ("no gloss", {"ior", "wide_roughness"}),
        ("no relief", {"relief_mm"}),
        ("RGB light", {"reflectance", "transmittance"}),
    ):
        assert changed_fields(leaf, SURFACES[variant](leaf)) == changed
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
