"""Export of one plant: its mesh as a file for other programs, and a picture of it in three views."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.memory import check_fits, report_memory_errors
from pepperscene.building.scenes.frame_renderer import RendererFactory, mitsuba_renderer
from pepperscene.building.scenes.plants import grow_plant, growth_stage
from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import Stream, check_seed, random_generator
from pepperscene.recipe.resolve.load_camera import surface_wavelengths

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh
    from pepperscene.render import Renderer
    from pepperscene.scene import Sky

Picture = NDArray[np.uint8]
Point = NDArray[np.float64]

_MAX_DETAIL: Final = 8.0  # chosen: a plant of ten million triangles
_PER_TRIANGLE: Final = 300.0  # bytes of the mesh, its file and its picture; measured 250
_PROCESS, _PICTURE = 300e6, 700e6
"""Bytes of a process that grows a plant, and of the picture; measured 320 MB and 690 MB."""

DISTANCE_M: Final = 0.5
"""Of the second view from the stem: the largest distance of the robot in Barth et al. 2018."""

CLOSE_UP_M: Final = 0.1
"""Of the third view from the skin of a fruit: the smallest distance of the robot."""

_SIZE: Final = (600, 450)  # pixels of the second and the third view, one above the other
_GAP: Final = 8  # white columns and rows between views
_MIN_WIDTH, _MAX_WIDTH = 200, 800  # columns of the first view
_FOCAL_LENGTH_M: Final = 0.00416  # of the paper's lens
_RELATIVE_DISTANCE: Final = 2.0  # of the first view, in extents of the plant
_SKY_LX, _SUN_FRACTION = 5000.0, 0.5  # chosen: soft light, with enough sun to show relief
_SUN: Final = (-0.45, -0.7, 0.6)  # chosen: over the left shoulder of a person in the aisle
_EXPOSURE_S: Final = 1 / 700  # chosen: the sky behind the plant just saturates the sensor
_TRIAL_SIZE: Final = (60, 45)  # chosen: pixels of the label images that select a view
_HEIGHTS: Final = 10  # chosen: tried for the second view
_CANDIDATES: Final = 12  # chosen: organs tried for the third view
_AZIMUTHS: Final = (0.0, -0.6, 0.6, -1.2, 1.2)  # chosen: radians from the aisle, tried for both


@dataclass(frozen=True)
class PlantExport:
    """The result of `export_plant`.

    Attributes:
        files: the mesh's file first, then files that it refers to, and the picture if there is one.
        cultivar: its name.
        organs: number of each kind, in the order of their first occurrence on the plant.
        triangles: of the mesh.
        height_m: of the mesh.
        contacts: fruit and blades that still touch.
        seconds: time of growing and meshing.
    """

    files: tuple[Path, ...]
    cultivar: str
    organs: Mapping[str, int]
    triangles: int
    height_m: float
    contacts: ContactCounts
    seconds: float


def export_plant(
    cultivar: str | Cultivar,
    out: str | Path,
    seed: int = 0,
    *,
    detail: float = 1.0,
    picture: bool = True,
    quality: str = "standard",
    renderer: RendererFactory | None = None,
) -> PlantExport:
    """Grow one plant and write its mesh, with a picture of the same name that ends in `.png`.

    All files are made before the first is written, and all of them are written or none.

    Args:
        cultivar: shipped name or path, or a cultivar, such as a `growth_stage` between two.
        out: the mesh's file; its suffix is the format (see `geometry.mesh_files`). Its folder is made if
            missing, existing files are replaced.
        seed: of the plant.
        detail: fineness of the mesh, 1 as in frames.
        picture: whether to render one.
        quality: of the picture: "draft", "standard" or "reference".
        renderer: makes the renderer of a scene; None for Mitsuba.

    Raises:
        InputError: an argument or a cultivar is not valid; nothing is written.
        OutputError: a file cannot be written.
        SetupError: the machine cannot render, or has not enough memory; nothing is written.
    """
    from pepperscene.geometry import check_mesh_format, mesh_files
    from pepperscene.geometry.triangle_counts import max_triangles
    from pepperscene.grammar import draw_parameters
    from pepperscene.render import find_quality

    # Check all arguments before anything grows.
    path = Path(out)
    check_mesh_format(path)
    find_quality(quality)
    check_seed(seed)
    if not 0.0 < detail <= _MAX_DETAIL:
        raise ArgumentError("detail", f"must be above 0 and at most {_MAX_DETAIL:g}, not {detail:g}")
    picture_path = path.with_suffix(".png")
    check_can_write(path.parent, [path.name, picture_path.name] if picture else [path.name])

    cultivar_stage = growth_stage(cultivar)
    parameters = draw_parameters(cultivar_stage, random_generator(seed, Stream.PLANT, 0, 0))
    size = _PROCESS + _PICTURE * picture + _PER_TRIANGLE * detail**2 * max_triangles(parameters)
    check_fits(size, f"{cultivar_stage.name}: a plant of detail {detail:g}", "use a smaller detail")

    with report_memory_errors():
        # The plant.
        start = time.perf_counter()
        plant = grow_plant(cultivar_stage, seed, detail=detail)
        seconds = time.perf_counter() - start

        # Its files.
        files = mesh_files(plant.mesh, path.name)
        if picture:
            files[picture_path.name] = _picture_file(plant.mesh, cultivar_stage, quality, renderer)
    return PlantExport(
        files=write_files(path.parent, files),
        cultivar=cultivar_stage.name,
        organs=dict(Counter(instance.kind for instance in plant.mesh.instances)),
        triangles=len(plant.mesh.faces),
        height_m=float(np.ptp(plant.mesh.vertices[:, 2])),
        contacts=plant.contacts,
        seconds=seconds,
    )


def _picture_file(mesh: Mesh, cultivar: Cultivar, quality: str, renderer: RendererFactory | None) -> bytes:
    """The picture of a plant as a PNG file."""
    from PIL import Image

    stream = BytesIO()
    image = Image.fromarray(portrait(mesh, cultivar, quality, renderer))
    image.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def portrait(
    mesh: Mesh, cultivar: Cultivar, quality: str = "standard", renderer: RendererFactory | None = None
) -> Picture:
    """Render a plant in sun and soft daylight before a white background, in three views on one image.

    The whole plant through a long lens; from 50 cm where most fruit is visible; and a close-up of the least
    hidden fruit. Without fruit, leaves are shown instead.

    Args:
        mesh: of one plant, metres, its foot at the origin, the aisle at -y.
        cultivar: for the colours of its surfaces.
        quality: "draft", "standard" or "reference".
        renderer: makes the renderer of a scene; None for Mitsuba.

    Returns:
        `(h, w, 3)` sRGB.

    Raises:
        SetupError: the machine cannot render.
    """
    from pepperscene.materials import greenhouse_surfaces, organ_surfaces
    from pepperscene.scene import assemble_scene

    nm = surface_wavelengths(_paper_camera(_SIZE, _FOCAL_LENGTH_M).sensor)
    surfaces = {**organ_surfaces(cultivar, nm), **greenhouse_surfaces(nm)}
    scene_renderer = (renderer or mitsuba_renderer)(assemble_scene(mesh, surfaces, _white_sky()))
    cameras = (_plant_camera(mesh), _medium_camera(mesh, scene_renderer), _close_up(mesh, scene_renderer))
    first, *further = (scene_renderer.render(camera, ["colour"], quality)["colour"] for camera in cameras)

    # The first view on the left, the others on the right, white between them.
    height = max(first.shape[0], sum(view.shape[0] for view in further) + _GAP * (len(further) - 1))
    width = first.shape[1] + _GAP + max(view.shape[1] for view in further)
    picture = np.full((height, width, 3), 255, np.uint8)
    picture[: first.shape[0], : first.shape[1]] = first
    row = 0
    for view in further:
        picture[row : row + view.shape[0], first.shape[1] + _GAP :][:, : view.shape[1]] = view
        row += view.shape[0] + _GAP
    return picture


def _plant_camera(mesh: Mesh) -> Camera:
    """The camera that shows the whole plant, in an image as high as both other views together."""
    low, high = mesh.vertices.min(axis=0).astype(float), mesh.vertices.max(axis=0).astype(float)
    middle, width, height = 0.5 * (low + high), high[0] - low[0], high[2] - low[2]
    rows = 2 * _SIZE[1] + _GAP
    columns = int(np.clip(1.1 * rows * width / height, _MIN_WIDTH, _MAX_WIDTH)) if height > 0 else _MAX_WIDTH
    # Height or width, whichever needs the shorter lens, with a margin of a twentieth.
    extent = 1.05 * max(height, width * rows / columns)
    distance = _RELATIVE_DISTANCE * extent + 0.5 * (high[1] - low[1])
    focal_length = distance / extent * rows * _paper_camera((columns, rows), 1.0).sensor.pixel_pitch_m
    return _aim(_paper_camera((columns, rows), focal_length), middle - np.array([0.0, distance, 0.0]), middle)


def _medium_camera(mesh: Mesh, renderer: Renderer) -> Camera:
    """The camera level with the stem and 50 cm away that sees most fruit."""
    top = float(mesh.vertices[:, 2].max())
    stem = mesh.vertices[mesh.faces[mesh.face_class == OrganClass.STEM].ravel()]
    trials, scores = [], []
    for height in np.linspace(0.15, 0.9, _HEIGHTS) * top:
        near = stem[np.abs(stem[:, 2] - height) < 0.1 * top]
        target = np.array([*near[:, :2].mean(axis=0), height]) if len(near) else np.array([0.0, 0.0, height])
        for azimuth in _AZIMUTHS[:3]:
            position = target + DISTANCE_M * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
            trials.append((position, target))
            classes = _trial(renderer, position, target, "class")
            # Leaves only decide between views with the same fruit.
            scores.append((classes == OrganClass.PEPPER).sum() + 1e-3 * (classes == OrganClass.LEAF).sum())
    return _aim(_paper_camera(_SIZE, _FOCAL_LENGTH_M), *trials[int(np.argmax(scores))])


def _close_up(mesh: Mesh, renderer: Renderer) -> Camera:
    """The camera close to the fruit that is hidden least."""
    classes = np.array([instance.organ_class for instance in mesh.instances])
    kinds = (OrganClass.PEPPER, OrganClass.LEAF)
    kind = next((organ_class for organ_class in kinds if (classes == organ_class).any()), None)
    organs = np.flatnonzero(classes == kind) if kind is not None else np.arange(len(classes))
    organs = organs[np.unique(np.linspace(0, len(organs) - 1, _CANDIDATES).astype(int))]
    trials, scores = [], []
    for organ in organs:
        vertices = mesh.vertices[mesh.faces[mesh.face_instance == organ].ravel()]
        # A little above the middle, so that the calyx is visible.
        low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
        target = 0.5 * (low + high) + np.array([0.0, 0.0, 0.15 * (high[2] - low[2])])
        distance = CLOSE_UP_M + 0.25 * (high - low)[:2].sum()
        for azimuth in _AZIMUTHS:
            position = target + distance * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
            trials.append((position, target))
            scores.append((_trial(renderer, position, target, "instance") == organ + 1).sum())
    return _aim(_paper_camera(_SIZE, _FOCAL_LENGTH_M), *trials[int(np.argmax(scores))])


def _trial(renderer: Renderer, position: Point, target: Point, output: str) -> NDArray[np.integer]:
    """A small label image of a view."""
    camera = _paper_camera(_TRIAL_SIZE, _FOCAL_LENGTH_M * _TRIAL_SIZE[0] / _SIZE[0])
    return renderer.render(_aim(camera, position, target), [output])[output]


def _paper_camera(size: tuple[int, int], focal_length_m: float) -> Camera:
    """The paper's sensor, with this number of columns and rows, behind a lens of this focal length."""
    from pepperscene.camera import Camera, Developing, load_lens, load_sensor

    sensor = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=size[0], rows=size[1])
    lens = dataclasses.replace(load_lens("lensagon_cmfa0420nd"), focal_length_m=focal_length_m)
    steps = Developing(falloff=False, shot_noise=False, read_noise=False, white_balance="daylight")
    return Camera(lens, sensor, exposure_s=_EXPOSURE_S, developing=steps)


def _aim(camera: Camera, position: Point, target: Point) -> Camera:
    from pepperscene.camera import look_at

    return camera.at_pose(look_at(position, target))


def _white_sky() -> Sky:
    """A uniform white sky on all sides, and the sun."""
    from pepperscene.scene import Sun, uniform_sky
    from pepperscene.spectra import scale_to_illuminance, sky_spectrum, sun_spectrum

    direction = np.array(_SUN) / np.linalg.norm(_SUN)
    sun = Sun(direction, scale_to_illuminance(sun_spectrum(), _SUN_FRACTION * _SKY_LX))
    return dataclasses.replace(uniform_sky(sky_spectrum("d65"), (1.0 - _SUN_FRACTION) * _SKY_LX), sun=sun)
