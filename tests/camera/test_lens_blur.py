"""`developing.blur_px` against the closed form of a blurred edge, and what it keeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from pepperscene.camera import Camera, Developing, load_lens, load_sensor
from pepperscene.camera.image.electrons import spread_light


def camera(blur_px):
    sensor = replace(load_sensor("generic_rgb"), columns=40, rows=20)
    developing = Developing(white_balance="daylight", blur_px=blur_px)
    return Camera(load_lens("lensagon_cmfa0420nd"), sensor, flash=None, developing=developing)


def test_blurred_edges_are_those_of_a_gaussian():
    edge = np.zeros((20, 40, 3))
    edge[:, 20:] = 900.0
    blurred = spread_light(edge.copy(), camera(1.5))
    assert blurred[5, :, 1] == pytest.approx(900.0 * ndtr((np.arange(40) - 19.5) / 1.5), abs=6.0)
    assert blurred.sum() == pytest.approx(edge.sum())
    assert spread_light(edge.copy(), camera(0.0)).tolist() == edge.tolist()
