"""Photographs of a greenhouse by an unknown telephone: a recipe tuned to some is compared with the others.

Rationale: in Barth et al. 2018 (Comput. Electron. Agric. 148) hue spectra of rendered and of real fruit had a
correlation of .62, and of .90 after a neural network (CycleGAN) had translated the images. A fit of pigments
and camera to a few patches is to achieve as much.

Set-up: patches drawn by hand on clearly visible fruit of six photographs. A recipe of a red crop by daylight
is tuned to three of them. Frames of the whole scene, before and after, are compared with the other three;
then the halves are swapped.

Expected: the spectra of green and of red fruit improve in either case. The limit is the correlation of the
photographs' own halves: r = .93 and .95 for the halves used here, which agree best, .90 and .84 in the median
over all ways to halve six photographs, .83 and .59 at worst.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest

from pepperscene.colour import PatchSet, open_patches
from pepperscene.tuning import TuningOptions, tune

HERE = Path(__file__).parent / "photos"
PHOTOS = Path(os.environ.get("PEPPERSCENE_PHOTOS", HERE.parents[3] / "shared" / "reference" / "photos"))
HALVES = (("img1", "img2", "img5"), ("img3", "img4", "img6"))
KINDS = ("pepper.unripe", "pepper.ripe")
PARAMETERS = (
    "fruit.unripe.chlorophyll", "fruit.unripe.carotenoid", "fruit.unripe.brown", "fruit.ripe.capsanthin",
    "fruit.ripe.brown", "fruit.spread", "exposure", "white_balance", "colour_matrix",
)  # fmt: skip

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not PHOTOS.is_dir(), reason="PEPPERSCENE_PHOTOS is not the folder of the photographs"),
]


@pytest.fixture(scope="module")
def fruit() -> PatchSet:
    measured = open_patches(HERE / "patches.toml", pictures=PHOTOS)
    return PatchSet("fruit", tuple(patch for patch in measured.patches if patch.kind in KINDS))


@pytest.fixture(scope="module")
def verification(fruit, tmp_path_factory):
    """The verification of a fit without the patches of one half."""

    @cache
    def tuned_without(half):
        out = tmp_path_factory.mktemp("tuned") / "out"
        bounds = HERE / "bounds.toml"
        options = TuningOptions(bounds=bounds, hold_out=half, starts=1, verify=12)
        return tune(HERE / "phone.toml", fruit, PARAMETERS, out, options).verification

    return tuned_without


@pytest.mark.parametrize("half", HALVES)
@pytest.mark.parametrize("kind", KINDS)
def test_agreement_with_held_out_photographs_improves(verification, half, kind, record_property):
    before, after = verification(half).held_before[kind], verification(half).held_after[kind]
    record_property("before", before)
    record_property("after", after)
    assert after.correlation > before.correlation + 0.1
    assert after.delta_e < before.delta_e
