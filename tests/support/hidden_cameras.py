"""Cameras with known image signal processing, written with NumPy and SciPy only, and charts that they see.

The sensor's noise and mosaic are the program's; everything from linear camera_rgb to codes is made here.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from pepperscene.camera import Camera, camera_rgb, load_lens, load_sensor
from pepperscene.camera.image.colorimetry import (
    NM,
    colour_checker_reflectances,
    colour_correction,
    d65_spectrum,
)
from pepperscene.camera.sensor.developing_steps import Developing
from pepperscene.spectra import read_spectra

FRAME = 24  # index of the black frame of the chart, of the black field's reflectance
GREY = 25  # index of what surrounds the chart
CORNERS = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])


def srgb(linear):
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    )


@dataclass(frozen=True)
class HiddenCamera:
    """A camera whose processing a calibration has to find.

    `contrast` is the strength of an S-curve in codes; `lift` a grey added to black; `noise_blur` a Gaussian
    by which noise (and detail) is smoothed before the tone curve; `vignetting` the loss at the corners.
    """

    sensor: str = "generic_rgb"
    gain: float = 2.0
    white: float = 0.75  # fraction of full scale that a perfect diffuser gives, after white balance
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    contrast: float = 0.0
    gamma: float = 1.0
    lift: float = 0.0
    vignetting: float = 0.0
    lens_blur: float = 0.6  # sigma in pixels
    noise_blur: float = 0.0
    chroma_blur: float = 0.0
    sharpening: float = 0.0
    radius: float = 1.0
    quality: int | None = None

    def tone(self, linear):
        """Codes in 0 to 1 of linear values."""
        u = srgb(np.clip(linear, 0.0, 1.0)) ** self.gamma
        curve = u + self.contrast * (u - u**2) * (2 * u - 1) * 2
        return self.lift + (1.0 - self.lift) * curve

    @property
    def matrix(self):
        """`(3, 3)` from camera_rgb balanced by the sensor's own gains to linear values, exposure left out."""
        luma = np.array([0.2126, 0.7152, 0.0722])
        saturate = self.saturation * np.eye(3) + (1.0 - self.saturation) * luma
        return (
            saturate
            @ colour_correction(load_sensor(self.sensor), d65_spectrum()).matrix
            @ np.diag(self.balance)
        )

    def linear(self, reflectance):
        """`(m, 3)` linear values of reflectances `(m, 801)` under daylight in the middle of the picture."""
        return self.white * balanced(self.sensor, reflectance) @ self.matrix.T

    def codes(self, reflectance):
        """`(m, 3)` codes in 0 to 1 of reflectances `(m, 801)`, without noise."""
        return self.tone(self.linear(reflectance))

    def photograph(self, rgb, seed=0):
        """`(h, w, 3)` uint8 picture of balanced camera_rgb `(h, w, 3)`; without a seed, without noise."""
        rgb = rgb * self.white
        height, width = rgb.shape[:2]
        y, x = np.mgrid[:height, :width]
        radius = np.hypot(x + 0.5 - width / 2, y + 0.5 - height / 2) / np.hypot(width / 2, height / 2)
        rgb = rgb * (1.0 - self.vignetting * radius**2)[..., None]
        rgb = gaussian_filter(rgb, (self.lens_blur, self.lens_blur, 0))
        sensor = replace(load_sensor(self.sensor), columns=width, rows=height, gain=self.gain)
        gains = colour_correction(sensor, d65_spectrum()).gains
        camera = Camera(
            load_lens("lensagon_cmfa0420nd"),
            sensor,
            flash=None,
            developing=Developing(white_balance="daylight"),
        )
        electrons = rgb / gains * sensor.full_well_e / self.gain
        rng = None if seed is None else np.random.default_rng(seed)
        noisy = camera_rgb(electrons, camera, rng).astype(float)
        if self.noise_blur:
            noisy = gaussian_filter(noisy, (self.noise_blur, self.noise_blur, 0))
        linear = (
            np.minimum(noisy * gains * self.balance, 1.0)
            @ (self.matrix @ np.diag(1 / np.array(self.balance))).T
        )
        codes = self.tone(linear)
        if self.chroma_blur:
            luma = codes @ [0.299, 0.587, 0.114]
            smooth = gaussian_filter(codes - luma[..., None], (self.chroma_blur, self.chroma_blur, 0))
            codes = luma[..., None] + smooth
        if self.sharpening:
            luma = codes @ [0.299, 0.587, 0.114]
            codes = codes + self.sharpening * (luma - gaussian_filter(luma, self.radius))[..., None]
        picture = np.rint(255 * np.clip(codes, 0, 1)).astype(np.uint8)
        return picture if self.quality is None else decoded(jpeg(picture, self.quality))


def balanced(sensor, reflectance):
    """`(m, 3)` camera_rgb of reflectances `(m, 801)` under daylight, 1 for white."""
    weight = d65_spectrum().at(NM) * load_sensor(sensor).electrons_per_joule(NM)
    return reflectance @ weight.T / weight.sum(axis=1)


def jpeg(picture, quality, orientation=None):
    """The bytes of a JPEG file."""
    buffer, exif = io.BytesIO(), Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    Image.fromarray(picture).save(buffer, "JPEG", quality=quality, exif=exif)
    return buffer.getvalue()


def decoded(content):
    return np.array(Image.open(io.BytesIO(content)).convert("RGB"))


def chart_corners(shape, middle=(0.5, 0.5), pitch=75.0, angle=5.0):
    """`(4, 2)` corners of the fields' grid in a picture, from dark skin."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    around = (CORNERS - [3.0, 2.0]) * pitch @ np.array([[c, s], [-s, c]])
    return around + np.array(middle) * [shape[1], shape[0]]


def chart_numbers(shape, corners, samples=4):
    """`(samples**2, h, w)` number of the field at points within each pixel; `FRAME` and `GREY` elsewhere."""
    origin, right, down = corners[0], (corners[1] - corners[0]) / 6.0, (corners[3] - corners[0]) / 4.0
    inverse = np.linalg.inv(np.stack([right, down], axis=1))
    steps = (np.arange(samples) + 0.5) / samples
    layers = []
    for dy in steps:
        for dx in steps:
            x, y = np.meshgrid(np.arange(shape[1]) + dx, np.arange(shape[0]) + dy)
            place = (np.stack([x, y], axis=-1) - origin) @ inverse.T
            cell = np.floor(place)
            numbers = np.full(shape, GREY)
            numbers[((place > -0.3) & (place < [6.3, 4.3])).all(axis=-1)] = FRAME
            field = ((np.abs(place - cell - 0.5) < 0.45) & (cell >= 0) & (cell < [6, 4])).all(axis=-1)
            numbers[field] = (cell[..., 1] * 6 + cell[..., 0])[field]
            layers.append(numbers)
    return np.stack(layers)


def chart_rgb(sensor, shape, corners):
    """`(h, w, 3)` balanced camera_rgb of a chart on a grey wall."""
    chart = colour_checker_reflectances().at(NM)
    table = balanced(sensor, np.concatenate([chart, chart[23:], np.full((1, NM.size), 0.25)]))
    return table[chart_numbers(shape, corners)].mean(axis=0)


def photographed_chart(camera, shape=(480, 640), seed=0, **place):
    """Picture of a chart, and its corners."""
    corners = chart_corners(shape, **place)
    return camera.photograph(chart_rgb(camera.sensor, shape, corners), seed), corners


def natural_reflectances():
    """`(n, 801)` measured reflectances of fruit, leaves, stems, bark and straw that are shipped."""
    files = (
        "fruit/vrhel_fruit_vegetable_reflectance", "leaf/vrhel_leaf_reflectance",
        "organ/vrhel_wood_bark_straw_reflectance", "organ/vrhel_white_fabric_reflectance",
        "organ/koivisto_plant_stem_reflectance",
    )  # fmt: skip
    curves = [curve.at(NM) for file in files for curve in read_spectra(file, outside="hold").values()]
    return np.clip(np.array(curves), 0.0, 1.0)
