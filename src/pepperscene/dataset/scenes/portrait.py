"""A picture of one plant: the whole of it, from 50 cm, and from close by."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.recipe.equipment import surface_wavelengths

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.dataset.scenes.frame_renderer import RendererFactory, SceneRenderer
    from pepperscene.geometry import Mesh
    from pepperscene.scene import Sky


Picture = NDArray[np.uint8]

FAR_M: Final = 0.5
"""Distance of the second view from the stem: the farthest of the robot's in Barth et al. 2018."""

NEAR_M: Final = 0.1
"""Distance of the third from the skin of a fruit: the nearest of the robot's."""

_VIEW: Final = (600, 450)  # pixels of the second and the third view, one above the other
_GAP: Final = 8  # white columns and rows between views
_NARROWEST, _WIDEST = 200, 800  # columns of the first view
_FOCAL_M: Final = 0.00416  # of the paper's lens
_BACK: Final = 2.0  # the first view is taken from so many times the plant's extent
_SKY_LX, _SUN_SHARE = 5000.0, 0.5  # chosen: soft light, with enough sun to show relief
_SUN: Final = (-0.45, -0.7, 0.6)  # chosen: over the left shoulder of one who stands in the aisle
_EXPOSURE_S: Final = 1 / 700  # chosen: the sky behind the plant just fills the sensor
_TRIAL: Final = (60, 45)  # pixels of the label images that choose a view
_LEVELS: Final = 10  # heights that are tried for the second view
_CANDIDATES: Final = 12  # organs that are tried for the third
_AZIMUTHS: Final = (0.0, -0.6, 0.6, -1.2, 1.2)  # radians from the aisle that are tried


def portrait(
    mesh: Mesh, cultivar: Cultivar, quality: str = "standard", renderer: RendererFactory | None = None
) -> Picture:
    """A plant in sun and soft daylight before a white ground, in three views on one sheet.

    The whole plant through a long lens; from 50 cm where most fruit is seen; and from close by the fruit that
    is least hidden. Where there is no fruit, leaves take its place.

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
    from pepperscene.dataset.scenes.frame_renderer import mitsuba_renderer
    from pepperscene.materials import greenhouse_surfaces, organ_surfaces
    from pepperscene.scene import assemble_scene

    nm = surface_wavelengths(_camera(_VIEW, _FOCAL_M).sensor)
    surfaces = {**organ_surfaces(cultivar, nm), **greenhouse_surfaces(nm)}
    stage = (renderer or mitsuba_renderer)(assemble_scene(mesh, surfaces, _light()))
    cameras = (_whole(mesh), _far(mesh, stage), _near(mesh, stage))
    views = [stage.render(one, ["colour"], quality)["colour"] for one in cameras]
    return _sheet(views)


def _whole(mesh: Mesh) -> Camera:
    """All of the plant, as high as both other views together."""
    low, high = mesh.vertices.min(axis=0).astype(float), mesh.vertices.max(axis=0).astype(float)
    middle, wide, tall = 0.5 * (low + high), high[0] - low[0], high[2] - low[2]
    rows = 2 * _VIEW[1] + _GAP
    columns = int(np.clip(1.1 * rows * wide / tall, _NARROWEST, _WIDEST)) if tall > 0 else _WIDEST
    # Whichever of height and width needs the shorter lens, with a margin of a twentieth.
    extent = 1.05 * max(tall, wide * rows / columns)
    distance = _BACK * extent + 0.5 * (high[1] - low[1])
    camera = _camera((columns, rows), 1.0)
    focal = distance / extent * rows * camera.sensor.pixel_pitch_m
    return _placed(_camera((columns, rows), focal), middle - np.array([0.0, distance, 0.0]), middle)


def _far(mesh: Mesh, stage: SceneRenderer) -> Camera:
    """Level with the stem and 50 cm away, where most of the fruit is seen."""
    top = float(mesh.vertices[:, 2].max())
    stem = mesh.vertices[mesh.faces[mesh.face_class == OrganClass.STEM].ravel()]
    trials, scores = [], []
    for level in np.linspace(0.15, 0.9, _LEVELS) * top:
        near = stem[np.abs(stem[:, 2] - level) < 0.1 * top]
        axis = np.array([*near[:, :2].mean(axis=0), level]) if len(near) else np.array([0.0, 0.0, level])
        for azimuth in _AZIMUTHS[:3]:
            place = axis + FAR_M * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
            trials.append((place, axis))
            seen = _trial(stage, place, axis, "class")
            # Leaves only decide where there is as much fruit.
            scores.append((seen == OrganClass.PEPPER).sum() + 1e-3 * (seen == OrganClass.LEAF).sum())
    return _placed(_camera(_VIEW, _FOCAL_M), *trials[int(np.argmax(scores))])


def _near(mesh: Mesh, stage: SceneRenderer) -> Camera:
    """Close to the fruit that shows most."""
    classes = np.array([one.organ_class for one in mesh.instances])
    wanted = next((one for one in (OrganClass.PEPPER, OrganClass.LEAF) if (classes == one).any()), None)
    organs = np.flatnonzero(classes == wanted) if wanted is not None else np.arange(len(classes))
    organs = organs[np.unique(np.linspace(0, len(organs) - 1, _CANDIDATES).astype(int))]
    trials, scores = [], []
    for organ in organs:
        own = mesh.vertices[mesh.faces[mesh.face_instance == organ].ravel()]
        # A little above the middle, so that the calyx is in the picture.
        low, high = own.min(axis=0).astype(float), own.max(axis=0).astype(float)
        middle = 0.5 * (low + high) + np.array([0.0, 0.0, 0.15 * (high[2] - low[2])])
        away = NEAR_M + 0.25 * (high - low)[:2].sum()
        for azimuth in _AZIMUTHS:
            place = middle + away * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
            trials.append((place, middle))
            scores.append((_trial(stage, place, middle, "instance") == organ + 1).sum())
    return _placed(_camera(_VIEW, _FOCAL_M), *trials[int(np.argmax(scores))])


def _trial(
    stage: SceneRenderer, place: NDArray[np.float64], target: NDArray[np.float64], output: str
) -> NDArray[np.integer]:
    """A small label image of a view."""
    focal = _FOCAL_M * _TRIAL[0] / _VIEW[0]
    frame = stage.render(_placed(_camera(_TRIAL, focal), place, target), [output])
    return frame[output]


def _camera(size: tuple[int, int], focal_m: float) -> Camera:
    """The paper's sensor, cut to so many columns and rows, behind a lens of this focal length."""
    from pepperscene.camera import Camera, Developing, load_lens, load_sensor

    sensor = dataclasses.replace(load_sensor("ueye_ui5250re"), columns=size[0], rows=size[1])
    lens = dataclasses.replace(load_lens("lensagon_cmfa0420nd"), focal_length_m=focal_m)
    steps = Developing(falloff=False, shot_noise=False, read_noise=False, white_balance="daylight")
    return Camera(lens, sensor, exposure_s=_EXPOSURE_S, developing=steps)


def _placed(camera: Camera, place: NDArray[np.float64], target: NDArray[np.float64]) -> Camera:
    from pepperscene.camera import look_at

    return camera.at_pose(look_at(place, target))


def _light() -> Sky:
    """An even white sky all around, and the sun."""
    from pepperscene.scene import Sun, uniform_sky
    from pepperscene.spectra import sky_spectrum, sun_spectrum, with_illuminance

    direction = np.array(_SUN) / np.linalg.norm(_SUN)
    sun = Sun(direction, with_illuminance(sun_spectrum(), _SUN_SHARE * _SKY_LX))
    return dataclasses.replace(uniform_sky(sky_spectrum("d65"), (1.0 - _SUN_SHARE) * _SKY_LX), sun=sun)


def _sheet(views: Sequence[Picture]) -> Picture:
    """The first view on the left, the others on the right, white between."""
    whole, *others = views
    width = max(one.shape[1] for one in others)
    height = max(whole.shape[0], sum(one.shape[0] for one in others) + _GAP * (len(others) - 1))
    sheet = np.full((height, whole.shape[1] + _GAP + width, 3), 255, np.uint8)
    sheet[: whole.shape[0], : whole.shape[1]] = whole
    row = 0
    for one in others:
        sheet[row : row + one.shape[0], whole.shape[1] + _GAP :][:, : one.shape[1]] = one
        row += one.shape[0] + _GAP
    return sheet
