"""Automatic exposure of rendered frames: the image has the wanted grey, and the frame says how."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, cloudy_sky, digests, greenhouse, partners

from pepperscene.camera import (
    ChosenExposure,
    Developing,
    ExposureControl,
    Partners,
    expected_electrons,
    look_at,
    metering_camera,
    with_exposure,
)
from pepperscene.classes import PLANT_CLASSES
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.render import Quality, Renderer
from pepperscene.render.metering import metered_light
from pepperscene.scene import uniform_sky
from pepperscene.spectra import Spectrum, sky_spectrum

CONTROL = ExposureControl(target_grey=90.0, shortest_s=1e-6, longest_s=0.05, most_gain=8.0)


def photographer(flash=True):
    """A camera of 400 x 300 pixels with the field of view of `camera`."""
    small = camera(flash=flash)
    sensor = replace(small.sensor, columns=400, rows=300, binning=4)
    balance = "flash" if flash else "daylight"
    return replace(small, sensor=sensor, developing=Developing(white_balance=balance))


def monochrome(view):
    curves = view.sensor.quantum_efficiency
    green = Spectrum(curves.wavelength_nm, curves.values[1:2])
    return replace(view, sensor=replace(view.sensor, pattern="mono", quantum_efficiency=green))


@pytest.fixture(scope="module")
def scene():
    return greenhouse()


@pytest.fixture(scope="module")
def renderer(scene):
    return Renderer(scene)


VIEWS = {
    "flash and daylight": photographer(),
    "daylight": photographer(flash=False),
    "monochrome": monochrome(photographer()),
}


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("daylight", 140.0),
        pytest.param("flash and daylight", 50.0, marks=pytest.mark.long),
        pytest.param("monochrome", 90.0, marks=pytest.mark.long),
    ],
)
def test_rendered_image_has_the_wanted_mean_grey(renderer, name, target):
    control = replace(CONTROL, target_grey=target)
    frame = renderer.render(VIEWS[name], ["colour"], "standard", 3, exposure_control=control)
    described = frame.metadata["auto_exposure"]
    assert (described["target_grey"], described["limited_by"]) == (target, None)
    assert described["grey"] == pytest.approx(target, rel=2e-3)
    assert frame["colour"].mean() == pytest.approx(target, rel=0.05)


@pytest.mark.parametrize("metering", ["subject", "highlights"])
def test_plants_are_metered_and_not_saturated(renderer, metering):
    control = replace(CONTROL, target_grey=140.0, metering=metering)
    view = VIEWS["daylight"]
    frame = renderer.render(view, ["colour", "class"], "standard", 3, exposure_control=control)
    described = frame.metadata["auto_exposure"]
    plant = frame["colour"][np.isin(frame["class"], list(PLANT_CLASSES))]
    assert described["metering"] == metering
    assert plant.mean() == pytest.approx(described["grey"], abs=2.0)
    assert (plant == 255).any(axis=-1).mean() <= 0.01
    if metering == "subject":
        assert described["limited_by"] == "highlights" or plant.mean() == pytest.approx(140.0, abs=2.0)


def test_view_without_plants_is_metered_as_a_whole(renderer):
    # Straight up, into the sky.
    view = replace(photographer(flash=False), pose=look_at((0.0, 0.0, 5.0), (0.0, 0.1, 9.0)))
    average, subject = (
        renderer.meter(view, replace(CONTROL, metering=metering)).to_json()
        for metering in ("average", "subject")
    )
    assert subject == average | {"metering": "average", "saturated": subject["saturated"]}


def test_imagers_of_a_depth_camera_are_exposed_for_plants(renderer):
    greys = {}
    for metering in ("average", "subject"):
        depth = replace(partners().depth, exposure_control=ExposureControl(60.0, metering=metering))
        image = renderer.render(camera(), ["imager_left"], "draft", 3, partners=Partners(depth=depth))
        classes = renderer.render(depth.left, ["class"])["class"]
        greys[metering] = image["imager_left"][np.isin(classes, list(PLANT_CLASSES))].mean()
    assert greys["subject"] == pytest.approx(60.0, abs=3.0)
    assert abs(greys["average"] - 60.0) > 10.0


def test_flash_of_a_night_scene_is_metered_during_its_pulse(renderer):
    # Beyond the pulse, its light no longer depends on the exposure.
    view = photographer()
    pulse_s = view.flash.pulse_s
    half, whole, long = (
        renderer.meter(view, ExposureControl(longest_s=n * pulse_s, most_gain=1.0), 1, sky=None)
        for n in (0.5, 1.0, 20.0)
    )
    assert {chosen.limited_by for chosen in (half, whole, long)} == {"longest exposure and gain"}
    assert half.grey < 0.9 * whole.grey
    assert long.grey == whole.grey


def test_twice_the_daylight_halves_the_exposure(renderer):
    view = photographer(flash=False)
    once, twice = (
        renderer.meter(view, CONTROL, 1, sky=uniform_sky(sky_spectrum("d65"), lux)) for lux in (4000, 8000)
    )
    assert twice.exposure_s == pytest.approx(0.5 * once.exposure_s, rel=5e-3)
    assert renderer.meter(view, CONTROL, sky=None).limited_by == "no light"


def test_metered_light_is_that_of_the_frame(renderer, scene):
    view = photographer()
    parts = metered_light(scene, renderer._kernel.light_scene, renderer._kernel.coordinates, view, 4)
    small = metering_camera(view)
    assert {part.shape for part in parts} == {(small.height, small.width, 3)}
    # Within the pulse, both lights are constant, and a frame has their sum.
    electrons = renderer.render(replace(view, exposure_s=view.flash.pulse_s), ["electrons"], "standard", 5)
    reduced = with_exposure(small, ChosenExposure(view.flash.pulse_s, 1.0, 0.0))
    area = (view.sensor.pitch_m / small.sensor.pitch_m) ** 2
    expected = expected_electrons(parts[0] + parts[1], reduced) * area
    assert electrons["electrons"].mean(axis=(0, 1)) == pytest.approx(expected.mean(axis=(0, 1)), rel=0.02)


@pytest.mark.long
def test_metering_depends_on_its_arguments_alone(scene, renderer):
    view, sky = photographer(), cloudy_sky(3)
    first = renderer.meter(view, CONTROL, 9, sky)
    renderer.render(camera(0), ["colour"], "draft", 2)
    assert renderer.meter(replace(view, exposure_s=1e-3), CONTROL, 9, sky) == first
    assert Renderer(replace(scene, sky=sky)).meter(view, CONTROL, 9) == first
    assert renderer.meter(view, CONTROL, 9) != first


def test_frame_is_the_one_with_the_chosen_settings(renderer):
    view = photographer(flash=False)
    control = replace(CONTROL, longest_s=1e-4)  # too short without a gain
    frame = renderer.render(view, ["colour", "depth_z"], "draft", 5, exposure_control=control)
    described = dict(frame.metadata["auto_exposure"])
    assert described.pop("target_grey") == 90.0
    chosen = renderer.meter(view, control, 5, quality="draft")
    assert ChosenExposure(**described) == chosen
    assert chosen.gain > 1.0
    assert frame.metadata["camera"]["exposure_s"] == chosen.exposure_s
    assert frame.metadata["camera"]["gain"] == chosen.gain
    same = renderer.render(with_exposure(view, chosen), ["colour", "depth_z"], "draft", 5)
    assert digests(same) == digests(frame)
    json.dumps(frame.metadata, allow_nan=False)


def test_stereo_partner_has_the_same_exposure(renderer):
    view, control = camera(), replace(CONTROL, target_grey=60.0)
    partner = Partners(stereo=partners().stereo)
    outputs = ["colour", "colour_stereo"]
    frame = renderer.render(view, outputs, "draft", 5, partners=partner, exposure_control=control)
    chosen = renderer.meter(view, control, 5)
    both = Partners(stereo=with_exposure(partner.stereo, chosen))
    same = renderer.render(with_exposure(view, chosen), outputs, "draft", 5, partners=both)
    assert digests(same) == digests(frame)


def test_frames_without_control_or_light_are_as_before(scene, renderer):
    before = Renderer(scene).render(camera(), DEFAULT_OUTPUTS, "draft", 5)
    renderer.meter(camera(), CONTROL, 5)
    after = renderer.render(camera(), DEFAULT_OUTPUTS, "draft", 5)
    assert digests(after) == digests(before)
    assert after.metadata == before.metadata
    assert "auto_exposure" not in after.metadata
    labels = renderer.render(camera(), ["class"], "draft", 5, exposure_control=CONTROL)
    assert labels.metadata["camera"] == camera().to_metadata()


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["flash", "path"])
def test_frame_under_another_sky_equals_a_scene_with_that_sky(scene, integrator):
    quality = Quality(4, 2, 8, 1, 0.15 if integrator == "flash" else None, True, integrator)
    view = replace(camera(), exposure_s=1e-3)
    used = Renderer(scene)
    skies = {"other": cloudy_sky(11, 0.4), "night": None}
    frames = {}
    for name, sky in skies.items():
        frames[name] = used.render(view, DEFAULT_OUTPUTS, quality, 5, sky=sky)
        fresh = Renderer(replace(scene, sky=sky)).render(view, DEFAULT_OUTPUTS, quality, 5)
        assert digests(frames[name]) == digests(fresh)
        assert frames[name].metadata == fresh.metadata
    own = used.render(view, DEFAULT_OUTPUTS, quality, 5, sky="scene")
    assert digests(own) == digests(Renderer(scene).render(view, DEFAULT_OUTPUTS, quality, 5))
    assert len({digests(frame)["colour"] for frame in (*frames.values(), own)}) == 3
    # The geometry, and so all labels, are the same.
    assert all(np.array_equal(frame["class"], own["class"]) for frame in frames.values())
