"""The camera: lens, sensor, flash and poses, and the conversion of light to images."""

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.auto_exposure import (
    ChosenExposure,
    ExposureControl,
    choose_exposure,
    with_exposure,
)
from pepperscene.camera.image.developing import (
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
from pepperscene.camera.image.electrons import (
    add_stray_light,
    electrons_per_light,
    expected_electrons,
    image_electrons,
    near_point_spread,
    relative_illumination,
    stray_light_factor,
)
from pepperscene.camera.image.metered_image import SUBJECT_METERINGS, Metering, metering_camera
from pepperscene.camera.isp.processor import ImageProcessor
from pepperscene.camera.isp.processor_files import load_processor
from pepperscene.camera.lamps.lamp import Lamp, aimed_axes
from pepperscene.camera.lamps.lamp_files import load_lamp
from pepperscene.camera.optics.distortion import Distortion, DistortionModel, FisheyeDistortion
from pepperscene.camera.optics.flash import Flash, load_flash
from pepperscene.camera.optics.lens import AngularProfile, Ghost, Lens, StrayLight, load_lens
from pepperscene.camera.optics.projector import Projector, load_projector
from pepperscene.camera.optics.white_reference import WhiteReference
from pepperscene.camera.pose_files.formats import PoseFormat, read_poses, write_poses
from pepperscene.camera.poses.generators import arc_path, grid_poses, look_at, protocol_poses
from pepperscene.camera.poses.motion import Motion
from pepperscene.camera.poses.pose_list import PoseList
from pepperscene.camera.poses.trajectory import Trajectory, spline_trajectory, trajectory_from_poses
from pepperscene.camera.sensor.bands import Band
from pepperscene.camera.sensor.developing_steps import Developing
from pepperscene.camera.sensor.sensor import Filter, Sensor
from pepperscene.camera.sensor.sensor_files import load_filter, load_sensor
from pepperscene.camera.stereo.depth_camera import DepthCamera, Partners, StereoMatching
from pepperscene.camera.stereo.depth_images import MatchedDepth, align_depth, match_depth

__all__ = [
    "SUBJECT_METERINGS",
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
    "ImageProcessor",
    "Lamp",
    "Lens",
    "MatchedDepth",
    "Metering",
    "Motion",
    "Partners",
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
    "aimed_axes",
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
    "image_electrons",
    "load_filter",
    "load_flash",
    "load_lamp",
    "load_lens",
    "load_processor",
    "load_projector",
    "load_sensor",
    "look_at",
    "match_depth",
    "measured_electrons",
    "metering_camera",
    "near_point_spread",
    "pedestal",
    "protocol_poses",
    "raw_frame",
    "read_poses",
    "reference_correction",
    "reference_light",
    "relative_illumination",
    "spline_trajectory",
    "stray_light_factor",
    "trajectory_from_poses",
    "with_exposure",
    "write_poses",
]
