"""Photographs of a greenhouse, by a telephone of which nothing is known: tuned to some, compared with others.

Rationale: hue spectra of rendered and of real fruit agreed to .62 before, and to .90 after, a neural network
had translated the pictures (Barth et al. 2018, Comput. Electron. Agric. 148: a CycleGAN). A fit of pigments
and camera to a few patches is to do as much.

Set-up: patches drawn by hand on clearly visible fruit of six photographs. A recipe of a red crop by daylight
is tuned to three of them. Frames of the whole scene, before and after, are compared with the other three;
then the halves change places.

Expected: spectra of green and of red fruit come nearer in either case. How near they can come is told by how
alike the photographs of the two halves are: r = .93 and .95 for the halves taken here, which agree best, .90
and .84 in the median over all ways to halve six photographs, .83 and .59 at worst.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest

from pepperscene.colour import PatchSet, open_patches
from pepperscene.tuning import tune

HERE = Path(__file__).parent / "photos"
PHOTOS = Path(os.environ.get("PEPPERSCENE_PHOTOS", HERE.parents[3] / "shared" / "reference" / "photos"))
HALVES = (("img1", "img2", "img5"), ("img3", "img4", "img6"))
KINDS = ("pepper.unripe", "pepper.ripe")
NAMES = (
    "fruit.unripe.chlorophyll", "fruit.unripe.carotenoid", "fruit.unripe.brown", "fruit.ripe.capsanthin",
    "fruit.ripe.brown", "fruit.spread", "exposure", "white_balance", "colour_matrix",
)  # fmt: skip

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not PHOTOS.is_dir(), reason="PEPPERSCENE_PHOTOS does not name the photographs' folder"
    ),
]


@pytest.fixture(scope="module")
def fruit() -> PatchSet:
    every = open_patches(HERE / "patches.toml", pictures=PHOTOS)
    return PatchSet("fruit", tuple(patch for patch in every.patches if patch.kind in KINDS))


@pytest.fixture(scope="module")
def tuned(fruit, tmp_path_factory):
    """The verification of the fit to all but one half, by that half."""

    @cache
    def fitted(half):
        out = tmp_path_factory.mktemp("tuned") / "out"
        bounds = HERE / "bounds.toml"
        done = tune(HERE / "phone.toml", fruit, NAMES, out, bounds=bounds, hold_out=half, starts=1, verify=12)
        return done.verification

    return fitted


@pytest.mark.parametrize("half", HALVES)
@pytest.mark.parametrize("kind", KINDS)
def test_fruit_comes_nearer_to_photographs_that_the_fit_did_not_see(tuned, half, kind, record_property):
    before, after = tuned(half).held_before[kind], tuned(half).held_after[kind]
    record_property("before", before)
    record_property("after", after)
    assert after.correlation > before.correlation + 0.1
    assert after.delta_e < before.delta_e
