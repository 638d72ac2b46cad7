"""Any light on any sensor gives numbers within the range, and no others."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pepperscene.camera import (
    Camera,
    Developing,
    Sensor,
    camera_rgb,
    develop,
    load_lens,
    load_sensor,
    raw_frame,
)

LENS = load_lens("lensagon_cmfa0420nd")
COLOUR = load_sensor("ueye_ui5250re").quantum_efficiency
GREY = load_sensor("onsemi_mt9v024_mono").quantum_efficiency
# Zero, numbers below the smallest normal one, single electrons, and light that no lamp gives.
ELECTRONS = st.one_of(
    st.just(0.0),
    st.floats(0, 1e-300, allow_subnormal=True),
    st.floats(0, 100),
    st.floats(0, 1e10),
    st.floats(0, 1e30),
    st.just(1e30),
    st.just(np.finfo(float).max),
)


@st.composite
def sensors(draw):
    """All that a sensor file and a recipe may ask for, in small."""
    pattern = draw(st.sampled_from(["rggb", "bggr", "grbg", "gbrg", "mono"]))
    bits = draw(st.integers(1, 16))
    return Sensor(
        name="any",
        columns=2 * draw(st.integers(1, 3)),
        rows=2 * draw(st.integers(1, 3)),
        pitch_m=5e-6,
        quantum_efficiency=GREY if pattern == "mono" else COLOUR,
        full_well_e=draw(st.floats(1, 1e9)),
        read_noise_e=draw(st.floats(0, 1e9)),
        bits=bits,
        black_level_dn=draw(st.floats(0, 0.999)) * (2**bits - 1),
        binning=draw(st.integers(1, 4) if pattern == "mono" else st.sampled_from([1, 2, 4])),
        pattern=pattern,
        gain=draw(st.floats(1e-3, 1e3)),
    )


CHOICES = st.builds(
    Developing,
    falloff=st.booleans(),
    shot_noise=st.booleans(),
    read_noise=st.booleans(),
    saturation=st.booleans(),
    quantise=st.booleans(),
    demosaic=st.sampled_from(["malvar", "menon", "bilinear"]),
    white_balance=st.sampled_from([None, "daylight"]),
    colour_matrix=st.booleans(),
    tone=st.sampled_from(["srgb", "linear"]),
)


@given(sensor=sensors(), choice=CHOICES, seed=st.integers(0, 2**32) | st.none(), data=st.data())
@settings(max_examples=150, deadline=None)
def test_any_light_on_any_sensor_stays_in_range(sensor, choice, seed, data):
    shape = (sensor.rows, sensor.columns, sensor.channels)
    electrons = data.draw(arrays(np.float64, shape, elements=ELECTRONS))
    camera = Camera(LENS, sensor, developing=choice)
    raw, rgb, picture = (
        step(electrons, camera, None if seed is None else np.random.default_rng(seed))
        for step in (raw_frame, camera_rgb, develop)
    )
    assert raw.dtype == np.uint16
    assert raw.shape == sensor.site_shape
    assert raw.max() <= sensor.full_scale_dn
    assert picture.dtype == np.uint8
    assert picture.shape == (*shape[:2], 3)
    assert np.isfinite(rgb).all()
    if choice.saturation and (sensor.channels == 1 or sensor.binning > 1):
        # Single precision counts the whole range, of which a high black level leaves little.
        span = sensor.full_scale_dn - sensor.black_level_dn
        rounding = 4 * np.finfo(np.float32).eps * sensor.full_scale_dn / span
        assert rgb.min() >= -sensor.black_level_dn / span - rounding
        assert rgb.max() <= 1 + rounding


@given(light=st.lists(ELECTRONS, min_size=2, max_size=2))
@settings(max_examples=100, deadline=None)
def test_more_light_never_gives_smaller_numbers(light):
    # Without noise; with noise this holds on average only.
    sensor = dataclasses.replace(load_sensor("onsemi_mt9v024_mono"), columns=1, rows=1)
    camera = Camera(LENS, sensor, developing=Developing(white_balance="daylight"))
    low, high = (raw_frame(np.full((1, 1, 1), level), camera).item() for level in sorted(light))
    assert low <= high
