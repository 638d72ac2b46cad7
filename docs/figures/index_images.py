"""Draws the small pictures of the index page into docs/images/index; run it after a change that they show.

    python docs/figures/index_images.py [NAME ...]

Renderings and a fit are cached in the folder `pepperscene_index_images` of the system's folder for temporary
files, so that a second run takes seconds. Remove it to render again.
"""

from __future__ import annotations

import functools
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.patches import Circle, FancyBboxPatch
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
from pycocotools import mask as coco_mask
from skimage.color import lab2rgb

import pepperscene as ps
from pepperscene.building.scenes.plant_export import portrait
from pepperscene.camera import spline_trajectory
from pepperscene.colour.comparison import similarity
from pepperscene.colour.statistics import bin_angles
from pepperscene.render.quality import Quality
from pepperscene.review.report.colours import distance_colours, instance_colours
from pepperscene.tuning import RunInfo, TuningTarget, fit_parameters, write_tuned

ROOT: Final = Path(__file__).parents[2]
IMAGES: Final = ROOT / "docs" / "images"
CACHE: Final = Path(tempfile.gettempdir()) / "pepperscene_index_images"
WIDTH, HEIGHT = 240, 160
BRIGHTER: Final = 1.8
"""Factor on the codes of photographs: the flash leaves most of a frame dark, too dark for a small picture."""
FRAME: Final = 6137
INK: Final = "#333333"
GREY: Final = "#999999"
GREEN, RED, BLUE, ORANGE = "#3c7a32", "#c0392b", "#2c6fbb", "#d98c21"
PALE: Final = "#e8f0e4"
FONT_PT: Final = 7.0
DPI: Final = 100
KINDS: Final = ("leaf", "pepper.unripe", "pepper.ripe")
FITTED: Final[dict[str, ArrayLike]] = {
    "leaf.chlorophyll": 38.0,
    "fruit.chlorophyll": 11.0,
    "fruit.capsanthin": 12.0,
}

Picture = NDArray[np.uint8]


# --- what the program makes ------------------------------------------------------------------------------


@functools.cache
def demo_set() -> ps.Dataset:
    """The six frames of `demo`, at draft quality."""
    folder = CACHE / "demo"
    outputs = ["colour", "class", "instance", "distance", "harvest"]
    ps.build(ps.load_recipe("demo"), folder, outputs=outputs, options=ps.BuildOptions("draft"))
    return ps.open_dataset(folder)


@functools.cache
def red_set() -> Path:
    """Two frames of the same plan with a red cultivar."""
    recipe = ps.load_recipe("demo", {"cultivar": "red_blocky"})
    outputs = ["colour", "class", "instance"]
    ps.build(recipe, CACHE / "red", [2290, FRAME], outputs, ps.BuildOptions("draft"))
    return CACHE / "red"


@functools.cache
def photograph(index: int = FRAME) -> Picture:
    """A photograph of the demo set, brightened."""
    codes = demo_set().image(index, "colour").astype(float)
    return np.clip(codes * BRIGHTER, 0, 255).astype(np.uint8)


def class_image(index: int = FRAME) -> Picture:
    """A class image of the demo set in the published colours."""
    return ps.class_colour(demo_set().image(index, "class"))


def distance_image(index: int = FRAME) -> Picture:
    """A distance image of the demo set in colours."""
    return distance_colours(demo_set().image(index, "distance"), 0.2, 1.2)


def cached(name: str, render: Callable[[], Picture]) -> Picture:
    """A picture from the cache; it is rendered if it is missing."""
    path = CACHE / f"{name}.png"
    if not path.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        Image.fromarray(render()).save(path)
    return np.asarray(Image.open(path).convert("RGB"))


@functools.cache
def tuning_folder() -> Path:
    """The files of a fit to patches that were simulated at known values."""
    folder = CACHE / "tuned"
    if not folder.exists():
        recipe = ps.load_recipe("barth2018", {"cultivar": "red_blocky"})
        few = {"organs": 1, "pixels": 24}
        patches = ps.simulate_patches(recipe, FITTED, KINDS, **few)
        target = TuningTarget(recipe, patches, registered=True, **few)
        fit = fit_parameters(target, target.problem(list(FITTED)), starts=1)
        write_tuned(recipe, fit, folder, RunInfo.of(patches, date(2026, 1, 31)), extends="barth2018")
    return folder


@functools.cache
def tuning_record() -> dict[str, Any]:
    """The file `tuning.json` of that fit."""
    record: dict[str, Any] = json.loads((tuning_folder() / "tuning.json").read_text(encoding="utf-8"))
    return record


@functools.cache
def plant() -> ps.Plant:
    """A plant of Kaite."""
    return ps.grow(ps.load_cultivar("kaite"), np.random.default_rng(3))


def small_frame(
    name: str, recipe: str, index: int, size: tuple[int, int], changes: dict[str, Any]
) -> Picture:
    """A cached photograph of a recipe with few plants and another size of the image."""
    few = {"row.plants_front": 5, "row.plants_back": 4, "camera.width": size[0], "camera.height": size[1]}

    def render() -> Picture:
        renderer = ps.FrameRenderer(ps.load_recipe(recipe, {**few, **changes}))
        return renderer.render(renderer.recipe.plan.frame(index), ("colour",), "draft").colour

    return cached(name, render)


# --- tools -----------------------------------------------------------------------------------------------


def fill(
    picture: Picture, size: tuple[int, int] = (WIDTH, HEIGHT), centre: tuple[float, float] = (0.5, 0.5)
) -> Image.Image:
    """A picture scaled and cropped to a size; `centre` is the position of the crop, each in [0, 1]."""
    image = Image.fromarray(picture)
    scale = max(size[0] / image.width, size[1] / image.height)
    width, height = size[0] / scale, size[1] / scale
    # Rounding errors must not put the box outside the picture.
    left, top = (max(0.0, a - b) * c for a, b, c in zip(image.size, (width, height), centre, strict=True))
    width, height = min(width, image.width), min(height, image.height)
    return image.resize(size, Image.Resampling.LANCZOS, (left, top, left + width, top + height))


def crop(picture: Picture, left: int, top: int, width: int) -> Image.Image:
    """The part of a picture with this left upper corner and width, at the size of the small pictures."""
    box = (left, top, left + width, top + width * HEIGHT / WIDTH)
    return Image.fromarray(picture).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS, box)


def white() -> Image.Image:
    """An empty picture."""
    return Image.new("RGB", (WIDTH, HEIGHT), "white")


def font(size: int, *, mono: bool = False, bold: bool = False) -> ImageFont.FreeTypeFont:
    """A font that matplotlib brings."""
    family = "DejaVu Sans Mono" if mono else "DejaVu Sans"
    return ImageFont.truetype(
        findfont(FontProperties(family=family, weight="bold" if bold else "normal")), size
    )


def caption(image: Image.Image, place: tuple[int, int], text: str, size: int = 10) -> None:
    """Write white text on a dark ground; `place` is its left upper corner."""
    draw = ImageDraw.Draw(image)
    left, top, right, bottom = draw.textbbox(place, text, font=font(size, bold=True))
    draw.rectangle((left - 3, top - 2, right + 2, bottom + 2), fill="#222222")
    draw.text(place, text, fill="white", font=font(size, bold=True))


def canvas() -> tuple[Figure, Axes]:
    """A figure of the size of the small pictures, and axes in pixels with y downwards that fill it."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(HEIGHT, 0))
    axes.axis("off")
    return figure, axes


def chart(
    left: float = 0.14, bottom: float = 0.21, right: float = 0.97, top: float = 0.96
) -> tuple[Figure, Axes]:
    """A figure with one chart; the numbers are the edges of its axes as fractions of the figure."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
    axes = figure.add_axes((left, bottom, right - left, top - bottom))
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=FONT_PT, length=2, pad=1.5, width=0.6)
    return figure, axes


def drawn(figure: Figure) -> Image.Image:
    """A figure as a picture."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, facecolor="white")
    return Image.open(buffer).convert("RGB")


def box(
    axes: Axes, centre: tuple[float, float], size: tuple[float, float], text: str, colour: str = PALE
) -> None:
    """A box with text, in pixels."""
    corner = (centre[0] - size[0] / 2, centre[1] - size[1] / 2)
    shape = FancyBboxPatch(corner, *size, boxstyle="round,pad=0,rounding_size=3", fc=colour, ec=INK, lw=0.7)
    axes.add_patch(shape)
    middle = {"ha": "center", "va": "center" if "\n" in text else "center_baseline"}
    axes.text(*centre, text, **middle, fontsize=min(FONT_PT, 0.55 * size[1]), color=INK, linespacing=1.1)


def arrow(axes: Axes, start: ArrayLike, end: ArrayLike, colour: str = INK, width: float = 1.0) -> None:
    """An arrow from start to end."""
    style = {"arrowstyle": "-|>,head_width=0.18,head_length=0.35", "color": colour, "lw": width}
    axes.annotate("", end, start, arrowprops={**style, "shrinkA": 0, "shrinkB": 0})


def terminal(lines: Sequence[tuple[str, str]], size: int = 10, step: int = 11) -> Image.Image:
    """Lines of (text, colour) as in a terminal."""
    image = Image.new("RGB", (WIDTH, HEIGHT), "#1e1e1e")
    draw = ImageDraw.Draw(image)
    for row, (text, colour) in enumerate(lines):
        draw.text((6, 5 + row * step), text, fill=colour, font=font(size, mono=True))
    return image


def draw_mesh(axes: Axes, mesh: ps.Mesh, azimuth_rad: float, colours: dict[str, str] | None = None) -> None:
    """Draw a mesh from the side, far faces first, with simple shading."""
    view = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    across = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    corners = mesh.vertices[mesh.faces]
    points = np.stack([corners @ across, corners[..., 2]], axis=-1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    light = np.array([0.0, 0.0, 0.5]) - 0.8 * view - 0.3 * across
    shade = 0.55 + 0.45 * np.abs(normals @ light / np.linalg.norm(light))
    palette = {"lamina": "#4f9a3d", "shoot_lamina": "#4f9a3d", "fruit": "#f0c030", "calyx": "#7db04a"}
    palette |= colours or {}
    kinds = [palette.get(one.kind, "#9aaf6a") for one in mesh.instances]
    rgb = np.array([[int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)] for code in kinds])
    faces = rgb[mesh.face_instance] * shade[:, None]
    order = np.argsort(-(corners @ view).mean(axis=1))
    axes.add_collection(
        PolyCollection(points[order], facecolors=faces[order], edgecolors=faces[order], lw=0.2)
    )
    axes.set_aspect("equal")
    axes.axis("off")


def hex_colour(rgb: ArrayLike) -> str:
    """A colour with components in [0, 1] as text."""
    codes = np.rint(np.clip(rgb, 0, 1) * 255).astype(int)
    return "#" + "".join(f"{code:02x}" for code in codes)


# --- tutorials -------------------------------------------------------------------------------------------


def quickstart() -> Image.Image:
    """A photograph beside its class image."""
    image = white()
    for left, part in ((0, photograph()), (121, class_image())):
        image.paste(fill(part, (119, HEIGHT), (0.12, 0.5)), (left, 0))
    return image


def robot_data_set() -> Image.Image:
    """Fruit with bounding boxes, out of a picture of the page."""
    return fill(np.asarray(Image.open(IMAGES / "robot" / "yolo.jpg").convert("RGB")))


def gallery() -> Image.Image:
    """A photograph of each of four recipes."""
    image = white()
    frames = {"barth2018_robot": 4, "randomised": 203, "season": 32, "realsense": 3}
    for number, (name, index) in enumerate(frames.items()):
        size = {"camera.hfov_deg": 69} if name == "realsense" else {}
        picture = small_frame(f"gallery_{name}", name, index, (238, 158), size)
        image.paste(fill(picture, (119, 79)), (121 * (number % 2), 81 * (number // 2)))
    return image


def fruit_segmenter() -> Image.Image:
    """A photograph, and in orange the fruit that the network of the tutorial finds in it."""
    picture = np.asarray(Image.open(ROOT / "docs" / "photos" / "img9.png").convert("RGB"))
    model = ps.load_model(ROOT / "out" / "fruit" / "model")
    fruit = ps.predict_classes(model, picture) == model.classes.names.index("fruit")
    found = picture.astype(float)
    found[fruit] = 0.4 * found[fruit] + 0.6 * np.array([255, 120, 0])
    image = white()
    for left, half in ((0, picture), (121, found.astype(np.uint8))):
        image.paste(fill(half, (119, 160)), (left, 0))
    return image


def first_frame() -> Image.Image:
    """The mesh of a plant, and a photograph."""
    figure, axes = canvas()
    plant_axes = figure.add_axes((0, 0, 0.25, 1))
    mesh = ps.mesh_plant(plant(), detail=0.5)
    draw_mesh(plant_axes, mesh, 0.4)
    plant_axes.set(xlim=(-0.215, 0.215), ylim=(1.45, 2.6))
    arrow(axes, (64, 80), (81, 80))
    image = drawn(figure)
    image.paste(fill(photograph(4940), (156, HEIGHT)), (84, 0))
    return image


def dataset() -> Image.Image:
    """The folders of a data set with their files."""
    image, indices = white(), (110, 2290, 4940)
    draw = ImageDraw.Draw(image)
    data = demo_set()
    rows = {
        "colour": photograph,
        "class": class_image,
        "instance": lambda index: instance_colours(data.image(index, "instance")),
        "distance": distance_image,
    }
    for row, (name, picture) in enumerate(rows.items()):
        draw.text((4, 13 + 40 * row), f"{name}/", fill=INK, font=font(11, mono=True))
        for column, index in enumerate(indices):
            image.paste(fill(picture(index), (54, 37)), (72 + 56 * column, 2 + 40 * row))
    return image


def colour_tuning() -> Image.Image:
    """Six of the single organs that a fit compares: leaves, unripe and ripe fruit."""
    return crop(np.asarray(Image.open(IMAGES / "tuning_views.png").convert("RGB")), 0, 0, 456)


# --- how-to guides ---------------------------------------------------------------------------------------


def build() -> Image.Image:
    """A contact sheet of the six frames."""
    image = white()
    for i, index in enumerate(demo_set().indices()):
        image.paste(fill(photograph(index), (79, 79)), (81 * (i % 3) - (i % 3 == 2), 81 * (i // 3)))
    return image


def camera() -> Image.Image:
    """The same view with three fields of view."""
    image = white()
    for column, angle in enumerate((35, 60, 100)):
        changes = {"camera.hfov_deg": angle, "views.distance_mm": 500}
        picture = small_frame(f"camera_{angle}", "greenhouse", 1, (158, 320), changes)
        image.paste(fill(picture, (79, HEIGHT)), (81 * column - (column == 2), 0))
        caption(image, (81 * column + 6, 5), f"{angle}\N{DEGREE SIGN}")
    return image


def views() -> Image.Image:
    """From above: a path along the row, poses on an arc, and random views of fruit."""
    figure, axes = canvas()
    scale, origin = 130.0, np.array([120.0, 30.0])

    def view(position: ArrayLike, forward: ArrayLike, colour: str) -> None:
        place, along = origin + np.multiply(position, [scale, -scale]), np.multiply(forward, [1.0, -1.0])
        across = np.array([-along[1], along[0]])
        sides = [place + 16 * along + side * 8 * across for side in (-1, 1)]
        axes.fill(*np.transpose([place, *sides]), color=colour, alpha=0.25, lw=0)
        axes.plot(*np.transpose([sides[0], place, sides[1]]), color=colour, lw=0.7)

    for x in np.arange(-3, 4) * 0.26:
        axes.add_patch(Circle((origin[0] + scale * x, origin[1]), 13, fc="#8fc07c", ec=GREEN, lw=0.8))
    for pose in ps.arc_path(5, 0.5, (-1.0, 1.0), (1.0, 1.0), 0.0):
        view(pose[:2, 3], pose[:2, 2], ORANGE)
    points = [[-0.85, -0.82, 1], [-0.3, -0.72, 1], [0.3, -0.82, 1], [0.85, -0.74, 1]]
    path = spline_trajectory(points, 0.3, 60, azimuth_rad=0.0)
    places = origin + path.poses[:, :2, 3] * [scale, -scale]
    axes.plot(*places.T, color=BLUE, lw=1.4)
    arrow(axes, places[-3], places[-1], BLUE, 1.4)
    for pose in path.poses[6::15]:
        view(pose[:2, 3], pose[:2, 2], BLUE)
    rng = np.random.default_rng(7)
    for fruit in ((-0.66, -0.1), (0.66, -0.1)):
        axes.plot(*(origin + np.multiply(fruit, [scale, -scale])), "o", color=RED, ms=4, zorder=4)
        for angle in (-0.7, -0.1, 0.6):
            direction = np.array([-np.sin(angle), np.cos(angle)])
            view(np.array(fruit) - rng.uniform(0.25, 0.45) * direction, direction, RED)
    return drawn(figure)


def visibility() -> Image.Image:
    """The best and the worst view of a fruit: parts of the picture of the page on visibility."""
    picture = np.asarray(Image.open(IMAGES / "visibility.png").convert("RGB"))
    image = white()
    for place, left, text in ((0, 561, "best view"), (121, 953, "worst view")):
        image.paste(Image.fromarray(picture[62:222, left : left + 119]), (place, 0))
        caption(image, (place + 5, 145), text, 9)
    return image


def live() -> Image.Image:
    """A view of fruit in natural class colours, before and after the most visible one is picked."""
    size = {"camera.width": 240, "camera.height": 320}
    scene = ps.open_scene("barth2018", 125, **size)
    image = white()
    for place in (0, 121):
        picture = ps.class_colour(scene.render()["class"])
        image.paste(fill(picture, (119, HEIGHT)), (place, 0))
        scene.pick(max(scene.fruit, key=lambda one: one.visible_fraction).instance)
    return image


def vary() -> Image.Image:
    """Six frames of `randomised`."""
    image = white()
    for number, index in enumerate((3, 56, 110, 161, 214, 268)):
        picture = small_frame(f"vary_{index}", "randomised", index, (160, 160), {})
        image.paste(fill(picture, (79, 79)), (81 * (number % 3) - (number % 3 == 2), 81 * (number // 3)))
    return image


def stand() -> Image.Image:
    """A plant on a turntable: part of the picture of the page on stands."""
    picture = np.asarray(Image.open(IMAGES / "stand.jpg").convert("RGB"))
    return fill(picture[:305, :405], (WIDTH, HEIGHT), (0.5, 0.6))


def motion() -> Image.Image:
    """The same photograph from a camera that stands still, and from one that moves."""
    image = white()
    path = {"kind": "path", "points_mm": [[-300, -500, 1400], [300, -500, 1400]], "speed_mm_s": 1000}
    for column, (name, moves) in enumerate((("stands still", False), ("1 m/s, 20 ms", True))):
        changes = {f"views.{key}": value for key, value in {**path, "motion": moves}.items()}
        changes |= {"plan.frames": 3, "camera.hfov_deg": 40}
        changes |= {"camera.exposure_us": 20_000, "daylight.illuminance_lx": 5000}
        picture = small_frame(f"motion_{moves}", "greenhouse", 1, (238, 320), changes)
        image.paste(fill(picture, (119, HEIGHT)), (121 * column, 0))
        caption(image, (121 * column + 6, 5), name)
    return image


def depth() -> Image.Image:
    """An infrared image with dots, and the measured depth, from the picture of the page."""
    page = np.asarray(Image.open(IMAGES / "depth_camera.jpg").convert("RGB"))
    image = white()
    for left, (row, column) in ((0, (0, 1)), (121, (1, 0))):
        part = page[364 * row + 20 : 364 * row + 360, 644 * column + 100 : 644 * column + 540]
        image.paste(fill(part, (119, HEIGHT)), (left, 0))
    return image


def bands() -> Image.Image:
    """False colour with the near infrared, and NDVI, from the picture of the page."""
    page = np.asarray(Image.open(IMAGES / "bands.jpg").convert("RGB"))
    image = white()
    for left, (row, column) in ((0, (0, 1)), (121, (1, 1))):
        part = page[482 * row + 120 : 482 * row + 460, 642 * column + 160 : 642 * column + 410]
        image.paste(fill(part, (119, HEIGHT)), (left, 0))
    return image


def bands_notebook() -> Image.Image:
    """Spectra of leaves, from the picture of the page on bands."""
    page = Image.open(IMAGES / "band_spectra.png").convert("RGB")
    image = white()
    part = page.crop((0, 25, page.width // 2 + 8, page.height))
    scale = min(WIDTH / part.width, HEIGHT / part.height)
    part = part.resize((round(part.width * scale), round(part.height * scale)), Image.Resampling.LANCZOS)
    image.paste(part, ((WIDTH - part.width) // 2, (HEIGHT - part.height) // 2))
    return image


def own_spectrum() -> Image.Image:
    """A measured leaf, and its NDVI, from the picture of the page."""
    page = np.asarray(Image.open(IMAGES / "own_spectrum.jpg").convert("RGB"))
    image = white()
    for place, left in ((0, 648), (121, 972)):
        image.paste(fill(page[:284, left : left + 320], (119, HEIGHT)), (place, 0))
    return image


def isp() -> Image.Image:
    """A view without an image signal processor, and by a webcam's, from the picture of the page."""
    page = np.asarray(Image.open(IMAGES / "isp.jpg").convert("RGB"))
    image = white()
    for place, left in ((0, 250), (121, 864)):
        image.paste(fill(page[150:380, left : left + 171], (119, HEIGHT)), (place, 0))
    return image


def chemistry() -> Image.Image:
    """Chlorophyll and leaf age, from the picture of the page."""
    page = np.asarray(Image.open(IMAGES / "chemistry.jpg").convert("RGB"))
    image = white()
    for place, (left, top) in ((0, (467, 38)), (121, (912, 388))):
        image.paste(fill(page[top : top + 276, left : left + 367], (119, HEIGHT)), (place, 0))
    return image


def tasks() -> Image.Image:
    """Measured and completed depth, from the picture of the page."""
    page = Image.open(IMAGES / "task_depth.jpg").convert("RGB")
    return fill(np.asarray(page))


def cluster() -> Image.Image:
    """A build, its scheduler and workers, and the folder that all of them share."""
    figure, axes = canvas()
    box(axes, (44, 24), (80, 30), "pepperscene\nbuild", "#f6ead2")
    box(axes, (150, 24), (72, 30), "scheduler", "#dfe9f5")
    arrow(axes, (84, 24), (114, 24))
    for x in (40, 120, 200):
        box(axes, (x, 82), (66, 26), f"worker {1 + (x - 40) // 80}")
        arrow(axes, (150, 39), (x, 68))
        arrow(axes, (x, 96), (120 + (x - 120) * 0.7, 124), GREY)
    box(axes, (120, 138), (190, 26), "shared folder: frames", "#eeeeee")
    return drawn(figure)


def read() -> Image.Image:
    """Images and masks, as tensors of a batch."""
    image = white()
    draw = ImageDraw.Draw(image)
    for column, index in enumerate((110, 2290, 4940)):
        for top, picture in ((14, photograph), (95, class_image)):
            image.paste(fill(picture(index), (78, 62)), (81 * column, top))
    draw.text((1, 0), "image  (3, 3, 600, 800)", fill=INK, font=font(10, mono=True))
    draw.text((1, 81), "mask  (3, 600, 800)", fill=INK, font=font(10, mono=True))
    return image


def learn() -> Image.Image:
    """A frame, and the classes that a network predicts which was trained on other frames."""
    images = ps.open_images(demo_set().folder)
    shown = images.names().index(f"{FRAME:06d}")
    others = images.take([position for position in range(len(images)) if position != shown])
    if not (CACHE / "model" / "model.safetensors").exists():
        ps.train([others], CACHE / "model", ps.TrainingOptions(steps=300, batch=4), resume=True)
    predicted = ps.predict_classes(ps.load_model(CACHE / "model"), images[shown].colour)
    image = white()
    for left, picture in ((0, photograph()), (121, ps.class_colour(predicted.astype(np.uint8)))):
        image.paste(fill(picture, (119, 160)), (left, 0))
    return image


def export() -> Image.Image:
    """A photograph with the boxes and masks of fruit out of its COCO export."""
    folder = CACHE / "coco"
    if not folder.exists():
        ps.export_dataset(demo_set().folder, "coco", folder)
    annotations = {}
    for path in sorted((folder / "annotations").glob("instances_*.json")):
        annotations |= {one["id"]: one for one in json.loads(path.read_text(encoding="utf-8"))["annotations"]}
    picture = photograph().astype(float)
    sheet_boxes = []
    for one in annotations.values():
        if one["image_id"] == FRAME and one["category_id"] == int(ps.OrganClass.PEPPER) and one["area"] > 500:
            mask = coco_mask.decode(one["segmentation"]).astype(bool)
            picture[mask] = 0.5 * picture[mask] + 0.5 * np.array([255, 120, 0])
            sheet_boxes.append(one["bbox"])
    image = Image.fromarray(picture.astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for x, y, width, height in sheet_boxes:
        draw.rectangle((x, y, x + width, y + height), outline="white", width=4)
    return fill(np.asarray(image))


def simulators() -> Image.Image:
    """A row, its fruit and their cut points."""
    recipe = ps.load_recipe("barth2018", {"row.plants_front": 2, "row.plants_back": 0})
    ps.export_scene(recipe, CACHE / "scene" / "row.glb", 0)
    content = json.loads((CACHE / "scene" / "row.json").read_text(encoding="utf-8"))
    scene = ps.FrameRenderer(recipe, culled=False).scene(recipe.plan.frame(0), traced=False)
    figure, _ = canvas()
    row_axes = figure.add_axes((0, 0, 1, 1))
    draw_mesh(row_axes, scene.mesh, 0.0, {"lamina": "#cfdcc9", "shoot_lamina": "#cfdcc9"})
    for organ in content["organs"]:
        if organ.get("cut_point_m"):
            x, _, z = organ["cut_point_m"]
            dx, _, dz = (0.06 * value for value in organ["approach"])
            row_axes.plot(x, z, "o", color=RED, ms=3)
            arrow(row_axes, (x - dx, z - dz), (x, z), BLUE)
    row_axes.set(xlim=(-0.5, 0.3), ylim=(0.75, 1.283))
    return drawn(figure)


def learning() -> Image.Image:
    """IoU on photographs of the experiments B, C and E with intervals: out/experiments/experiments.json."""
    content = json.loads((ROOT / "out" / "experiments" / "experiments.json").read_bytes())
    results = {item["key"]: item["measures"] for item in content["experiments"] if item["ran"]}
    figure, axes = chart(left=0.12, bottom=0.13, right=0.98, top=0.86)
    names = ("fruit", "peduncle", "mean")
    series = {"B": ("rendered images", GREEN), "C": ("photographs", GREY), "E": ("both", ORANGE)}
    for number, (key, (label, colour)) in enumerate(series.items()):
        measures = {measure["name"]: measure for measure in results[key]}
        places = np.arange(len(names)) + 0.27 * (number - 1)
        values, low, high = (
            np.array([100 * measures[name][part] for name in names]) for part in ("value", "low", "high")
        )
        axes.bar(places, values, 0.25, color=colour, label=label)
        axes.errorbar(places, values, [values - low, high - values], fmt="none", ecolor=INK, elinewidth=0.8)
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", length=0)
    axes.set_ylim(0, 85)
    axes.legend(fontsize=FONT_PT - 0.5, frameon=False, loc="upper left", handlelength=0.8, borderpad=0)
    axes.set_title("IoU on photographs, %", fontsize=FONT_PT + 0.5, pad=3)
    return drawn(figure)


def report() -> Image.Image:
    """The fraction of each class in the pixels of the demo set."""
    manifest = demo_set().manifest()
    names = [one.name.lower() for one in ps.OrganClass]
    pixels = np.array([sum(manifest[f"pixels_{name}"].to_pylist()) for name in names], float)
    percent = 100 * pixels / pixels.sum()
    figure, axes = chart(left=0.29, bottom=0.04, right=0.87, top=0.88)
    colours = [hex_colour(np.array(colour) / 255) for colour in ps.CLASS_COLOURS]
    axes.barh(range(len(names)), percent, color=colours, ec=GREY, lw=0.5, height=0.75)
    for row, value in enumerate(percent):
        axes.text(
            value + 1.5,
            row,
            f"{value:.1f}" if value > 0.1 else f"{value:.2f}",
            va="center",
            fontsize=FONT_PT,
            color=INK,
        )
    axes.set_yticks(range(len(names)), names)
    axes.set_xticks([])
    axes.spines["bottom"].set_visible(False)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_title("% of the pixels", fontsize=FONT_PT + 0.5, pad=3)
    return drawn(figure)


def compare() -> Image.Image:
    """Hue spectra of the fruit of two sets."""
    comparison = ps.compare(demo_set().folder, red_set())
    figure, axes = chart(left=0.06, bottom=0.22)
    hues = (bin_angles(180) + 60) % 360 - 60
    order = np.argsort(hues)
    sides = (
        (comparison.first, "yellow\ncultivar", "#c9a20a", "-", (66, 20)),
        (comparison.second, "red\ncultivar", RED, "--", (-14, 11)),
    )
    for side, name, colour, dashes, place in sides:
        sums = side.totals("pepper")
        assert sums is not None
        spectrum = similarity.hue_spectra(sums[:1])[0]
        axes.plot(hues[order], spectrum[order], dashes, color=colour, lw=1.3)
        axes.text(*place, name, color=colour, fontsize=FONT_PT + 0.5, va="top", linespacing=1.0)
    axes.set(xlim=(-40, 130), yticks=[], xticks=[0, 60, 120], ylim=(0, None))
    axes.tick_params(axis="x", pad=7, length=0)
    axes.set_xlabel("hue, degrees", fontsize=FONT_PT, labelpad=1)
    strip = axes.inset_axes((0, -0.07, 1, 0.06))
    strip.imshow((np.linspace(-40, 130, 200) % 360)[None] / 360, cmap="hsv", vmin=0, vmax=1, aspect="auto")
    strip.axis("off")
    return drawn(figure)


def benchmark() -> Image.Image:
    """Error against time, out of the tables of `benchmarks/README.md`."""
    text = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    text = text.split("## Rendering time against error")[1].split("### First frames")[0]
    number = r"([\d.]+)"
    own = re.findall(rf"^\| (draft|standard|target)[^|]*\| {number} \| {number} s", text, re.MULTILINE)
    path = re.findall(rf"^\| (path|the same),[^|]*spp \| {number} \| {number} s", text, re.MULTILINE)
    cycles = re.findall(rf"^\| (raw|denoised) \d+ \| {number} \| {number} s", text, re.MULTILINE)
    assert own
    assert path
    assert cycles
    figure, axes = chart(left=0.17, bottom=0.22)
    groups = {
        "pepperscene": (own, GREEN, "o-", (0.8, 0.6)),
        "path tracer": (path, GREY, "s-", (6.0, 19.0)),
        "Cycles": ([row for row in cycles if row[0] == "raw"], BLUE, "^-", (22.0, 4.4)),
        "Cycles, denoised": ([row for row in cycles if row[0] == "denoised"], ORANGE, "v-", (9.0, 0.6)),
    }
    for name, (rows, colour, style, place) in groups.items():
        points = np.array([[float(seconds), float(codes)] for _, codes, seconds in rows])
        axes.loglog(*points.T, style, color=colour, ms=2.6, lw=1)
        axes.text(*place, name, color=colour, fontsize=FONT_PT, linespacing=0.95)
    axes.set(xlim=(0.7, 130), ylim=(0.5, 45))
    axes.set_xticks([1, 10, 100], ["1 s", "10 s", "100 s"])
    axes.set_yticks([1, 10], ["1", "10"])
    axes.minorticks_off()
    axes.set_xlabel("time", fontsize=FONT_PT, labelpad=0)
    axes.set_ylabel("error, 8-bit codes", fontsize=FONT_PT, labelpad=0)
    return drawn(figure)


# --- reference -------------------------------------------------------------------------------------------


def command_line() -> Image.Image:
    """The commands out of `pepperscene --help`."""
    command = [sys.executable, "-P", "-m", "pepperscene", "--help"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "80"}
    )
    commands = done.stdout.split("Commands:\n")[1].rstrip().splitlines()
    lines = [("$ pepperscene --help", "#7fd07f"), ("Commands:", "#dddddd")]
    for line in commands:
        text = re.sub(r"^ +(\S+) +", r" \1 ", line).ljust(12)
        name, _, description = text.strip().partition(" ")
        text = f" {name:<10}{description.strip()}"
        lines.append((text if len(text) <= 37 else f"{text[:36].rstrip()}…", "#dddddd"))
    return terminal(lines[:14])


def own_crop() -> Image.Image:
    """A row of cucumbers, out of the picture of its page."""
    return fill(np.asarray(Image.open(IMAGES / "own_crop_row.jpg").convert("RGB")))


def troubleshooting() -> Image.Image:
    """What `pepperscene doctor` finds."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pepperscene", "doctor"], capture_output=True, text=True, check=True
    )
    lines = [("$ pepperscene doctor", "#7fd07f")]
    for line in done.stdout.rstrip().splitlines():
        # Without paths, which are those of one machine.
        text = re.sub(r"  +", "  ", re.sub(r" \(?/\S*", "", line))
        lines.append((text if len(text) <= 37 else f"{text[:36].rstrip()}…", "#dddddd"))
    return terminal(lines[:14])


def recipe() -> Image.Image:
    """The rows of plants and the path of the camera from above, from the values of `barth2018`."""
    table = ps.load_recipe("barth2018")
    figure, axes = canvas()
    axes.set(xlim=(-0.78, 0.78), ylim=(-0.62, 0.42))
    axes.set_aspect("equal")
    row, views = table.row, table.views
    spacing = row.spacing_m
    front = (np.arange(row.plants_front) - (row.plants_front - 1) / 2) * spacing
    back = (np.arange(row.plants_back) - (row.plants_back - 1) / 2) * spacing
    for places, depth in ((front, 0.0), (back, row.gap_m)):
        axes.scatter(places, np.full(len(places), depth), s=95, c="#8fc07c", ec=GREEN, lw=0.8, zorder=3)
    poses = ps.arc_path(60, views.distance_m, views.azimuth_rad, (1.0, 1.0), 0.0)
    axes.plot(*poses[:, :2, 3].T, color=ORANGE, lw=1.6)
    for pose in (poses[0], poses[30], poses[-1]):
        start, forward = pose[:2, 3], pose[:2, 2]
        arrow(axes, start, start + 0.16 * forward, ORANGE, 1.3)
        axes.plot(*start, "s", color=ORANGE, ms=5, zorder=4)
    axes.text(0, 0.33, "double row of plants", ha="center", fontsize=FONT_PT, color=GREEN)
    axes.text(
        0, -0.53, f"camera path, {table.plan.frames} frames", ha="center", fontsize=FONT_PT, color=ORANGE
    )
    axes.annotate("", (spacing, 0.09), (0, 0.09), arrowprops={"arrowstyle": "<->", "lw": 0.7, "color": INK})
    label = f"{1e3 * row.spacing_m:g} mm"
    axes.text(spacing + 0.02, 0.09, label, ha="left", va="center", fontsize=FONT_PT - 0.5, color=INK)
    axes.text(-0.04, -0.14, f"{1e3 * views.distance_m:g} mm", ha="left", fontsize=FONT_PT - 0.5, color=INK)
    axes.plot([0, poses[10, 0, 3]], [0, poses[10, 1, 3]], ":", color=INK, lw=0.8)
    return drawn(figure)


def cultivar() -> Image.Image:
    """A plant as `pepperscene plant` shows it: whole, and from 50 cm."""
    table = ps.load_cultivar("red_blocky")
    sheet = cached("plant", lambda: portrait(ps.grow_plant("red_blocky", seed=5).mesh, table, "draft"))
    whole, close = sheet[:, : sheet.shape[1] - 608], sheet[:450, -600:]
    image = white()
    width = round(HEIGHT * whole.shape[1] / whole.shape[0])
    image.paste(fill(whole, (width, HEIGHT)), (0, 0))
    image.paste(fill(close, (WIDTH - width - 3, HEIGHT)), (width + 3, 0))
    return image


def devices() -> Image.Image:
    """Quantum efficiencies of two sensors, and the spectrum of the flash."""
    figure, axes = chart(left=0.17, bottom=0.22)
    nm = np.arange(380.0, 721.0, 2.0)
    led = ps.load_flash("led_matrix_200klx").spectrum.at(nm)
    axes.fill_between(nm, 0.62 * led / led.max(), color="#e3e3e3", lw=0)
    axes.text(447, 0.64, "LED", fontsize=FONT_PT, color="#777777", ha="right")
    for name, style in (("ueye_ui5250re", "-"), ("nikon_d5100", "--")):
        efficiency = ps.load_sensor(name).quantum_efficiency.at(nm)
        for curve, colour in zip(efficiency, (RED, GREEN, BLUE), strict=True):
            axes.plot(nm, curve, style, color=colour, lw=1.1)
    axes.plot([], [], "-", color=INK, lw=1.1, label="IDS uEye")
    axes.plot([], [], "--", color=INK, lw=1.1, label="Nikon D5100")
    axes.legend(fontsize=FONT_PT - 0.5, frameon=False, loc="upper right", handlelength=1.6, borderpad=0)
    axes.set(xlim=(380, 720), ylim=(0, 0.85), xticks=[400, 500, 600, 700], yticks=[0, 0.5])
    axes.set_xlabel("wavelength, nm", fontsize=FONT_PT, labelpad=0)
    axes.set_ylabel("quantum efficiency", fontsize=FONT_PT, labelpad=1)
    return drawn(figure)


def outputs() -> Image.Image:
    """One frame in four strips: colour, class, instance and distance."""
    instance = instance_colours(demo_set().image(FRAME, "instance"))
    strips = {
        "colour": photograph(),
        "class": class_image(),
        "instance": instance,
        "distance": distance_image(),
    }
    image = white()
    for i, (name, picture) in enumerate(strips.items()):
        image.paste(crop(picture, 200, 120, 440).crop((60 * i, 0, 60 * i + 59, HEIGHT)), (60 * i, 0))
        caption(image, (60 * i + 4, 146), name, 9)
    return image


def harvest() -> Image.Image:
    """Two fruits with outline, box, cut point and approach: a part of the picture of the harvest page."""
    return crop(np.asarray(Image.open(IMAGES / "harvest.jpg").convert("RGB")), 340, 2, 232)


def tables() -> Image.Image:
    """Leaf area above the floor of the plants of a row, from the table of leaves."""
    traits = ps.plant_traits("barth2018", 125)
    height, area = (np.array(traits.leaves[name].to_pylist()) for name in ("z_m", "area_m2"))
    index = traits.plants["leaf_area_index"].to_pylist()
    figure, axes = chart(left=0.17)
    for plant in range(len(index)):
        own = np.array(traits.leaves["plant"].to_pylist()) == plant
        order = np.argsort(height[own])
        axes.plot(np.cumsum(area[own][order]), height[own][order], color=GREEN, lw=0.8, alpha=0.6)
    axes.set_xlabel("leaf area below, m²", fontsize=FONT_PT, labelpad=1)
    axes.set_ylabel("height, m", fontsize=FONT_PT, labelpad=1)
    axes.text(0.05, 0.9, f"LAI {np.mean(index):.1f}", transform=axes.transAxes, fontsize=FONT_PT, color=INK)
    return drawn(figure)


def check() -> Image.Image:
    """Borders of instances over the photograph: correct, and shifted as in a faulty data set."""
    left, top, width, height, shift = 160, 300, 160, 213, 9
    instance = demo_set().image(FRAME, "instance")
    edge = np.zeros(instance.shape, bool)
    edge[:, 1:] |= instance[:, 1:] != instance[:, :-1]
    edge[1:] |= instance[1:] != instance[:-1]
    image = white()
    for place, offset, colour, text in (
        (0, 0, (80, 255, 80), "correct"),
        (121, shift, (255, 60, 60), "shifted"),
    ):
        picture = photograph()[top : top + height, left : left + width].copy()
        picture[edge[top : top + height, left - offset : left - offset + width]] = colour
        image.paste(fill(picture, (119, HEIGHT)), (place, 0))
        caption(image, (place + 5, 145), text)
    return image


def patches() -> Image.Image:
    """The colours of pixels of a set's kinds of organs, from dark to bright."""
    patch_set = ps.open_patches(red_set())
    names = [
        name for name in ("leaf", "pepper", "peduncle", "stem", "shoot", "wire") if name in patch_set.kinds
    ]
    image = white()
    draw = ImageDraw.Draw(image)
    for i, name in enumerate(names):
        codes = np.concatenate([patch.codes for patch in patch_set.of_kind(name)]).astype(float) * 1.2
        codes = codes[np.argsort(codes.sum(axis=1))][np.linspace(0, len(codes) - 1, 12 * 8).astype(int)]
        swatch = np.clip(codes, 0, 255).astype(np.uint8).reshape(12, 8, 3).transpose(1, 0, 2)
        place = (81 * (i % 3), 81 * (i // 3))
        image.paste(Image.fromarray(swatch).resize((78, 62), Image.Resampling.NEAREST), place)
        draw.rectangle((*place, place[0] + 77, place[1] + 61), outline=GREY)
        draw.text((place[0] + 1, place[1] + 64), name, fill=INK, font=font(10))
    return image


def tuning_parameters() -> Image.Image:
    """Bounds and prior distributions of some parameters, relative to the recipe's values."""
    target = TuningTarget(
        ps.load_recipe("barth2018"),
        ps.simulate_patches(ps.load_recipe("barth2018"), {}, ["leaf"], organs=1, pixels=8),
    )
    names = [
        "leaf.chlorophyll",
        "leaf.carotenoid",
        "fruit.chlorophyll",
        "stem.chlorophyll",
        "flash.power",
        "exposure",
    ]
    figure, axes = chart(left=0.42, bottom=0.22, right=0.96)
    for row, one in enumerate(target.parameters(names)):
        prior, default = one.prior[0], one.default[0]
        axes.plot([prior.low / default, prior.high / default], [row, row], color="#cccccc", lw=1.5)
        ends = np.array([prior.mean - prior.sd, prior.mean + prior.sd]) / default
        axes.plot(ends, [row, row], color="#8fc07c", lw=6, solid_capstyle="butt")
        axes.plot(prior.mean / default, row, "|", color=INK, ms=7)
    axes.axvline(1, color=GREY, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xticks([0.3, 1, 3], ["× 0.3", "1", "× 3"])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("relative to the recipe", fontsize=FONT_PT, labelpad=1)
    return drawn(figure)


def tuning_files() -> Image.Image:
    """The files of a tuned recipe, and values before and after."""
    image = white()
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, WIDTH, 79), fill="#f2f2f2")
    text, small = font(10, mono=True), font(10)
    draw.text((6, 3), "tuned/", fill=INK, font=font(10, mono=True, bold=True))
    names = sorted(path.name for path in tuning_folder().iterdir())
    for row, name in enumerate(names):
        draw.text((18, 17 + 14 * row), name, fill=INK, font=text)
    draw.text((134, 84), "before", fill=GREY, font=small)
    draw.text((194, 84), "after", fill=GREY, font=small)
    for row, one in enumerate(tuning_record()["parameters"]):
        top = 101 + 19 * row
        draw.text((6, top), one["name"], fill=INK, font=small)
        draw.text((134, top), f"{one['before'][0]:.1f}", fill=INK, font=small)
        draw.text((172, top), "→", fill=GREEN, font=small)
        draw.text((194, top), f"{one['value'][0]:.1f}", fill=GREEN, font=font(10, bold=True))
    return image


def pose_files() -> Image.Image:
    """A camera path through points around a plant, from above, with the fields of view of some poses."""
    figure, axes = canvas()
    points = np.array(
        [[-0.75, -0.3, 1], [-0.45, -0.62, 1], [0.0, -0.5, 1], [0.45, -0.62, 1], [0.75, -0.3, 1]]
    )
    path = spline_trajectory(points, 0.2, count=90, look_at_m=(0.0, 0.15, 1.0))
    places = np.array([120.0, 42.0]) + path.poses[:, :2, 3] * [140.0, -160.0]
    axes.add_patch(Circle((120, 42 - 0.15 * 160), 15, fc="#8fc07c", ec=GREEN, lw=0.8))
    for pose, place in list(zip(path.poses, places, strict=True))[4::16]:
        forward, right = pose[:2, 2] * [1, -1], pose[:2, 0] * [1, -1]
        sides = [place + 30 * forward + side * 13 * right for side in (-1, 1)]
        axes.fill(*np.transpose([place, *sides]), color=ORANGE, alpha=0.25, lw=0)
        axes.plot(*np.transpose([sides[0], place, sides[1]]), color=ORANGE, lw=0.7)
    axes.plot(*places.T, color=BLUE, lw=1.4)
    arrow(axes, places[-3], places[-1], BLUE, 1.4)
    axes.plot(*(np.array([120.0, 42.0]) + points[:, :2] * [140.0, -160.0]).T, "o", color=INK, ms=3.5)
    axes.text(
        120, 153, "x_m, y_m, z_m, qx, qy, qz, qw", fontsize=FONT_PT, color=INK, ha="center", va="center"
    )
    return drawn(figure)


def conventions() -> Image.Image:
    """The axes of the world at the foot of a plant, and the axes of a camera in front of it."""
    figure, axes = canvas()
    oblique = np.array([[1.0, 0.0], [0.52, -0.36], [0.0, -1.0]])

    def at(origin: ArrayLike, offset: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        point: NDArray[np.float64] = np.asarray(origin, float) + np.asarray(offset, float) @ oblique
        return point

    def axis(
        origin: ArrayLike, direction: ArrayLike, name: str, colour: str, shift: tuple[float, float]
    ) -> None:
        end = at(origin, direction)
        arrow(axes, at(origin), end, colour, 1.4)
        axes.text(
            end[0] + shift[0],
            end[1] + shift[1],
            name,
            color=colour,
            fontsize=FONT_PT + 1,
            ha="center",
            va="center",
        )

    foot, camera = np.array([158.0, 124.0]), np.array([62.0, 86.0])
    axes.plot([foot[0], foot[0]], [foot[1], 12], color=GREEN, lw=2.2)
    for height, side in ((30, 1), (52, -1), (74, 1), (96, -1)):
        tip = (foot[0] + 30 * side, foot[1] - height - 20)
        arc = {"arrowstyle": "-", "connectionstyle": f"arc3,rad={0.25 * side}", "color": "#6aa84f", "lw": 4}
        axes.annotate("", tip, (foot[0], foot[1] - height), arrowprops={**arc, "shrinkA": 0, "shrinkB": 0})
    axis(foot, (58, 0, 0), "x", RED, (7, 0))
    axis(foot, (0, 50, 0), "y", GREEN, (8, -4))
    axis(foot, (0, 0, 46), "z", BLUE, (-8, 0))
    axes.text(
        foot[0],
        foot[1] + 14,
        "world: z up, y into the crop",
        fontsize=FONT_PT,
        color=INK,
        ha="center",
        va="center",
    )
    axes.add_patch(
        FancyBboxPatch(
            camera - (18, 12), 36, 24, boxstyle="round,pad=0,rounding_size=3", fc="#dddddd", ec=INK, lw=0.8
        )
    )
    axis(camera, (40, 0, 0), "x", RED, (6, 0))
    axis(camera, (0, 0, -36), "y", GREEN, (0, 7))
    axis(camera, (0, 62, 0), "z", BLUE, (5, -6))
    axes.text(56, 28, "camera: z forward", fontsize=FONT_PT, color=INK, ha="center", va="center")
    return drawn(figure)


def api() -> Image.Image:
    """The five steps of the program, each as a small picture."""
    figure, axes = canvas()
    places = {
        "Cultivar": (3, 16),
        "Plant": (86, 16),
        "Mesh": (169, 16),
        "Scene": (44, 98),
        "Frame": (127, 98),
    }
    size = (68, 60)
    for name, (x, y) in places.items():
        axes.add_patch(FancyBboxPatch((x, y), *size, boxstyle="square,pad=0", fc="white", ec=GREY, lw=0.7))
        axes.text(x + size[0] / 2, y - 2, name, ha="center", va="bottom", fontsize=FONT_PT + 0.5, color=INK)
    diameter = ps.load_cultivar("kaite").organs["fruit"].diameter
    mean, sd = 1000 * diameter.mean, 1000 * diameter.sd
    text = f"[organs.fruit]\ndiameter = {{\n mean_mm = {mean:g},\n sd_mm = {sd:g}, …"
    axes.text(6, 22, text, fontsize=4.9, family="monospace", va="top", color=INK, linespacing=1.5)

    def inset(name: str) -> Axes:
        x, y = places[name]
        return figure.add_axes((x / WIDTH, 1 - (y + size[1]) / HEIGHT, size[0] / WIDTH, size[1] / HEIGHT))

    organs = inset("Plant")
    for organ in plant().organs:
        colour = "#d9a400" if organ.kind == "fruit" else GREEN
        organs.plot(
            organ.curve[:, 0], organ.curve[:, 2], color=colour, lw=2.4 if organ.kind == "fruit" else 0.8
        )
    organs.axis("off")
    organs.set_aspect("equal")
    mesh = ps.mesh_plant(plant(), detail=0.5)
    triangles = inset("Mesh")
    draw_mesh(triangles, mesh, 0.0)
    for part in (organs, triangles):
        part.set(xlim=(-0.32, 0.32), ylim=(1.5, 1.5 + 0.64 * size[1] / size[0]))
    scene = inset("Scene")
    scene.axis("off")
    for places_x, y in ((np.arange(-2, 3), 0.0), (np.arange(-1.5, 2), 1.0)):
        scene.scatter(places_x, np.full(len(places_x), y), s=34, c="#8fc07c", ec=GREEN, lw=0.6)
    scene.plot(0, -1.9, "s", color=ORANGE, ms=5)
    scene.plot([0, -1.3, 1.3, 0], [-1.9, 0.4, 0.4, -1.9], color=ORANGE, lw=0.7)
    scene.set(xlim=(-2.6, 2.6), ylim=(-2.5, 1.9))
    for start, end in (((72, 46), (85, 46)), ((155, 46), (168, 46)), ((113, 128), (126, 128))):
        arrow(axes, start, end)
    axes.plot([203, 203, 24, 24], [77, 83, 83, 128], color=INK, lw=1)
    arrow(axes, (24, 128), (43, 128))
    image = drawn(figure)
    image.paste(fill(photograph(), size, (0.2, 0.5)), places["Frame"])
    return image


def glossary() -> Image.Image:
    """A phytomer of a plant, and the stem above it, with the names of the organs."""
    number, azimuth = 9, np.pi / 4
    across = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    mesh = ps.mesh_plant(plant(), detail=2.0)
    stem, others = ("internode", "node"), ("petiole", "lamina", "peduncle", "calyx", "fruit")

    def shown(organ: ps.Instance | ps.Organ) -> bool:
        kinds = {number: (*stem, *others), number + 1: stem}
        return organ.kind in kinds.get(organ.phytomer, ())

    figure, axes = canvas()
    draw_mesh(axes, mesh.select_instances([i for i, one in enumerate(mesh.instances) if shown(one)]), azimuth)
    axes.set(xlim=(-0.235, 0.225), ylim=(0.845, 0.845 + 0.46 * HEIGHT / WIDTH))
    labels = {
        ("internode", number + 1): (0.06, 1.075),
        ("petiole", number): (-0.12, 1.085),
        ("lamina", number): (-0.205, 0.9),
        ("node", number): (-0.07, 0.95),
        ("peduncle", number): (0.075, 1.03),
        ("calyx", number): (0.125, 0.985),
        ("fruit", number): (0.135, 0.87),
    }
    names = {"lamina": "blade"}
    for organ in plant().organs:
        if (place := labels.get((organ.kind, organ.phytomer))) is None or not shown(organ):
            continue
        middle_row = len(organ.curve) // 2
        point = organ.curve[middle_row] if middle_row > 1 else organ.curve.mean(axis=0)
        target = (float(point @ across), float(point[2]))
        style = {"arrowstyle": "-", "color": INK, "lw": 0.6, "shrinkA": 1, "shrinkB": 0}
        text = names.get(organ.kind, organ.kind)
        middle = {"ha": "center", "va": "center", "fontsize": FONT_PT + 0.5, "color": INK}
        axes.annotate(text, target, place, arrowprops=style, **middle)
    # The bracket around all organs of one phytomer.
    axes.plot([0.182, 0.19, 0.19, 0.182], [0.855, 0.855, 1.04, 1.04], color=GREY, lw=0.8)
    axes.text(
        0.2, 0.945, "phytomer", rotation=270, color=GREY, fontsize=FONT_PT + 0.5, ha="center", va="center"
    )
    return drawn(figure)


# --- explanation -----------------------------------------------------------------------------------------


def architecture() -> Image.Image:
    """The layers of packages, out of `pyproject.toml`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = next(one["layers"] for one in contracts if one["type"] == "layers")
    figure, axes = canvas()
    height = (HEIGHT - 4) / len(layers)
    for row, layer in enumerate(layers):
        packages = layer.split(" | ")
        width = 200 / len(packages)
        for column, name in enumerate(packages):
            centre = (5 + width * (column + 0.5), 2 + height * (row + 0.5))
            colour = "#f6ead2" if name == "render" else PALE
            box(axes, centre, (width - 3, height - 2), name, colour)
    arrow(axes, (222, 12), (222, 148), GREY, 1.2)
    axes.text(231, 80, "imports", rotation=270, ha="center", va="center", fontsize=FONT_PT, color=GREY)
    return drawn(figure)


def reliability() -> Image.Image:
    """The steps by which a frame becomes complete."""
    figure, axes = canvas()
    steps = (
        "write images under\ntemporary names",
        "flush, then rename",
        "JSON with checksums:\nframe is complete",
    )
    for row, (text, fill_colour) in enumerate(zip(steps, ("#f6ead2", "#dfe9f5", "#e2f0dd"), strict=True)):
        y = 30 + 48 * row
        box(axes, (92, y), (124, 32), text, fill_colour)
        if row:
            arrow(axes, (92, y - 32), (92, y - 16))
    box(axes, (204, 54), (62, 52), "kill,\nfull disk,\npower cut", "#f5dede")
    arrow(axes, (173, 48), (154, 36), GREY)
    arrow(axes, (173, 60), (154, 72), GREY)
    return drawn(figure)


def plants() -> Image.Image:
    """Four cultivars from 50 cm, out of the picture of the page on plants."""
    sheet = np.asarray(Image.open(IMAGES / "plant_cultivars.png").convert("RGB"))
    image = white()
    corners = ((104, 0), (516, 0), (104, 462), (601, 462))
    for i, (left, top) in enumerate(corners):
        part = sheet[top : top + 224, left : left + 300]
        image.paste(fill(part, (119, 79)), (121 * (i % 2), 81 * (i // 2)))
    return image


def realism() -> Image.Image:
    """A photograph and a frame, out of a picture of the page on realism."""
    sheet = Image.open(IMAGES / "realism_greenhouse.jpg").convert("RGB")
    image, half = white(), sheet.height // 2
    for i, top in enumerate((0, sheet.height - half + 3)):
        part = np.asarray(sheet.crop((0, top + 20, sheet.width // 3 - 8, top + half - 8)))
        image.paste(fill(part, (119, 160)), (121 * i, 0))
    return image


def optics() -> Image.Image:
    """Reflectance and transmittance of a leaf."""
    nm = np.arange(400.0, 901.0, 2.0)
    leaf = ps.organ_surfaces(ps.load_cultivar("kaite"), nm)["leaf"]
    middle = len(leaf.reflectance) // 2
    reflectance, transmittance = leaf.reflectance[middle, 0], leaf.transmittance[middle]
    figure, axes = chart(left=0.12, bottom=0.22, right=0.96)
    axes.fill_between(nm, 0, reflectance, color="#8fc07c", lw=0)
    axes.fill_between(nm, reflectance, 1 - transmittance, color="#4a4a4a", lw=0)
    axes.fill_between(nm, 1 - transmittance, 1, color="#cfe3a8", lw=0)
    axes.text(560, 0.5, "absorbed", color="white", fontsize=FONT_PT + 0.5, ha="center", va="center")
    axes.text(810, 0.25, "reflected", color=INK, fontsize=FONT_PT + 0.5, ha="center", va="center")
    axes.text(810, 0.75, "transmitted", color=INK, fontsize=FONT_PT + 0.5, ha="center", va="center")
    axes.set(xlim=(400, 900), ylim=(0, 1), xticks=[400, 500, 600, 700, 800], yticks=[0, 0.5, 1])
    axes.set_xlabel("wavelength, nm", fontsize=FONT_PT, labelpad=0)
    return drawn(figure)


def rendering() -> Image.Image:
    """A part of a frame by a path tracer with four samples per pixel, and at standard quality."""
    table = ps.load_recipe("demo")
    renderer, spec = ps.FrameRenderer(table), table.plan.frame(FRAME)
    noisy = Quality(samples=4, soft=4, most=4, bounces=2, target=None, denoise=False, integrator="path")

    def frame(quality: str | Quality) -> Callable[[], Picture]:
        return lambda: renderer.render(spec, ["colour"], quality)["colour"]

    image = white()
    for place, name, quality in ((0, "path", noisy), (121, "standard", "standard")):
        codes = cached(name, frame(quality))[300:434, 200:300].astype(float)
        picture = np.clip(codes * BRIGHTER, 0, 255).astype(np.uint8)
        image.paste(fill(picture, (119, HEIGHT)), (place, 0))
    caption(image, (5, 145), "4 paths per pixel", 9)
    caption(image, (126, 145), "standard", 9)
    return image


def colour() -> Image.Image:
    """Mean colours that were measured, and those of the model before and after a fit."""
    image = white()
    draw = ImageDraw.Draw(image)
    columns = {"measured": "target", "before": "before", "after": "after"}
    for column, title in enumerate(columns):
        draw.text((40 + 68 * column, 1), title, fill=INK, font=font(10))
    for row, kind in enumerate(KINDS):
        colours = tuning_record()["kinds"][kind]
        draw.text((1, 24 + 48 * row), kind.replace(".", "\n"), fill=INK, font=font(9), spacing=1)
        for column, key in enumerate(columns.values()):
            rgb = lab2rgb(np.array(colours[key]["mean_lab"])[None, None])[0, 0]
            left, top = 40 + 68 * column, 16 + 48 * row
            draw.rectangle((left, top, left + 62, top + 44), fill=hex_colour(rgb))
    return image


PHOTOGRAPHS: Final = (
    quickstart, robot_data_set, gallery, fruit_segmenter, first_frame, dataset, bands_notebook, build, camera,
    visibility, live, tasks, vary, motion, depth, bands, own_spectrum, stand, isp, chemistry, read, learn,
    export, own_crop, cultivar, outputs, harvest, check, plants, rendering, realism,
)  # fmt: skip
"""Pictures that are smaller as JPEG files."""
DRAWINGS: Final = (
    tables, colour_tuning, views, cluster, report, compare, benchmark, troubleshooting, command_line, recipe,
    devices, patches, tuning_parameters, tuning_files, pose_files, conventions, api, glossary,
    architecture, reliability, optics, colour, learning, simulators,
)  # fmt: skip
FIGURES: Final[dict[str, Callable[[], Image.Image]]] = {
    one.__name__: one for one in (*PHOTOGRAPHS, *DRAWINGS)
}


def main(names: list[str]) -> None:
    """Write the pictures of these names, by default all."""
    folder = IMAGES / "index"
    folder.mkdir(exist_ok=True)
    for name in names or FIGURES:
        image = FIGURES[name]()
        if FIGURES[name] in PHOTOGRAPHS:
            image.save(folder / f"{name}.jpg", quality=85, optimize=True)
        else:
            image.quantize(128, dither=Image.Dither.NONE).save(folder / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
