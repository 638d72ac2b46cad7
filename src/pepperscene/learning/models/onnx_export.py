"""Trained networks as ONNX files, which robots run without torch."""

from __future__ import annotations

import copy
import io
import json
import logging
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from pepperscene.atomic import check_can_write, make_folder, write_error, write_file
from pepperscene.errors import ArgumentError
from pepperscene.learning.models.trained_model import TrainedModel, apply_model, require_torch
from pepperscene.learning.options import LEAST_SIDE, MOST_SIDE
from pepperscene.libraries import import_library
from pepperscene.options import Option
from pepperscene.version import __version__

EXTRA: Final = "learn-onnx"
OUTPUTS: Final = {"segment": ("probabilities",), "detect": ("boxes", "scores", "labels", "masks")}
"""Names of the outputs of the file for each task."""

_WIDTH: Final = 640  # chosen: of models without a width
_OPSET: Final = 18  # of 2022, so that older runtimes read it
_TOLERANCE: Final = 1e-4  # chosen: largest difference from torch


@dataclass(frozen=True)
class OnnxFile:
    """A network that was written as ONNX.

    Attributes:
        file: its path.
        size: height and width in pixels of the images that it takes.
        difference: largest difference from torch for an image of random pixels: of probabilities, or of
            scores and of what the network of a detector predicts, relative to values above 1.
    """

    file: Path
    size: tuple[int, int]
    difference: float


def export_model(model: TrainedModel, out: str | Path, size: tuple[int, int] | None = None) -> OnnxFile:
    """Write a network as an ONNX file, and compare it with torch by onnxruntime on the CPU.

    Its input `image` `(1, 3, h, w)` float32 is an sRGB image, 0 to 1, of a fixed size. Its outputs are
    `probabilities` `(1, k, h, w)`, or of a detector `boxes`, `scores`, `labels` and `masks`, as of
    `FoundObjects`. Metadata of the file say classes, colours, scale of the input, task and version.

    Args:
        model: a trained network.
        out: the file.
        size: height and width of the images; None for the width of the model, or 640, at a ratio of 4 to 3.

    Raises:
        ArgumentError: the size is not allowed, the network cannot be exported, or differs from torch.
        OutputError: the file cannot be written.
        SetupError: torch, onnx, onnxscript or onnxruntime is not installed.
    """
    require_torch()
    width = model.width or _WIDTH
    chosen = size or (round(width * 3 / 4), width)
    Option("", minimum=LEAST_SIDE, maximum=MOST_SIDE).check("size", chosen)
    file = Path(out)
    check_can_write(file.parent, (file.name,))
    content, difference = _convert(model, chosen)
    if not difference <= _TOLERANCE:
        raise ArgumentError("model", f"gives other results as ONNX: they differ by {difference:.2g}")
    try:
        make_folder(file.parent, [])
        write_file(file, content)
    except OSError as error:
        raise write_error(error, file) from None
    return OnnxFile(file, chosen, difference)


def _convert(model: TrainedModel, size: tuple[int, int]) -> tuple[bytes, float]:
    """The file of a network, and its largest difference from torch for an image of random pixels."""
    import torch

    from pepperscene.learning.models.detector import ObjectMaps, find_objects

    import_library("onnxscript", EXTRA)
    module = _exported_module(model)
    # Maps of a detector are outputs for the comparison only.
    count, checked = len(OUTPUTS[model.task]), ObjectMaps._fields if model.task == "detect" else ()
    names = [*OUTPUTS[model.task], *checked]
    pixels = np.random.default_rng(0).random((1, 3, *size), np.float32)
    inputs = torch.from_numpy(pixels)
    # The exporter reports its progress and what its libraries will change.
    silence = io.StringIO()
    logging.disable(logging.WARNING)
    try:
        with redirect_stdout(silence), redirect_stderr(silence), warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            expected = module(inputs)
            options = {"input_names": ["image"], "output_names": names, "opset_version": _OPSET}
            program = torch.onnx.export(module, (inputs,), dynamo=True, **options)
    except (RuntimeError, ValueError, TypeError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ArgumentError("model", f"cannot be exported ({reason})") from None
    finally:
        logging.disable(logging.NOTSET)
    assert program is not None
    proto = program.model_proto
    runtime = import_library("onnxruntime", EXTRA)
    session = runtime.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    results = session.run(None, {"image": pixels})
    if checked:
        # Rounding decides which of two nearly equal cells is a peak: take the file's own maps.
        maps = ObjectMaps(*map(torch.from_numpy, results[count:]))
        expected = (*find_objects(maps, size), *expected[count:])
    difference = 0.0
    for name, result, tensor in zip(names, results, expected, strict=True):
        reference = tensor.numpy()
        if name == "scores":
            # Objects of nearly equal scores change places.
            reference, result = np.sort(reference), np.sort(result)
        if name in ("probabilities", "scores", *checked):
            relative = np.abs(result - reference) / np.maximum(1.0, np.abs(reference))
            difference = max(difference, float(relative.max()))
    del proto.graph.output[count:]
    return _cleaned(proto, _metadata(model, size)), difference


def _exported_module(model: TrainedModel) -> Any:
    """The module from an image to the outputs, on the processor."""
    import torch

    from pepperscene.learning.models.detector import find_objects

    network = copy.deepcopy(model.module).cpu().float().eval()

    @final
    class Exported(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, image: torch.Tensor) -> Any:
            if model.task == "detect":
                maps = self.network(image)
                return (*find_objects(maps, (image.shape[-2], image.shape[-1])), *maps)
            return (model.decide(apply_model(self.network, image)),)

    return Exported().eval()


def _metadata(model: TrainedModel, size: tuple[int, int]) -> dict[str, str]:
    """What a program needs to know to use the file, as texts.

    Factors multiply the probabilities of pixels before the largest is chosen (`Decision`).
    """
    factors = [1.0] * len(model.classes) if model.decision is None else list(model.decision.factors)
    return {
        "task": model.task,
        "classes": json.dumps(list(model.classes.names), allow_nan=False),
        "organs": str(model.classes),
        "colours": json.dumps(model.classes.colours.tolist(), allow_nan=False),
        "factors": json.dumps(factors, allow_nan=False),
        "input": "sRGB, channels red, green, blue; 8-bit values divided by 255",
        "height": str(size[0]),
        "width": str(size[1]),
        "model": model.model,
        "version": __version__,
    }


def _cleaned(proto: Any, metadata: dict[str, str]) -> bytes:
    """The file without traces of the machine that made it, such as its paths, with these metadata."""
    del proto.metadata_props[:]
    for entry in (proto.graph, *proto.functions):
        del entry.metadata_props[:]
        for part in (*entry.node, *entry.value_info):
            part.doc_string = ""
            del part.metadata_props[:]
    proto.producer_name, proto.producer_version = "pepperscene", __version__
    for key, text in metadata.items():
        proto.metadata_props.add(key=key, value=text)
    return bytes(proto.SerializeToString(deterministic=True))
