"""Three hundred hostile files, each given to a command in a process of its own.

Rationale: files from strangers may be read. None of them may run code, be read without end, or end a
command in a traceback, whatever it is: a device, a pipe, a file of many gigabytes, a picture of many
gigapixels, a model that names a module, a recipe that names a device, or a folder with modules that Python
could import.

Expected of every command: one sentence, exit code 2 (`check` reports findings with 1 or 2), no code run (the
modules in the current folder would create a file), at most 5 s of processor time, and at most 300 MB of
memory.
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest
from command_process import SOURCES, STAND_IN

pytestmark = pytest.mark.long

MOST_MEMORY = 300e6  # bytes
MOST_CPU_S = 5.0
TIME_LIMIT_S = 120.0
MODULES = (
    "evil_net",
    "mitsuba",
    "pepperscene",
    "rerun",
    "torch",
    "numpy",
    "PIL",
    "yaml",
    "matplotlib",
    "drjit",
)
MARK = "import pathlib; pathlib.Path({mark!r}).touch()\ndef make(*_, **__): pathlib.Path({mark!r}).touch()\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The current folder of all commands, with modules that leave a mark, a photograph and a data set."""
    folder = tmp_path_factory.mktemp("hostile")
    for name in MODULES:
        (folder / f"{name}.py").write_text(MARK.format(mark=str(folder / "ran")))
    sys.path[:0] = [path for path in (STAND_IN,) if path not in sys.path]
    from data_sets import make_small_set

    make_small_set(folder / "set")
    (folder / "photo.png").write_bytes(png(64, 48))
    return folder


def png(width, height):
    """A grey picture of any size, in few bytes."""

    def chunk(kind, content):
        body = kind + content
        return len(content).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    packer = zlib.compressobj(9)
    written = height if width * height < 1 << 32 else 1
    rows = b"".join(packer.compress(bytes(min(width, 1 << 20) + 1)) for _ in range(written)) + packer.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def safetensors(description):
    """A file of weights without weights."""
    text = description if isinstance(description, str) else json.dumps(description)
    header = json.dumps({"__metadata__": {"description": text}}).encode()
    return len(header).to_bytes(8, "little") + header


def special(path, kind, outside):
    """Make a file that is none, or one that never ends."""
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "sparse":
            with path.open("wb") as file:
                file.truncate(6 << 30)
        case "loop":
            path.symlink_to(path.name)
        case "outside":
            path.symlink_to(outside)
        case _:
            path.symlink_to(kind)


SPECIAL = ("/dev/zero", "/dev/random", "/dev/stdin", "/proc/self/mem", "fifo", "folder", "sparse", "loop")


def model(**values):
    given = {"format": "pepperscene model 1", "model": "small", "classes": "pepper", "width": 64}
    return safetensors({**given, "version": "0.2.0", "training": {}, **values})


def model_files():
    """Files of weights."""
    names = (
        "evil_net:make", "os:_exit", "builtins:exec", "subprocess:run", "torch:load", "mitsuba:make",
        "pepperscene.learning.models:build_model", "evil_net", "small,width=100000", "small,width=-1",
        "small,evil_net:make", "paper,x=1", "", ":", "a:", ":b", "../evil_net:make", "evil_net.py:make", 5,
        None, ["small"], {"small": 1}, "small" * 100_000, "efficientnet_lite0,weights=evil_net:make",
    )  # fmt: skip
    for name in names:
        yield model(model=name)
    for width in (-5, 0, "abc", 1e8, 10**30, True, [], {}, 0.5, float("nan"), float("inf")):
        yield model(width=width)
    for classes in ("", "x=", 5, None, ["pepper"], "a=b=c", "pepper," * 100_000, "evil_net:make"):
        yield model(classes=classes)
    for training in (5, "text", [1], {"model": "evil_net:make", "start": "evil_net:make"}, None):
        yield model(training=training, model="evil_net:make")
    yield from (b"", b"\xff" * 8, b"\xff" * 100, (1 << 62).to_bytes(8, "little"), b"PK\3\4" + bytes(100))
    yield safetensors("[" * 100_000)
    yield safetensors("null")
    yield b"\x80\x04cos\nsystem\n(S'touch ran'\ntR."


def text_files():
    """Name, content and the recipe that reads it."""
    bomb = "a0: &a0 [1, 1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60))
    calibration, poses, extends = (RECIPE_FILES[name] for name in ("calibration", "poses", "extends"))
    function = 'extends = "demo"\n[views]\nkind = "function"\nfile = "{{}}"\nfunction = "{}"\n'
    yield "a.yaml", bomb + "image_width: *a59\nimage_height: 10\n", calibration
    yield "b.yaml", "image_width: " + "[" * 50_000, calibration
    yield "c.yaml", "image_width: !!python/object/apply:os.system ['touch ran']\n", calibration
    yield "d.yaml", "image_width: " + "9" * 100_000 + "\n", calibration
    yield "e.yaml", "x: y\n" * 2_000_000, calibration
    yield "f.yaml", "\0" * 100, calibration
    yield "a.json", "[" * 200_000, poses
    yield "b.json", '{"frames": ' + "9" * 200_000 + "}", poses
    yield "c.json", '{"frames": [' + "{}," * 500_000 + "{}]}", poses
    yield "d.json", '{"fl_x": NaN, "frames": [{"transform_matrix": [[1e999]]}]}', poses
    yield "a.csv", "time,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1e-308,0,0,0,0,0,0,1\n", poses
    yield "b.csv", "time," + "x," * 1_000_000 + "\n", poses
    yield "c.csv", "time,x,y,z,qx,qy,qz,qw\n" + "0,0,0,0,0,0,0,1\n" * 300_000, poses
    yield "a.txt", "0 1 2\n" * 1_000_000, poses
    yield "b.txt", "0 nan 0 0 0 0 0 1\n", poses
    yield "c.txt", "x" * 50_000_000, poses
    yield "a.py", "import evil_net\ndef poses(scene, rng): evil_net.make()\n", function.format("poses")
    yield "b.py", "import evil_net\n", function.format("x")
    yield "a.toml", "x = " + "[" * 100_000, extends
    yield "b.toml", "x = " + "9" * 1_000_000, extends
    yield "c.toml", "".join(f"k{n} = {n}\n" for n in range(300_000)), extends
    yield "d.toml", 'extends = "d.toml"\n', extends
    many = ", ".join(map(str, range(-1, 100_001)))
    yield "e.toml", f'extends = "demo"\n[daylight]\nilluminance_lx = {{ in_turn = [{many}] }}\n', extends


RECIPE_FILES = {
    "extends": 'extends = "{}"\n',
    "calibration": 'extends = "demo"\n[camera]\ncalibration = "{}"\n',
    "poses": 'extends = "demo"\n[views]\nkind = "poses"\nfile = "{}"\n',
    "cultivar": 'extends = "demo"\ncultivar = "{}"\n',
    "sensor": 'extends = "demo"\n[camera]\nsensor = "{}"\n',
    "lens": 'extends = "demo"\n[camera]\nlens = "{}"\n',
    "flash": 'extends = "demo"\n[camera]\nflash = "{}"\n',
}
SET_FILES = (
    "dataset.json", "frames/000000.json", "class/000000.png", "instance/000000.png", "journal.jsonl",
    "manifest.parquet", "harvest/000000.json", "distance/000000.exr",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A command line, in which `@` is the folder of the case, and what to prepare in this folder."""

    words: tuple[str, ...]
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    special: tuple[tuple[str, str], ...] = ()
    copy_set: bool = False

    def prepare(self, place, folder):
        """Make the files; returns the words of the command."""
        place.mkdir()
        if self.copy_set:
            shutil.copytree(folder / "set", place / "set", symlinks=True)
        for name, content in self.files.items():
            (place / name).write_bytes(content.encode() if isinstance(content, str) else content)
        for name, kind in self.special:
            special(place / name, kind, folder / "photo.png")
        return [word.replace("@", str(place)) for word in self.words]


def cases():
    """All cases."""
    out = ("--out", "@/out")
    predict = ("predict", "@/model.safetensors", "photo.png", *out)
    for content in model_files():
        yield Case(predict, {"model.safetensors": content})
    for kind in SPECIAL:
        yield Case(predict, special=(("model.safetensors", kind),))
        yield Case(("predict", "@", "photo.png", *out), special=(("model.safetensors", kind),))
    for content in itertools.islice(model_files(), 0, 60, 5):
        files = {"model.safetensors": content}
        yield Case(("evaluate", "@/model.safetensors", "set"), files)
        yield Case(("train", "set", "--start", "@/model.safetensors", *out), files)
    for name, content, recipe in text_files():
        files = {name: content, "r.toml": recipe.format(name)}
        yield Case(("build", "@/r.toml", "--dry-run", "--no-probe"), files)
        yield Case(("build", "@/r.toml", *out), files)
    for (name, recipe), kind in itertools.product(RECIPE_FILES.items(), SPECIAL):
        file = "x" + {"calibration": ".yaml", "poses": ".csv"}.get(name, ".toml")
        yield Case(
            ("build", "@/r.toml", "--dry-run", "--no-probe"), {"r.toml": recipe.format(file)}, ((file, kind),)
        )
    for kind in SPECIAL:
        table = (("x.csv", kind),)
        yield Case(("build", "@/x.toml", "--dry-run", "--no-probe"), special=(("x.toml", kind),))
        yield Case(("visibility", "demo", "--out", "@/v.parquet", "--poses", "@/x.csv"), special=table)
        yield Case(("tune", "demo", "--fit", "exposure", "--patches", "@/x.csv", *out), special=table)
        bounds = ("tune", "demo", "--fit", "exposure", "--patches", "@/x.csv", "--bounds", "@/x.toml", *out)
        yield Case(bounds, special=(("x.toml", kind),))
        yield Case(("compare", "@/x.csv", "photo.png"), special=table)
    for name, kind in itertools.product(SET_FILES, ("/dev/zero", "fifo", "sparse", "outside", "folder")):
        yield Case(("check", "@/set"), special=((f"set/{name}", kind),), copy_set=True)
    export = ("export", "@/set", "--format", "coco", *out)
    commands = (("report", "@/set"), export, ("compare", "@/set", "set"))
    for name, words, kind in itertools.product(SET_FILES[:4], commands, ("/dev/zero", "outside")):
        yield Case(words, special=((f"set/{name}", kind),), copy_set=True)
    for size in ((30_000, 30_000), (65_000, 20_000), (2_000_000_000, 2_000_000_000)):
        yield Case(("compare", "@", "@"), {"a.png": png(*size)})
    for words in GOOD:
        yield Case(tuple(words.split()))


GOOD = ("doctor", "recipes", "cultivars", "build demo --dry-run --no-probe")
MEASURE = """
import json, resource, subprocess, sys
code = subprocess.run(sys.argv[2:]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
open(sys.argv[1], "w").write(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss * 1024]))
sys.exit(code)
"""


def limit_memory():
    resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))


def problem_of(words, folder):
    """What is wrong with the end of a command, or None; its processor time and peak memory."""
    usage = folder / "usage.json"
    # `-P` is what the installed command has: the current folder is not on the path.
    command = [sys.executable, "-P", "-c", MEASURE, str(usage)]
    command += [sys.executable, "-P", "-m", "pepperscene", *words]
    process = subprocess.Popen(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": SOURCES}, text=True, errors="replace",
        start_new_session=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        preexec_fn=limit_memory,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return "no end", TIME_LIMIT_S, 0.0
    cpu_s, memory = json.loads(usage.read_text())
    lines = [line for line in output.splitlines() if line.strip()]
    problem = None
    if (folder / "ran").exists():
        (folder / "ran").unlink()
        problem = "code ran"
    elif "Traceback" in output:
        problem = "traceback"
    elif process.returncode not in ((0,) if " ".join(words) in GOOD else (1, 2)):
        problem = f"exit code {process.returncode}"
    elif cpu_s > MOST_CPU_S or memory > MOST_MEMORY:
        problem = "cost"
    elif process.returncode == 2 and words[0] != "check" and len(lines) != 1:
        problem = f"{len(lines)} lines"
    return problem and f"{problem}: {output[-300:]}", cpu_s, memory


def test_no_hostile_file_runs_code_or_costs_much(folder, capsys):
    problems, most_cpu_s, most_memory, number = [], 0.0, 0.0, 0
    for number, case in enumerate(cases(), start=1):
        words = case.prepare(folder / f"case{number}", folder)
        problem, cpu_s, memory = problem_of(words, folder)
        most_cpu_s, most_memory = max(most_cpu_s, cpu_s), max(most_memory, memory)
        if problem is not None:
            what = f"{number} {' '.join(words)[:80]} {case.special}"
            problems.append(f"{what}: {cpu_s:.1f} s, {memory / 1e6:.0f} MB, {problem}")
        shutil.rmtree(folder / f"case{number}")
    with capsys.disabled():
        print(f"\n{number} files: at most {most_cpu_s:.1f} s and {most_memory / 1e6:.0f} MB")  # noqa: T201
    assert number >= 300
    assert not problems, "\n".join(problems)
