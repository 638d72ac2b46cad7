"""Images per second of the torch data loader, with 0, 1 and 2 workers.

The set is painted, with noise as of photographs and 340 organs in each JSON, so that nothing is rendered; or
it is one of yours. Files are read again and again, so that they are in the cache of the system. The first
epoch, which starts the workers, is not counted. Run it from the top of the repository on an idle machine with
at least two cores:

    PYTHONPATH=src python benchmarks/loader.py
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import pepperscene as ps
from pepperscene.bench.records import describe_machine, machine_info

SIZE = (300, 400)
Row = dict[str, list[float]]


def make_set(folder: Path) -> Path:
    """A data set of painted frames of `SIZE`, by the painter of the tests."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "dataset"))
    import painted_set
    from PIL import Image, ImageFilter

    class Photographer(painted_set.Painter):
        """Colour images of blurred organs with noise, which PNG compresses as badly as photographs."""

        def render(self, *args: Any, **kwargs: Any) -> ps.Frame:
            frame = super().render(*args, **kwargs)
            rng = np.random.default_rng(0)
            blur = ImageFilter.GaussianBlur(1.0)
            organs = np.asarray(Image.fromarray(frame.images["class_colour"]).filter(blur))
            noise = rng.normal(0.0, 3.0, organs.shape)
            frame.images["colour"] = np.clip(organs + noise, 0, 255).astype(np.uint8)
            return frame

    painted_set.SIZE, painted_set.Painter = SIZE, Photographer
    return painted_set.make_painted_set(folder).folder


def cpu_s() -> float:
    """CPU time of this process and of its workers that have ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def worker_cpu_s(pids: list[int]) -> float:
    """CPU time of workers that run."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split() for pid in pids]
    return sum(int(field[11]) + int(field[12]) for field in fields) / os.sysconf("SC_CLK_TCK")


def measure(
    samples: Any, workers: int, epoch_images: int, collate: Callable[..., Any] | None
) -> tuple[float, float]:
    """Images per second, and milliseconds of CPU time per image in all processes."""
    import torch

    repeated = torch.utils.data.ConcatDataset([samples] * -(-epoch_images // len(samples)))
    loader = torch.utils.data.DataLoader(
        repeated, batch_size=8, num_workers=workers, collate_fn=collate, persistent_workers=workers > 0
    )
    for _ in loader:
        pass
    iterator = iter(loader)
    pids = [worker.pid for worker in getattr(iterator, "_workers", [])]
    start, start_cpu = time.perf_counter(), cpu_s() + worker_cpu_s(pids)
    for _ in iterator:
        pass
    seconds, cpu = time.perf_counter() - start, cpu_s() + worker_cpu_s(pids) - start_cpu
    return len(repeated) / seconds, 1000.0 * cpu / len(repeated)


def configurations(folder: Path) -> dict[str, tuple[Any, Callable[..., Any] | None]]:
    """Data set and collate function by name."""
    standard = ps.Augmentation.standard(SIZE)
    common: dict[str, Any] = {"tensors": "plain", "seed": 0}
    return {
        "image and mask": (ps.torch_images(folder, **common), None),
        "the same, uint8": (ps.torch_images(folder, dtype="uint8", **common), None),
        "image and mask, augmented": (ps.torch_images(folder, augmentation=standard, **common), None),
        "detections of fruit": (ps.torch_detections(folder, **common), ps.collate_detections),
        "detections, augmented": (
            ps.torch_detections(folder, augmentation=standard, **common),
            ps.collate_detections,
        ),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--set", type=Path, help="data set to read (default: a painted one)")
    parser.add_argument("--images", type=int, default=240, help="images of an epoch (default: 240)")
    parser.add_argument("--runs", type=int, default=3, help="runs of each kind (default: 3)")
    options = parser.parse_args()
    import torch

    torch.set_num_threads(1)  # as in workers
    print(describe_machine(machine_info()) + f"; torch {torch.__version__}\n")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.set or make_set(Path(temporary) / "set")
        _measure_all(folder, options.images, options.runs)


def _measure_all(folder: Path, images: int, runs: int) -> None:
    kinds = configurations(folder)
    rates: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for _ in range(runs):
        for name, (samples, collate) in kinds.items():
            for workers in (0, 1, 2):
                rates.setdefault((name, workers), []).append(measure(samples, workers, images, collate))
    print("| images/s (CPU ms per image) | no worker | 1 worker | 2 workers |\n|---|---:|---:|---:|")
    for name in kinds:
        cells = [
            f"{statistics.median(rate for rate, _ in rates[name, workers]):.0f} "
            f"({statistics.median(cpu for _, cpu in rates[name, workers]):.1f})"
            for workers in (0, 1, 2)
        ]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
