"""What the sources may do: where code, files and numbers come from; docstrings name what exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from source_trees import PACKAGE, SOURCES, calls, keywords_of, name_of, nodes

ROOT = Path(__file__).parents[2]
PROGRAMS = [
    *SOURCES,
    *sorted(path for name in ("benchmarks", "docs") for path in (ROOT / name).rglob("*.py")),
]
"""Files that may start Python: the package, and the scripts around it."""

# --- code comes from constant names, pipes and the user ----------------------------------------------------

RUNS_NAMES = {
    "__import__", "eval", "exec", "import_library", "import_module", "run_module", "run_path",
    "spec_from_file_location",
}  # fmt: skip
"""Functions that run the code which a text names or holds."""

NAMED_IMPORTS = {
    ("user_code.py", "import_module"): "a name that the user typed, and only if code is allowed",
    ("recipe/views/user_function.py", "run_path"): "the file of a recipe, after `ResolvedRecipe.check_code`",
    ("building/subprocess_rpc.py", "import_module"): "a name from the parent process",
    ("export/formats.py", "import_module"): "a value of the table FORMATS",
    ("export/run.py", "import_library"): "a value of the table FORMATS",
    ("libraries.py", "import_module"): "the argument of `import_library`, which this test checks",
}
"""The only imports by a name that is no constant, and why they are safe."""

PICKLES = {
    "building/subprocess_rpc.py": "pipes between the processes of a build",
    "building/execution/dask_executor.py": "connections of a Dask cluster",
    "building/execution/dask_worker.py": "connections of a Dask cluster",
}
"""The only modules that read pickles, and where these come from."""

SEARCH_PATHS = {
    "user_code.py": "the current folder, during an import that the user has allowed",
    "building/subprocess_rpc.py": "a worker imports from the folders of its parent",
    "__main__.py": "takes the current folder off",
}
"""The only modules that change `sys.path`."""


def is_attribute(node: ast.AST, *names: str) -> bool:
    has_name = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    return has_name and f"{node.value.id}.{node.attr}" in names


def test_code_is_imported_by_constant_names_only() -> None:
    found = set()
    for path in SOURCES:
        for function, call in calls(path):
            name = function.rpartition(".")[2]
            # Dr.Jit and torch have methods `eval` and `exec`, which compute values.
            runs = name in RUNS_NAMES and (function == name or name not in ("eval", "exec"))
            if runs and not (call.args and isinstance(call.args[0], ast.Constant)):
                found.add((name_of(path), name))
            # Names of the user are imported only with a permission that is passed on.
            if name == "import_callable":
                assert keywords_of(call)["allow_code"] not in ("True", "False"), name_of(path)
    assert found == set(NAMED_IMPORTS)


def test_child_interpreters_do_not_search_the_current_folder() -> None:
    """`sys.executable` is the first word of a list, and `-P` the second."""
    found = []
    for path in PROGRAMS:
        lists = (node.elts for node in nodes(path) if isinstance(node, ast.List | ast.Tuple))
        safe = {id(one[0]) for one in lists if len(one) > 1 and ast.unparse(one[1]) == "'-P'"}
        executables = (node for node in nodes(path) if is_attribute(node, "sys.executable"))
        found += [name_of(path) for node in executables if id(node) not in safe]
    # Slurm's workers are started by dask-jobqueue, and inherit PYTHONSAFEPATH from the script; `bpy_python`
    # returns the Python of Blender, whose two calls have -P.
    assert sorted(found) == ["building/execution/slurm.py", "cycles_process.py"]
    slurm, cycles = PACKAGE / "building/execution/slurm.py", ROOT / "benchmarks/cycles/cycles_process.py"
    assert "export PYTHONSAFEPATH=1" in slurm.read_text(encoding="utf-8")
    assert cycles.read_text(encoding="utf-8").count('[bpy_python(), "-P", ') == 2


def test_no_shell_runs_and_pickles_come_from_pipes_only() -> None:
    readers = set()
    for path in SOURCES:
        for function, call in calls(path):
            keywords = keywords_of(call)
            assert "shell" not in keywords, name_of(path)
            assert function not in ("os.system", "os.popen", "yaml.load", "yaml.unsafe_load"), name_of(path)
            assert keywords.get("allow_pickle", "False") == "False", name_of(path)
            assert function != "torch.load" or keywords.get("weights_only") == "True", name_of(path)
        if any(is_attribute(node, "pickle.load", "pickle.loads", "pickle.Unpickler") for node in nodes(path)):
            readers.add(name_of(path))
    assert readers == set(PICKLES)


def changes_the_search_path(node: ast.AST) -> bool:
    """Whether `sys.path` is assigned, deleted from, or changed by a method, also in a text of code."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return is_attribute(node.func.value, "sys.path")
    if isinstance(node, ast.Delete | ast.Assign):
        targets = node.targets if isinstance(node, ast.Delete) else node.targets[:1]
        return any("sys.path" in ast.unparse(target) for target in targets)
    text = str(node.value) if isinstance(node, ast.Constant) else ""
    return "sys.path" in text and "import sys" in text


def test_the_search_path_of_modules_changes_in_few_places() -> None:
    changes = {name_of(path) for path in SOURCES if any(map(changes_the_search_path, nodes(path)))}
    assert changes <= set(SEARCH_PATHS)


# --- files are opened by the bounded reader, and images by their formats ------------------------------------

BOUNDED = re.compile(r"\b(open_file|check_file|open_table_file|read_file|BytesIO)\(")
WRITING = re.compile(r"""['"](w|wb|a|ab|x|xb)['"]|O_WRONLY""")
METHODS = {"open", "read_text", "read_bytes", "fromfile", "memmap", "imread", "genfromtxt", "loadtxt"}
"""Methods that read a file, whatever they belong to."""

FUNCTIONS = {
    "open", "safe_open", "load_file", "np.load", "torch.load", "pickle.load", "trimesh.load",
    "trimesh.load_mesh", "OpenEXR.File", "parquet.read_table", "parquet.ParquetFile", "pyarrow.OSFile",
    "pyarrow.memory_map", "zipfile.ZipFile", "shutil.copy", "shutil.copy2", "shutil.copyfile",
    "shutil.copytree",
}  # fmt: skip

EXCEPTIONS = {
    ("__main__.py", "os.open(os.devnull, os.O_RDWR)"): "the null device",
    ("__main__.py", "open(descriptor, mode, encoding='utf-8', closefd=False)"): "a standard stream",
    ("bench/records.py", "file.read_text(encoding='utf-8')"): "/proc/cpuinfo",
    ("building/memory.py", "groups.read_text()"): "of the system",
    ("building/memory.py", "(folder / name).read_text()"): "of the system, below /sys",
    (
        "review/report/page.py",
        "resources.files(_PACKAGE).joinpath('templates', name).read_text(encoding='utf-8')",
    ): "of this package",
    ("atomic.py", "os.open(folder, os.O_RDONLY)"): "a folder, to lock it",
    ("atomic.py", "temporary.open('rb+')"): "its own temporary file, to flush it",
    ("dataset/store/images.py", "OpenEXR.File(header, channels)"): "an image in memory, to write it",
    ("building/subprocess_rpc.py", "pickle.load(requests)"): "a pipe between processes of one build",
    ("building/subprocess_rpc.py", "pickle.load(self._process.stdout)"): "another such pipe",
    ("building/subprocess_rpc.py", "pickle.load(self._requests)"): "another such pipe",
    ("cli/datasets.py", "webbrowser.open(page.absolute().as_uri())"): "a page for the browser",
    (
        "learning/models/efficientnet.py",
        "torch.load(file, map_location='cpu', weights_only=True)",
    ): "of an installed package",
    ("export/simulators/usd.py", "path.read_bytes()"): "its own temporary file",
    ("notebook_view.py", "Image.open(picture, formats=('PNG',))"): "opened by the caller",
}

REQUIRED = {"Image.open": "formats", "trimesh.load": "skip_materials"}
"""Keyword argument that a call must have: materials of a mesh name images, which Pillow opens."""

FORBIDDEN = {"imread", "imopen", "mimread", "imread_collection"}
"""Functions of image libraries that choose the format by the content: Pillow starts programs for some."""


def opened_names(path: Path) -> set[str]:
    """The names of a module that are bound to what the bounded reader has opened."""
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Assign):
            value, targets = node.value, node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            value, targets = node.value, [node.target]
        elif isinstance(node, ast.withitem):
            value, targets = node.context_expr, [node.optional_vars]
        else:
            continue
        names = {target.id for target in targets if isinstance(target, ast.Name)}
        if names and BOUNDED.search(ast.unparse(value)):
            found |= names
    return found


def reading_calls(path: Path) -> set[str]:
    """The calls in a module that may read a file by its name."""
    found, opened = set(), opened_names(path)
    for function, call in calls(path):
        method = function.rpartition(".")[2] if isinstance(call.func, ast.Attribute) else ""
        if method not in METHODS and function not in FUNCTIONS:
            continue
        first, text = ast.unparse(call.args[0]) if call.args else "", ast.unparse(call)
        if first not in opened and not BOUNDED.search(first) and not WRITING.search(text):
            found.add(text)
    return found


def opens_any_format(path: Path) -> list[str]:
    """Calls that open an image of any format, and imports that would hide them from this check."""
    imports = (node for node in nodes(path) if isinstance(node, ast.ImportFrom))
    hidden = (node for node in imports if node.module in ("PIL.Image", "trimesh"))
    found = [name.name for node in hidden for name in node.names if name.name in ("open", "load")]
    for function, call in calls(path):
        needed = [REQUIRED[name] for name in REQUIRED if f".{function}".endswith(f".{name}")]
        if function.rpartition(".")[2] in FORBIDDEN or {*needed} - keywords_of(call).keys():
            found.append(ast.unparse(call))
    return found


def test_every_file_is_opened_by_the_bounded_reader_or_listed() -> None:
    modules = [path for path in SOURCES if path != PACKAGE / "user_files.py"]
    found = {(name_of(path), call) for path in modules for call in reading_calls(path)}
    assert found == set(EXCEPTIONS)
    assert {name_of(path): found for path in SOURCES if (found := opens_any_format(path))} == {}


@pytest.mark.parametrize(
    ("check", "line", "is_found"),
    [
        *((reading_calls, line, True) for line in ("path.open('rb')", "np.load(path)", "tarfile.open(path)")),
        *((reading_calls, line, False) for line in ("path.open('w')", "read(open_file(path, 'image'))")),
        *((opens_any_format, line, True) for line in ("PIL.Image.open(path)", "from PIL.Image import open")),
        *((opens_any_format, line, True) for line in ("imageio.v3.imread(path)", "trimesh.load(path)")),
        (opens_any_format, "Image.open(path, formats=['PNG'])", False),
    ],
)
def test_calls_that_read_files_are_found(tmp_path, check, line, is_found) -> None:
    (tmp_path / "module.py").write_text(line)
    assert bool(check(tmp_path / "module.py")) is is_found


# --- JSON has no number that JSON does not have: encoders refuse nan and inf --------------------------------

NOT_WRITTEN = {
    "document.py": "quotes keys in messages",
    "render/doctor.py": "between two processes of this program",
    "bench/frames_child.py": "between two processes of this program",
    "bench/profile.py": "between two processes of this program",
    "bench/measure.py": "between two processes of this program",
    "building/viewpoints/table.py": "of settings, for a digest",
    "export/yolo.py": "quotes names",
    "export/bop.py": "compared with a recorded recipe",
    "export/huggingface.py": "names of columns; values are encoded without nan",
    "recipe/recipe.py": "of a recipe, whose numbers are finite, for a digest",
    "recipe/resolve/resolved.py": "of a recipe, whose numbers are finite, for a digest",
    "recipe/resolve/frame_setups.py": "of a recipe, whose numbers are finite, as a key",
    "dataset/store/manifest.py": "of values of a recipe, whose numbers are finite",
    "review/check/one_frame.py": "of digests and rows of tables, for a digest",
    "recipe/variation/varied.py": "of outcomes, as a key",
}
"""Modules whose JSON text is no file and no output."""


def test_encoders_refuse_what_json_does_not_have() -> None:
    lenient = set()
    for path in SOURCES:
        for function, call in calls(path):
            module, _, name = function.rpartition(".")
            encodes = "json" in module and name in ("dump", "dumps", "JSONEncoder")
            if encodes and keywords_of(call).get("allow_nan") != "False":
                lenient.add(name_of(path))
    assert lenient == NOT_WRITTEN.keys()


# --- versions and docstrings --------------------------------------------------------------------------------

RECORDS = {
    "bench/scenes.py",  # identity of a cached reference
    "cli/application.py",  # --version
    "building/scenes/row_cache.py",  # names of files
    "building/execution/dask_worker.py",  # workers have the version of the build
    "building/execution/job.py",  # dataset.json
    "export/simulators/contents.py",  # JSON of a scene
    "export/bop.py",  # plants are grown again only by the version that grew them
    "review/report/scene_view.py",  # as in bop
    "building/viewpoints/table.py",  # metadata of a table
    "learning/evaluation/predict.py",
    "learning/models/onnx_export.py",
    "learning/models/trained_model.py",
    "learning/training/run.py",
    "render/doctor.py",
    "render/renderer.py",  # a frame's JSON
    "tuning/report.py",
}
"""Modules that write the version into a file or a message, or compare what was written."""


def test_version_is_recorded_and_draws_nothing() -> None:
    """Growing, placing and drawing modules do not know the version: it cannot enter a random stream."""
    users = set()
    for path in SOURCES:
        for node in nodes(path):
            named = isinstance(node, ast.ImportFrom) and node.module == "pepperscene.version"
            if named or is_attribute(node, "pepperscene.__version__"):
                users.add(name_of(path))
    assert users == RECORDS


ENTRY = re.compile(r"([\w*]+(?:, [\w*]+)*)(?: \([^)]*\))?:(?:\s|$)")


def entries(node: ast.AST, section: str) -> list[str]:
    """The names that a section of a docstring such as "Args" lists."""
    names: list[str] = []
    base = indent = None
    for line in (ast.get_docstring(node) or "").splitlines():
        depth = len(line) - len(line.lstrip())
        if line.strip() == f"{section}:":
            base, indent = depth, None
        elif base is not None and line.strip():
            if depth <= base:
                break
            indent = depth if indent is None else indent
            if depth == indent and (found := ENTRY.match(line.strip())):
                names += [name.strip("* ") for name in found[1].split(",")]
    return names


def members(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Names of a class and its bases: fields, methods, and what methods assign to `self`."""
    names: set[str] = set()
    for base in node.bases:
        if isinstance(base, ast.Name) and base.id in classes:
            names |= members(classes[base.id], classes)
    for item in ast.walk(node):
        if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
            names.add(item.id)
        elif isinstance(item, ast.Attribute) and isinstance(item.ctx, ast.Store):
            names.add(item.attr)
        elif isinstance(item, ast.FunctionDef):
            names.add(item.name)
    return names


def arguments(*functions: ast.FunctionDef) -> set[str]:
    return {item.arg for node in functions for item in ast.walk(node.args) if isinstance(item, ast.arg)}


def test_docstrings_name_what_exists() -> None:
    everything = [(path, node) for path in SOURCES for node in nodes(path)]
    classes = {node.name: node for _, node in everything if isinstance(node, ast.ClassDef)}
    missing, read = [], 0
    for path, node in everything:
        if isinstance(node, ast.ClassDef):
            functions = (item for item in node.body if isinstance(item, ast.FunctionDef))
            known = members(node, classes) | arguments(*(one for one in functions if one.name == "__init__"))
            named = entries(node, "Attributes") + entries(node, "Args")
        elif isinstance(node, ast.FunctionDef):
            known, named = arguments(node), entries(node, "Args")
        else:
            continue
        read += len(named)
        missing += [f"{path.name}: {node.name}: {name}" for name in named if name not in known]
    assert missing == []
    assert read > 1000
