"""Files that never end, wait, are too long, expand, or lead out of a data set, each with what reads it.

Run as a program in a folder that holds the data set `set`: prints a line of JSON for each case, its name and
what came of it. The program may use a little more memory than it has after its imports.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import socket
import sys
from pathlib import Path

LIMIT_S = 60  # for a case that never ends; most take milliseconds
LIMIT_BYTES = 300_000_000  # more than after the imports
HUGE = 20_000_000_000

# --- what stands in place of a file ------------------------------------------------------------------------


def device(path):
    path.symlink_to("/dev/zero")


def pipe(path):
    os.mkfifo(path)


def unix_socket(path):
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(path))


def folder(path):
    path.mkdir()


def sparse(path):
    with path.open("wb") as file:
        file.truncate(HUGE)


def system_file(path):
    path.symlink_to("/proc/self/maps")


TARGETS = [device, pipe, unix_socket, folder, sparse, system_file]

# --- readers of files that a user names --------------------------------------------------------------------


def readers():
    from pepperscene.building.execution.slurm import read_slurm_file
    from pepperscene.camera.optics.calibration import read_calibration
    from pepperscene.camera.pose_files.formats import read_poses
    from pepperscene.camera.sensor.sensor_files import load_sensor
    from pepperscene.colour import open_patches
    from pepperscene.cultivar import load_cultivar
    from pepperscene.dataset.readers.coco import open_coco
    from pepperscene.dataset.readers.pictures import photo_shape, read_mask, read_photo
    from pepperscene.dataset.store.images import read_image
    from pepperscene.document import read_toml
    from pepperscene.geometry.fruit.scan_file import read_triangles
    from pepperscene.learning.tasks.frames import read_values
    from pepperscene.recipe.resolve.load import load_recipe
    from pepperscene.spectra import read_spectra

    several = {
        read_poses: ("a.tum", "poses.csv", "transforms.json", "images.txt"),
        read_triangles: ("fruit.glb", "fruit.obj", "fruit.ply", "fruit.stl"),
        read_image: ("image.png", "image.exr", "image.json"),
    }
    return {name: read for read, names in several.items() for name in names} | {
        "a.yaml": read_calibration, "recipe.toml": load_recipe, "cultivar.toml": load_cultivar,
        "sensor.toml": load_sensor, "jobs.toml": read_slurm_file, "bounds.toml": read_toml,
        "patches.toml": open_patches, "spectra.csv": read_spectra, "photo.png": read_photo,
        "photo.jpg": photo_shape, "mask.png": read_mask, "annotations.json": open_coco,
        "values.npy": read_values,
    }  # fmt: skip


CONTENTS = {
    "aliases.yaml": "a0: &a0 [1]\n"
    + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 12)}]\n" for n in range(1, 12))
    + "image_width: *a11\nimage_height: 3\ncamera_matrix: [1]\n",
    "merges.yaml": "a0: &a0 {b: 1}\n"
    + "".join(f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 12)}]}}\n" for n in range(1, 12)),
    "itself.yaml": "image_width: &a [*a]\nimage_height: 2\n",
    "long.yaml": "a: [" + "1, " * 200_000 + "]",
    "deep.json": '{"frames": ' + "[" * 1_000_000,
    "values.json": '{"frames": [' + "[],[]," * 4_000_000 + "[]]}",
    "text.json": '{"frames": "' + "x" * 20_000_000 + '"}',
    "header.csv": "," * 10_000_000,
    "columns.csv": ",".join(["x"] * 3_000),
    "line.tum": "1 " * 10_000_000,
    "points.txt": "# images.txt\n1 1 0 0 0 0 0 0 1 a.png\n" + "11 " * 8_000_000 + "\n",
    "key.toml": ".".join("a" * 500_000) + " = 1",
    "tables.toml": "[[a]]\n" * 500_000,
    "lists.toml": "a = [" + "[]," * 1_000_000 + "]",
    "number.toml": "seed = 0x" + "f" * 1_000_000,
    "keys.toml": "".join(f"k{n} = 1\n" for n in range(200_000)),
    "names.toml": 'extends = "demo"\nname = "a"\n[camera]\nexposure_us = { in_turn = ['
    + ",".join(f'"{n}"' for n in range(100_000)) + "] }",
    "turns.toml": 'extends = "demo"\nname = "a"\n[camera]\nexposure_us = { in_turn = ['
    + ",".join(f"{100 + n / 1000}" for n in range(200_000)) + ",-5] }",
    "outcomes.toml": 'extends = "demo"\nname = "a"\n[camera.exposure_us]\n'
    + "".join(f"{n} = 1e-5\n" for n in range(100, 100_100)),
}  # fmt: skip
READERS_OF_CONTENTS = {".yaml": "a.yaml", ".json": "transforms.json", ".csv": "poses.csv", ".tum": "a.tum",
                       ".txt": "a.tum", ".toml": "recipe.toml"}  # fmt: skip

# --- data sets ---------------------------------------------------------------------------------------------

SET_FILES = [
    "dataset.json", "frames/000000.json", "colour/000000.png", "distance/000000.exr", "harvest/000000.json",
    "journal.jsonl", "manifest.parquet", "fruit.parquet",
]  # fmt: skip


def outside(path):
    """A regular file elsewhere, which holds what the data set has held."""
    other = Path("elsewhere") / path.name
    shutil.copy2(Path("set", *path.parts[1:]), other)
    path.symlink_to(other.absolute())


def outside_folder(path):
    other = Path("elsewhere") / f"{path.parent.name}_folder"
    path.parent.rename(other)
    path.parent.symlink_to(other.absolute())


def operations():
    from pepperscene.dataset.readers import open_images
    from pepperscene.dataset.store.dataset import open_dataset
    from pepperscene.export import export_dataset
    from pepperscene.review.check import check_dataset
    from pepperscene.review.report import write_report

    def check(path):
        return [f"{finding.file}: {finding.problem}" for finding in check_dataset(path, workers=1).findings]

    def manifest(path):
        dataset = open_dataset(path)
        return [dataset.manifest().num_rows, dataset.fruit().num_rows]

    return {
        "check": check,
        "report": lambda path: write_report(path),
        "export": lambda path: export_dataset(path, Path("exported"), "coco"),
        "read": lambda path: [image.size for image in open_images(path)],
        "tables": manifest,
    }


def cases():
    """Each case by name: a function that returns what came of it."""
    known = readers()
    for target in TARGETS:
        for name, read in known.items():
            yield f"{target.__name__} as {name}", lambda p=Path(name), t=target, r=read: (t(p), r(p))[1]
    for name, text in CONTENTS.items():
        read = known[READERS_OF_CONTENTS[Path(name).suffix]]
        yield name, lambda p=Path(name), c=text, r=read: (p.write_text(c), r(p))[1]
    for target in (device, pipe, sparse, outside, outside_folder):
        for name in SET_FILES:
            if target is outside_folder and "/" not in name:
                continue
            for operation, run in operations().items():

                def damage(t=target, f=Path("damaged") / name, r=run):
                    shutil.copytree("set", "damaged")
                    if t is not outside_folder:
                        f.unlink()
                    t(f)
                    return r(Path("damaged"))

                yield f"{operation} with {target.__name__} as {name}", damage


def outcome(run):
    from pepperscene.errors import PepperError

    signal.alarm(LIMIT_S)
    try:
        result = run()
    except PepperError as error:
        return {"error": str(error)}
    except BaseException as error:
        return {"fault": f"{type(error).__name__}: {error}"[:500]}
    finally:
        signal.alarm(0)
    return {"result": result if isinstance(result, list) else type(result).__name__}


def empty(path):
    for entry in path.iterdir():
        if entry.name in ("set", "cases"):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    (path / "elsewhere").mkdir()


def main():
    everything = list(cases())
    # What is imported and cached by a data set without damage is not counted.
    for run in operations().values():
        empty(Path())
        shutil.copytree("set", "damaged")
        outcome(lambda run=run: run(Path("damaged")))
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + LIMIT_BYTES,) * 2)
    for name, run in everything:
        empty(Path())
        sys.stdout.write(json.dumps({"name": name, **outcome(run)}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
