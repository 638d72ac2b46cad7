"""The camera room: lens, sensor, flash, poses, and the way from light to a photograph."""

from pepperscene.camera.camera import Camera
from pepperscene.camera.correction import Correction
from pepperscene.camera.developing import (
    camera_rgb,
    colour_steps,
    corrected,
    decode,
    develop,
    encode,
    raw_frame,
    reference_correction,
)
from pepperscene.camera.exposure import expected_electrons, relative_illumination
from pepperscene.camera.filter_file import Filter, load_filter
from pepperscene.camera.flash import Flash
from pepperscene.camera.flash_file import load_flash
from pepperscene.camera.lens import Distortion, Lens
from pepperscene.camera.lens_file import load_lens
from pepperscene.camera.poses import arc_path, look_at
from pepperscene.camera.profile import AngularProfile
from pepperscene.camera.sensor import Sensor
from pepperscene.camera.sensor_file import load_sensor
from pepperscene.camera.steps import Developing

__all__ = [
    "AngularProfile",
    "Camera",
    "Correction",
    "Developing",
    "Distortion",
    "Filter",
    "Flash",
    "Lens",
    "Sensor",
    "arc_path",
    "camera_rgb",
    "colour_steps",
    "corrected",
    "decode",
    "develop",
    "encode",
    "expected_electrons",
    "load_filter",
    "load_flash",
    "load_lens",
    "load_sensor",
    "look_at",
    "raw_frame",
    "reference_correction",
    "relative_illumination",
]
