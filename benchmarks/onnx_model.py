"""Frames per second of a network as an ONNX file, by onnxruntime on the processor.

    python benchmarks/onnx_model.py                         # networks with random weights, 640 x 480
    python benchmarks/onnx_model.py out/detector --threads 2

Weights do not matter for the time. It states the median over images, and the CPU time of one.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np
import onnxruntime

from pepperscene import TrainedModel, export_model, load_model
from pepperscene.bench.records import describe_machine, machine_info
from pepperscene.cli.options import parse_size
from pepperscene.learning.models.trained_model import build_network
from pepperscene.learning.options import parse_classes

NETWORKS: Final = ("efficientnet_lite0", "small")
FRUIT: Final = {"segment": "other=background+leaf+stem+shoot+wire+cut,fruit=pepper,peduncle", "detect": None}


def random_models() -> dict[str, TrainedModel]:
    """Networks of both tasks by name."""
    models = {}
    for name in NETWORKS:
        for task, text in FRUIT.items():
            classes = parse_classes(task, text)
            module = build_network(task, name, len(classes))
            models[f"{task} {name}"] = TrainedModel(module, name, classes, task=task)
    return models


def measure(model: TrainedModel, size: tuple[int, int], threads: int, images: int) -> tuple[float, float]:
    """Seconds, and CPU seconds, of an image of a size."""
    with tempfile.TemporaryDirectory() as folder:
        written = export_model(model, Path(folder) / "model.onnx", size)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        session = onnxruntime.InferenceSession(str(written.file), options, providers=["CPUExecutionProvider"])
    pixels = np.random.default_rng(0).random((1, 3, *size), np.float32)
    session.run(None, {"image": pixels})
    walls, start = [], time.process_time()
    for _ in range(images):
        begin = time.perf_counter()
        session.run(None, {"image": pixels})
        walls.append(time.perf_counter() - begin)
    return statistics.median(walls), (time.process_time() - start) / images


def main() -> int:
    """Print a line for each network."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*", help="trained models; none for random ones of both tasks")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--images", type=int, default=30)
    chosen = parser.parse_args()
    models = {text: load_model(text) for text in chosen.models} or random_models()
    print(describe_machine(machine_info()))
    for name, model in models.items():
        wall_s, cpu_s = measure(model, parse_size(chosen.size), chosen.threads, chosen.images)
        print(f"{name}: {1 / wall_s:.1f} frames/s, {cpu_s:.3f} s of CPU time an image of {chosen.size}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
