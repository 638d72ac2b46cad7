"""Time of each step of the image signal processor, and of a whole photograph, at 800 x 600 pixels.

python benchmarks/isp.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np

from pepperscene.camera import (
    Camera,
    Developing,
    ImageProcessor,
    develop,
    load_flash,
    load_lens,
    load_processor,
    load_sensor,
)
from pepperscene.camera.image.photo import jpeg_bytes, photo_description

REPEATS: Final = 15
STEPS: Final = {
    "black level, shading": ("black_level_error", "shading_correction", "shading", "shading_cast"),
    "chromatic aberration": ("chromatic_aberration_px", "chromatic_correction"),
    "saturation": ("saturation",),
    "contrast": ("contrast",),
    "noise of luma": ("luma_noise_reduction",),
    "noise of chroma": ("chroma_noise_reduction",),
    "local tones": ("local_tone_mapping", "local_contrast"),
    "sharpening": ("sharpening", "sharpening_radius_px", "sharpening_threshold"),
}


def milliseconds(call: Callable[[], Any]) -> float:
    """The least time of the processor for a call; other programs delay the rest."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def main() -> None:
    """Print a table."""
    sensor = replace(load_sensor("ueye_ui5250re"), columns=800, rows=600)
    camera = Camera(load_lens("lensagon_cmfa0420nd"), sensor, flash=load_flash("led_matrix_200klx"))
    electrons = np.random.default_rng(0).random((600, 800, 3), np.float32) * sensor.full_well_e

    def photograph(isp: ImageProcessor | None) -> float:
        processed = replace(camera, developing=Developing(isp=isp))
        return milliseconds(lambda: develop(electrons, processed))

    # Chromatic aberration is the webcam's, local tone mapping the telephone's: every step once.
    every = load_processor("webcam").completed(load_processor("telephone"))
    without, whole = photograph(None), photograph(every)
    table = photograph(ImageProcessor(contrast=0.0))
    print(f"developing without a processor  {without:6.1f} ms")
    print(f"with the tone curve by a table  {table - without:+6.1f} ms")
    for title, names in STEPS.items():
        step = ImageProcessor(**{f.name: getattr(every, f.name) for f in fields(every) if f.name in names})
        print(f"{title:31} {photograph(step) - table:+6.1f} ms")
    print(f"{'all steps':31} {whole - without:+6.1f} ms")
    image, photo = develop(electrons, camera), photo_description(camera)
    print(f"{'JPEG (where files are written)':31} {milliseconds(lambda: jpeg_bytes(image, photo)):+6.1f} ms")


if __name__ == "__main__":
    main()
