"""Images of a line scanner against still cameras at the poses of its rows, and against a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, card, sphere
from scipy import ndimage

from pepperscene.camera import Camera, Developing, Motion, load_lens, load_sensor
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum

LINES, COLUMNS = 60, 64
DISTANCE_M = 0.5
LABELS = ("class", "instance", "distance", "depth_z", "position", "normal", "coverage")
QUALITY = Quality(samples=64, soft=16, most=64, bounces=0, target=None, denoise=False)
SURFACES = {name: lambertian_surface(name, value) for name, value in (("dark", 0.05), ("light", 0.8))}


def scanner():
    """A scanner with square pixels of 5.4 mm at the card, which moves down the image."""
    shipped = load_sensor("generic_line_scanner_vnir")
    grey = Spectrum(shipped.quantum_efficiency.wavelength_nm, shipped.quantum_efficiency.values.max(0)[None])
    sensor = replace(shipped, pattern="mono", quantum_efficiency=grey).with_size(COLUMNS, LINES)
    lens = load_lens("generic_line_scanner_38deg")
    speed = DISTANCE_M * sensor.pixel_pitch_m / lens.focal_length_m / sensor.line_time_s
    motion = Motion((0.0, speed, 0.0), (0.0, 0.0, 0.1))
    return Camera(lens, sensor, exposure_s=1e-4, motion=motion, developing=Developing())


@pytest.fixture(scope="module")
def renderer():
    wall = card(0.0, 0.0, 2.0, 2.0, "dark", DISTANCE_M + 0.1)
    parts = [wall, card(0.03, 0.02, 0.1, 0.12, "light"), sphere((-0.08, -0.05, 0.45), 0.05, "light", 4)]
    return Renderer(assemble_scene(concatenate_meshes(parts), SURFACES, EVEN_SKY))


@pytest.fixture(scope="module")
def frame(renderer):
    return renderer.render(scanner(), (*LABELS, "electrons"), QUALITY)


def test_each_row_is_the_line_at_its_own_time(renderer, frame):
    camera = scanner()
    times = (np.arange(LINES) + 0.5 - LINES / 2) * camera.sensor.line_time_s
    for row in (0, 17, 30, 59):
        still = replace(camera, sensor=camera.sensor.line, pose=camera.pose_at(times[row]), motion=None)
        line = renderer.render(still, LABELS)
        np.testing.assert_array_equal(frame["instance"][row], line["instance"][0])
        np.testing.assert_array_equal(frame["class"][row], line["class"][0])
        for name in ("distance", "depth_z", "position", "normal"):
            np.testing.assert_allclose(frame[name][row], line[name][0], rtol=1e-5, atol=1e-6)
        difference = np.abs(frame["coverage"][row].astype(float) - line["coverage"][0])
        assert difference.mean() < 0.01


def test_positions_project_to_the_centres_of_their_pixels(frame):
    found = scanner().project(frame["position"].reshape(-1, 3).astype(float))
    v, u = np.mgrid[:LINES, :COLUMNS] + 0.5
    np.testing.assert_allclose(found, np.stack([u.ravel(), v.ravel()], axis=1), atol=0.01)


def test_light_is_where_the_labels_are(frame):
    # The light bodies are sixteen times as bright as the wall.
    bright, light = frame["electrons"][..., 0] > 0.3 * frame["electrons"].max(), frame["instance"] > 1
    assert (bright == light).mean() > 0.98
    # Away from the borders, where a pixel has both.
    inside = ndimage.minimum_filter(light, 3) == ndimage.maximum_filter(light, 3)
    assert (bright == light)[inside].all()


def test_a_square_card_is_square():
    # 100 mm by 120 mm, without the turn: 18.6 by 22.3 pixels of 5.38 mm.
    camera = replace(scanner(), motion=Motion(scanner().motion.velocity_m_s))
    mesh = card(0.0, 0.0, 0.1, 0.12, "light")
    instance = Renderer(assemble_scene(mesh, SURFACES)).render(camera, ["instance"])["instance"]
    pixel_m = DISTANCE_M * camera.sensor.pixel_pitch_m / camera.lens.focal_length_m
    assert np.ptp(np.flatnonzero(instance.any(axis=0))) + 1 == pytest.approx(0.1 / pixel_m, abs=1)
    assert np.ptp(np.flatnonzero(instance.any(axis=1))) + 1 == pytest.approx(0.12 / pixel_m, abs=1)


def test_a_still_scanner_records_the_same_line(renderer):
    still = replace(scanner(), motion=None)
    instance = renderer.render(still, ["instance"])["instance"]
    np.testing.assert_array_equal(instance, np.broadcast_to(instance[:1], instance.shape))
