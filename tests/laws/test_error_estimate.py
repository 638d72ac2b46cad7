"""The error that a frame states is the error that it has.

Rationale: where sampling stops hangs on an estimate from a few samples a pixel. If that is wrong, frames are
noisier than they say, or take longer than they need.

Set-up: three small scenes. The true error is the root mean square difference in codes to a reference, by the
product of the differences to two independent halves of it, so that the reference's own noise drops out; codes
are linear in the light about the reference, as the estimate has them.

Expected: within a factor of 2.2. Light that comes by one surface alone obeys Mitchell's law and is told
within [.6, 1.8]. What the denoiser leaves of all other light depends on the picture: more goes where surfaces
are large and even (the bench, told / true 1.9), less where they are small (plants by flash .63, by day .74).
"""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import Referred, bench_shot, plants_shot

from pepperscene.errors import InputError
from pepperscene.render import Quality, Renderer
from pepperscene.render.quality import MAX_TARGET, MIN_TARGET
from pepperscene.scene import assemble_scene


@pytest.mark.parametrize("name", ["bench", "plants", "daylight"])
def test_the_error_told_is_the_error_there_is(name):
    shot = bench_shot() if name == "bench" else plants_shot(daylight=name == "daylight")
    true, told, facts = Referred(*shot).errors("standard")
    assert 1 / 2.2 < told / true < 2.2, (true, told, facts[0])
    for said in facts:
        assert said["error_to_noise"] == pytest.approx(said["error_codes"] / said["noise_codes"])


@pytest.fixture(scope="module")
def flashed() -> Referred:
    """The plants by their flash alone, straight there and back."""
    scene, camera = plants_shot()
    surfaces = {surface.name: surface for surface in scene.surfaces}
    return Referred(assemble_scene(scene.mesh, surfaces), camera, bounces=0)


def test_the_error_of_the_flash_follows_the_target(flashed):
    sharp = Quality(4, 1, 1024, 0, target=1.0, denoise=False)
    targets, true = [0.4, 0.2, 0.1], []
    for target in targets:
        error, told, facts = flashed.errors(sharp, target)
        assert 0.6 < told / error < 1.8, (target, error, told, facts[0])
        true.append(error)
        # Powers of two, and a last round that leaves some pixels with a quarter of what they want.
        ratio = np.mean([said["error_to_noise"] for said in facts])
        assert 0.6 * target < ratio < 1.4 * target
    # Half of the target takes at least 1.6 of the true error.
    assert true[0] / true[1] > 1.6
    assert true[1] / true[2] > 1.6


@pytest.mark.parametrize("target", [0.0, -1.0, MIN_TARGET / 2, MAX_TARGET * 2, float("nan"), float("inf")])
def test_targets_out_of_range_are_refused_with_a_sentence(target):
    scene, camera = bench_shot()
    with pytest.raises(InputError, match=r"must lie in \[0\.01, 10\]") as refused:
        Renderer(scene).render(camera, ["electrons"], "standard", 0, target_error=target)
    sentence = str(refused.value)
    assert "\n" not in sentence
    assert "target-error" in sentence
