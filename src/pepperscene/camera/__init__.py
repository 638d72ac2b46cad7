"""The camera: lens, sensor, flash and poses, and the conversion of light to images."""

from pepperscene.camera.auto_exposure import (
    ChosenExposure,
    ExposureControl,
    choose_exposure,
    metering_camera,
    with_exposure,
)
from pepperscene.camera.bands import Band
from pepperscene.camera.camera import Camera, electrons_per_light, expected_electrons, relative_illumination
from pepperscene.camera.depth_alignment import align_depth
from pepperscene.camera.depth_camera import DepthCamera, StereoMatching
from pepperscene.camera.developing import (
    add_pedestal,
    camera_rgb,
    colour_transform,
    correct_colours,
    decode_tone,
    develop,
    encode_tone,
    measured_electrons,
    pedestal,
    raw_frame,
    reference_correction,
    reference_light,
)
from pepperscene.camera.distortion import Distortion, DistortionModel, FisheyeDistortion
from pepperscene.camera.flash import Flash, load_flash
from pepperscene.camera.glare import add_stray_light
from pepperscene.camera.lens import AngularProfile, Lens, load_lens
from pepperscene.camera.motion import Motion
from pepperscene.camera.paths import Trajectory, spline_trajectory, trajectory_from_poses
from pepperscene.camera.pose_files import PoseFormat, read_poses, write_poses
from pepperscene.camera.pose_list import PoseList
from pepperscene.camera.poses import arc_path, grid_poses, look_at, protocol_poses
from pepperscene.camera.projector import Projector, load_projector
from pepperscene.camera.readout import Developing
from pepperscene.camera.sensor import Filter, Sensor
from pepperscene.camera.sensor_files import load_filter, load_sensor
from pepperscene.camera.stereo_matching import MatchedDepth, match_depth
from pepperscene.camera.stray_light import Ghost, StrayLight
from pepperscene.camera.white_reference import WhiteReference

__all__ = [
    "AngularProfile",
    "Band",
    "Camera",
    "ChosenExposure",
    "DepthCamera",
    "Developing",
    "Distortion",
    "DistortionModel",
    "ExposureControl",
    "Filter",
    "FisheyeDistortion",
    "Flash",
    "Ghost",
    "Lens",
    "MatchedDepth",
    "Motion",
    "PoseFormat",
    "PoseList",
    "Projector",
    "Sensor",
    "StereoMatching",
    "StrayLight",
    "Trajectory",
    "WhiteReference",
    "add_pedestal",
    "add_stray_light",
    "align_depth",
    "arc_path",
    "camera_rgb",
    "choose_exposure",
    "colour_transform",
    "correct_colours",
    "decode_tone",
    "develop",
    "electrons_per_light",
    "encode_tone",
    "expected_electrons",
    "grid_poses",
    "load_filter",
    "load_flash",
    "load_lens",
    "load_projector",
    "load_sensor",
    "look_at",
    "match_depth",
    "measured_electrons",
    "metering_camera",
    "pedestal",
    "protocol_poses",
    "raw_frame",
    "read_poses",
    "reference_correction",
    "reference_light",
    "relative_illumination",
    "spline_trajectory",
    "trajectory_from_poses",
    "with_exposure",
    "write_poses",
]
