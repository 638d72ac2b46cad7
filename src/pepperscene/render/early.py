"""What a first picture waits for besides its scene, begun while the scene is made."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from pepperscene.camera import Camera, reference_correction
from pepperscene.render.denoise import begin as begin_denoising
from pepperscene.render.quality import Quality
from pepperscene.render.variant import kernel


def begin(camera: Camera, quality: Quality) -> threading.Thread:
    """Mitsuba, the denoiser and the camera's colour matrix begin in a thread of their own, which is returned.

    Nothing depends on it but the time: what fails there fails again, and is told, where it is first needed.

    Args:
        camera: whose pictures will be developed.
        quality: of them.
    """

    def work() -> None:
        for step in _steps(camera, quality):
            with suppress(Exception):
                step()

    # No daemon: a process that ends meanwhile must not pull the libraries from under it.
    thread = threading.Thread(target=work, name="start of the renderer")
    thread.start()
    return thread


def _steps(camera: Camera, quality: Quality) -> Iterator[Callable[[], Any]]:
    yield kernel
    if quality.denoise:
        yield begin_denoising
    if camera.sensor.channels > 1 and camera.developing.colour_matrix is True:
        yield lambda: reference_correction(camera)
