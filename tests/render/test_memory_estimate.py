"""Estimates of memory agree with measured peaks, and grow with everything that takes memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from processes import run_python

from pepperscene.building.scenes.plant_size import plant_triangles
from pepperscene.building.scenes.scene_size import scene_triangles
from pepperscene.camera import Motion
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS, TRAIT_OUTPUTS
from pepperscene.recipe.plan import Stream, random_generator
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.render import QUALITIES
from pepperscene.render.memory import frame_memory, written_memory

TRIANGLES = 2_000_000


@pytest.fixture(scope="module")
def resolved():
    return resolve_recipe("barth2018")


def resized(camera, columns, rows, **changes):
    """The camera with other numbers of pixels and the same field of view."""
    sensor = replace(camera.sensor, columns=columns, rows=rows, **changes)
    pitch_m = sensor.pitch_m * camera.sensor.columns / columns * camera.sensor.binning / sensor.binning
    return replace(camera, sensor=replace(sensor, pitch_m=pitch_m))


@pytest.fixture(scope="module")
def camera(resolved):
    return resolved.camera


def estimate(camera, *outputs, quality="draft", triangles=TRIANGLES):
    return frame_memory(camera, outputs, QUALITIES[quality], triangles)


@pytest.mark.parametrize("output", OUTPUTS)
def test_memory_grows_with_the_image(camera, output):
    # Images that are traced as a whole, and those that are traced in strips, which can take less.
    for sizes in ([(400, 300), (800, 600), (1600, 1200)], [(2000, 1500), (4000, 3000), (12000, 9000)]):
        needed = [estimate(resized(camera, *size), output) for size in sizes]
        assert needed == sorted(set(needed))


def test_memory_grows_with_triangles_outputs_and_photosites(camera):
    assert estimate(camera, "class", triangles=2 * TRIANGLES) > 1.3 * estimate(camera, "class")
    assert estimate(camera, "class", "flow") > estimate(camera, "class")
    finer = resized(camera, 800, 600, binning=16)
    assert estimate(finer, "raw") > estimate(camera, "raw") + 4 * 800 * 600 * (256 - 4)
    assert estimate(camera, "colour", quality="standard") > estimate(camera, "colour", quality="reference")


# Peaks of processes that rendered the first frame of `demo` on two cores.
@pytest.mark.parametrize(
    ("size", "outputs", "quality", "measured_mb"),
    [
        ((1600, 1200), ("colour",), "draft", 2711),
    ],
)
def test_estimates_agree_with_measured_peaks(camera, size, outputs, quality, measured_mb):
    ratio = estimate(resized(camera, *size), *outputs, quality=quality) / (measured_mb * 1e6)
    assert 1.0 <= ratio <= 1.2


# Peaks of processes that rendered frame 125 of `barth2018`, in strips of rows.
@pytest.mark.parametrize(
    ("size", "outputs", "quality", "measured_mb"),
    [
        ((3840, 2160), DEFAULT_OUTPUTS, "draft", 1788),
        ((3840, 2160), DEFAULT_OUTPUTS, "standard", 1799),
        ((6000, 4000), DEFAULT_OUTPUTS, "standard", 2176),
        ((6000, 4000), DEFAULT_OUTPUTS[1:], "standard", 1226),
        ((3840, 2160), ("normal", "position", "depth_z"), "standard", 1278),
        ((3840, 2160), ("uv",), "standard", 1143),
        ((3840, 2160), ("flow",), "standard", 1010),
    ],
)
def test_estimates_of_large_images_agree_with_measured_peaks(camera, size, outputs, quality, measured_mb):
    view = resized(camera, *size, binning=1)
    ratio = estimate(view, *outputs, quality=quality) / (measured_mb * 1e6)
    assert 1.0 <= ratio <= 1.25


def test_estimate_of_large_maps_of_traits_is_above_their_measured_peak(camera):
    view = resized(camera, 3840, 2160, binning=1)
    # Above by more than others: only pixels with tissue have points.
    assert 1.0 <= estimate(view, *TRAIT_OUTPUTS) / 1298e6 <= 1.35


def test_24_megapixels_take_no_more_than_two_and_a_half_gigabytes(camera):
    for size in ((3840, 2160), (6000, 4000)):
        needed = estimate(resized(camera, *size), *DEFAULT_OUTPUTS, quality="standard")
        assert needed <= 2.5e9


def test_separate_light_of_flash_and_daylight_takes_memory(camera):
    # Over the rows of a rolling shutter, even without motion, or with motion.
    rolling = replace(camera, sensor=replace(camera.sensor, line_time_s=1e-4), exposure_s=1e-3)
    moving = replace(camera, motion=Motion((1.0, 0.0, 0.0)))
    for divided in (rolling, moving):
        assert estimate(divided, "colour") > estimate(camera, "colour") + 90 * 800 * 600
        without = replace(divided, flash=None)
        assert estimate(without, "colour") == estimate(replace(camera, flash=None), "colour")


def test_a_gpu_takes_memory_of_the_host(camera, monkeypatch):
    monkeypatch.delenv("PEPPERSCENE_VARIANT", raising=False)
    on_cpu = estimate(camera, "class")
    monkeypatch.setenv("PEPPERSCENE_VARIANT", "cuda_ad_spectral")
    assert estimate(camera, "class") > on_cpu + 300e6


def test_images_that_are_written_take_memory(camera):
    assert written_memory(camera, ["colour", "distance"]) >= 800 * 600 * 7
    assert written_memory(camera, ["harvest"]) == 0


@pytest.mark.parametrize("cultivar", ["kaite", "kaite_february", "red_blocky", "tomato"])
def test_bound_of_a_plants_triangles_holds(cultivar):
    model = resolve_recipe("barth2018", {"cultivar": cultivar}).cultivar
    triangles = len(mesh_plant(grow(model, random_generator(1, Stream.PLANT, 0, 0))).faces)
    assert triangles <= plant_triangles(model, 1) <= 1.3 * triangles


def test_far_rows_are_counted(resolved):
    greenhouse = resolve_recipe("greenhouse")
    more = resolve_recipe("greenhouse", {"greenhouse.far_rows": 5, "greenhouse.far_reach_mm": 20000.0})
    assert scene_triangles(resolved, 1000) == 13_000
    assert scene_triangles(greenhouse, 1000) > 17_000
    assert scene_triangles(more, 1000) > 5 * scene_triangles(greenhouse, 1000)


PEAK = """
import json, resource
from dataclasses import replace
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.render import QUALITIES
from pepperscene.render.memory import frame_memory
from pepperscene.building.scenes.plant_size import plant_triangles
from pepperscene.building.scenes.scene_size import scene_triangles

size, output = {size}, {output!r}
renderer = FrameRenderer(resolve_recipe("demo", {{"row.plants_front": 3, "row.plants_back": 0}}))
sensor = replace(renderer.resolved.camera.sensor, columns=size[0], rows=size[1])
sensor = replace(sensor, pitch_m=sensor.pitch_m * 800 / size[0])
resolved = replace(renderer.resolved, camera=replace(renderer.resolved.camera, sensor=sensor))
renderer = FrameRenderer(resolved)
triangles = scene_triangles(resolved, plant_triangles(resolved.cultivar, resolved.recipe.seed))
needed = frame_memory(resolved.camera, [output], QUALITIES["draft"], triangles)
renderer.render(resolved.recipe.plan.frame(110), [output], "draft")
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(json.dumps([needed, 1024 * int(status["VmHWM"].split()[0])]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not report memory peaks")
@pytest.mark.parametrize(("size", "output"), [((800, 600), "class"), ((1280, 960), "colour")])
def test_estimate_agrees_with_the_peak_of_a_process(size, output):
    needed, peak = run_python(PEAK.format(size=size, output=output))
    assert 0.9 <= needed / peak <= 1.3
