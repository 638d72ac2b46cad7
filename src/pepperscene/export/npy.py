"""NumPy files of band images, with a table of the bands.

Format: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pepperscene.errors import InputError
from pepperscene.export.band_frames import BAND_IMAGES, UNITS, band_image, frame_bands
from pepperscene.export.job import ExportJob

_LABELS = ("class", "instance")


def write_npy(job: ExportJob, folder: Path) -> None:
    """Write `train/reflectance/000110.npy` of each band image and label, and `bands.json`.

    Band images are `(h, w, c)` float32, labels `(h, w)`. `bands.json` has the number, name, centre and full
    width at half maximum of each band, which are the same in all frames, and the units of the images.
    """
    outputs = job.common_outputs((*BAND_IMAGES, *_LABELS))
    table: dict[str, Any] | None = None
    for split, frames in job.frames_by_split():
        for output in outputs:
            (folder / split / output).mkdir(parents=True)
        for frame in frames:
            bands = frame_bands(frame)
            listed = [{"number": number, **band.to_json()} for number, band in enumerate(bands, start=1)]
            units = {output: UNITS[output] for output in outputs if output in UNITS}
            table = table or {"bands": listed, "units": units}
            if listed != table["bands"]:
                problem = "must be the same in all frames of this format, which has one bands.json"
                raise InputError(frame.dataset.frame_path(frame.index), problem, key="camera.bands")
            for output in outputs:
                is_label = output in _LABELS
                image = frame.image(output) if is_label else band_image(frame, output, bands)
                np.save(folder / split / output / f"{frame.name}.npy", image, allow_pickle=False)
    (folder / "bands.json").write_text(json.dumps(table, indent=1, allow_nan=False) + "\n", encoding="utf-8")
