"""The export formats: each is one object, which the export, the command line, the page and the tests read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

    from pepperscene.export.job import ExportJob

DEPTH_OUTPUTS: Final = ("distance", "depth_z")
"""Outputs of which formats with depths need one."""

BAND_IMAGES: Final = ("reflectance", "radiance", "bands")
"""Outputs of which formats of spectral bands need one; they write those that all frames have."""


@dataclass(frozen=True)
class ExportFormat:
    """One format, written by the function `write_NAME` of a module of this package."""

    name: str
    description: str  # one line, for pages
    required: tuple[tuple[str, ...], ...]  # outputs of all frames; of alternatives in a tuple, one is enough
    also: str = ""  # what further outputs add, for pages
    module: str = ""  # that has the writer, if it is not called as the format
    library: str = ""  # module of a library that it needs
    extra: str = "export"  # that installs the library
    smallest_px: int | None = None  # default of `export_dataset`; None for formats without objects
    classes: str | None = None  # default of `export_dataset`
    reserved: tuple[str, ...] = ()  # names that no split may have: of other folders, or of other keys
    has_background: bool = False  # whether the background can be a class
    has_masks: bool = False  # whether ignored pixels, if there can be some, are written as masks
    has_clock: bool = False  # whether frames have times
    has_crowds: bool = True  # whether fruit of unknown ripeness is marked as such, not left out
    image_options: frozenset[str] = frozenset()  # of `export_dataset` that change its images

    def write(self, job: ExportJob, folder: Path) -> None:
        """Write the files of an export into a folder."""
        module = import_module(f"pepperscene.export.{self.module or self.name}")
        getattr(module, f"write_{self.name}")(job, folder)


_COLOUR: Final = (("colour",),)
_DEPTH: Final = (("colour",), DEPTH_OUTPUTS)
_LABELLED_DEPTH: Final = (("colour",), ("class",), ("instance",), DEPTH_OUTPUTS)

_YOLO: Final = ExportFormat(
    "yolo",
    "YOLO segmentation",
    (("colour",), ("instance",)),
    library="cv2",
    # Chosen: 12 pixels are less than one pixel of a network's masks, a quarter as wide as its input.
    smallest_px=12,
    # Keys of `data.yaml` that mean something other than a split to Ultralytics.
    reserved=(
        "channels", "download", "flip_idx", "kpt_names", "kpt_shape", "names", "nc", "path", "yaml_file",
    ),
    has_crowds=False,
)  # fmt: skip

_SCENES: Final = ExportFormat(
    "",
    "",
    _DEPTH,
    "with `class` and `instance` also these of seed points",
    module="reconstruction",
    has_masks=True,
    image_options=frozenset({"mask", "alpha", "undistort"}),
)

_RGBD: Final = ExportFormat(
    "rgbd",
    "RGB-D sequences as of TUM, with ROS's `camera_info`",
    (DEPTH_OUTPUTS,),
    "with `colour` also photographs",
    image_options=frozenset({"mask", "undistort"}),
)

_ALL: Final = (
    ExportFormat(
        "published",
        "folders, names and codes of the published data set",
        (("colour",), ("class",), ("distance_code", "distance")),
        module="mask_folders",
    ),
    ExportFormat(
        "coco",
        "COCO instances and panoptic segments",
        (("colour",), ("instance",)),
        "with `harvest` also amodal masks, poses and keypoints of fruit, with `amodal` amodal masks of all "
        "organs",
        library="pycocotools.mask",
        smallest_px=1,
        reserved=("annotations",),
    ),
    _YOLO,
    replace(_YOLO, name="yolo_detect", description="YOLO detection: boxes", module="yolo", library=""),
    replace(
        _YOLO,
        name="yolo_pose",
        description="YOLO pose: boxes and keypoints of fruit",
        required=(*_YOLO.required, ("harvest",)),
        module="yolo",
        library="",
        classes="pepper",
    ),
    ExportFormat(
        "semantic",
        "images and class masks",
        (*_COLOUR, ("class",)),
        module="mask_folders",
        smallest_px=1,
        has_background=True,
    ),
    ExportFormat("webdataset", "shards for webdataset", (*_COLOUR, ("class",))),
    ExportFormat(
        "huggingface", "Parquet files and a card for Hugging Face's `datasets`", (*_COLOUR, ("class",))
    ),
    replace(_SCENES, name="nerfstudio", description="`transforms.json` for radiance fields and splats"),
    replace(_SCENES, name="colmap", description="a COLMAP model with seed points and their tracks"),
    ExportFormat(
        "ply",
        "a labelled point cloud of each frame",
        _LABELLED_DEPTH,
        module="reconstruction",
        image_options=frozenset({"mask"}),
    ),
    _RGBD,
    replace(
        _RGBD,
        name="rgbd_sensor",
        description="the same with the depth of a depth camera, noise and holes included",
        required=(("depth_sensor",),),
        module="rgbd",
    ),
    ExportFormat(
        "envi",
        "ENVI files of spectral bands, for Spectral Python, GDAL, QGIS and ENVI",
        (BAND_IMAGES,),
        "with `class` also a classification",
        module="bands",
    ),
    ExportFormat(
        "npy",
        "NumPy files of spectral bands, and `bands.json`",
        (BAND_IMAGES,),
        "with `class` and `instance` also these",
        module="bands",
    ),
    ExportFormat(
        "bop",
        "poses, masks and models of fruit as of BOP",
        (("colour",), ("instance",), ("harvest",), DEPTH_OUTPUTS),
        reserved=("models",),
    ),
    ExportFormat(
        "rerun",
        "a recording for the viewer of Rerun",
        _LABELLED_DEPTH,
        library="rerun",
        extra="rerun",
        smallest_px=1,
    ),
    ExportFormat(
        "mcap",
        "a ROS 2 bag: camera, depth, instances and transforms",
        (("colour",), ("instance",), DEPTH_OUTPUTS),
        "with `harvest` also poses and detections of fruit",
        library="mcap_ros2",
        extra="ros",
        smallest_px=1,
        has_clock=True,
    ),
)

FORMATS: Final = {one.name: one for one in _ALL}
"""All formats by name, in the order of the help."""
