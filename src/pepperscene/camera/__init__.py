"""The camera: lens, sensor, flash and poses, and the conversion of light to images."""

from pepperscene.camera.camera import Camera, expected_electrons, relative_illumination
from pepperscene.camera.developing import (
    camera_rgb,
    colour_transform,
    correct_colours,
    decode_tone,
    develop,
    encode_tone,
    raw_frame,
    reference_correction,
)
from pepperscene.camera.flash import Flash, load_flash
from pepperscene.camera.lens import AngularProfile, Distortion, Lens, load_lens
from pepperscene.camera.poses import arc_path, look_at
from pepperscene.camera.readout import Developing
from pepperscene.camera.sensor import Filter, Sensor, load_filter, load_sensor

__all__ = [
    "AngularProfile",
    "Camera",
    "Developing",
    "Distortion",
    "Filter",
    "Flash",
    "Lens",
    "Sensor",
    "arc_path",
    "camera_rgb",
    "colour_transform",
    "correct_colours",
    "decode_tone",
    "develop",
    "encode_tone",
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
