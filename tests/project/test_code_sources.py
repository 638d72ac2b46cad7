"""Where code can come from: imports by name, child interpreters, pickles, and the search path of modules."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pepperscene

PACKAGE = Path(pepperscene.__file__).parent
ROOT = Path(__file__).parents[2]
SOURCES = sorted(PACKAGE.rglob("*.py"))
PROGRAMS = [
    *SOURCES,
    *sorted(path for name in ("benchmarks", "docs") for path in (ROOT / name).rglob("*.py")),
]
"""Files that may start Python: the package, and the scripts around it."""

RUNS_NAMES = {
    "__import__", "eval", "exec", "import_library", "import_module", "run_module", "run_path",
    "spec_from_file_location",
}  # fmt: skip
"""Functions that run the code which a text names or holds."""

WORDS = (
    *RUNS_NAMES,
    "import_callable",
    "pickle",
    ".load(",
    "os.",
    "shell",
    "sys.executable",
    "sys.path",
    "yaml.",
)

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


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix() if path.is_relative_to(PACKAGE) else path.name


def called_name(call: ast.Call) -> str:
    """Name of the function that is called, without its module."""
    function = call.func
    if isinstance(function, ast.Attribute):
        # Dr.Jit and torch have methods of these names, which compute values.
        return "" if function.attr in ("eval", "exec") else function.attr
    return function.id if isinstance(function, ast.Name) else ""


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """The syntax of a file, or nothing if it holds none of the words that the tests look for."""
    text = path.read_text(encoding="utf-8")
    return tuple(ast.walk(ast.parse(text))) if any(word in text for word in WORDS) else ()


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    for node in nodes(path):
        if isinstance(node, ast.Call):
            yield called_name(node), node


def is_attribute(node: ast.AST, module: str, name: str) -> bool:
    return (
        isinstance(node, ast.Attribute)
        and node.attr == name
        and isinstance(node.value, ast.Name)
        and node.value.id == module
    )


def test_code_is_imported_by_constant_names_only():
    found = {
        (name_of(path), name)
        for path in SOURCES
        for name, call in calls(path)
        if name in RUNS_NAMES and not (call.args and isinstance(call.args[0], ast.Constant))
    }
    assert found == set(NAMED_IMPORTS)


def test_names_of_the_user_are_imported_only_with_a_permission_that_is_passed_on():
    for path in SOURCES:
        for name, call in calls(path):
            if name == "import_callable":
                permission = {keyword.arg: keyword.value for keyword in call.keywords}["allow_code"]
                assert not isinstance(permission, ast.Constant), name_of(path)


def test_child_interpreters_do_not_search_the_current_folder():
    """`sys.executable` is the first word of a list, and `-P` the second."""
    found = []
    for path in PROGRAMS:
        safe = {
            id(node.elts[0])
            for node in nodes(path)
            if isinstance(node, ast.List | ast.Tuple)
            and len(node.elts) > 1
            and isinstance(node.elts[1], ast.Constant)
            and node.elts[1].value == "-P"
        }
        found += [
            name_of(path)
            for node in nodes(path)
            if is_attribute(node, "sys", "executable") and id(node) not in safe
        ]
    # Slurm's workers are started by dask-jobqueue, and inherit PYTHONSAFEPATH from the script; `bpy_python`
    # returns the Python of Blender, whose two calls have -P.
    assert sorted(found) == ["building/execution/slurm.py", "cycles_process.py"]
    slurm, cycles = (PACKAGE / "building/execution/slurm.py", ROOT / "benchmarks/cycles/cycles_process.py")
    assert "export PYTHONSAFEPATH=1" in slurm.read_text(encoding="utf-8")
    assert cycles.read_text(encoding="utf-8").count('[bpy_python(), "-P", ') == 2


def test_no_command_goes_through_a_shell():
    for path in SOURCES:
        for _, call in calls(path):
            assert "shell" not in {keyword.arg for keyword in call.keywords}, name_of(path)
            assert not is_attribute(call.func, "os", "system"), name_of(path)
            assert not is_attribute(call.func, "os", "popen"), name_of(path)


def test_pickles_come_from_pipes_only():
    readers = {
        name_of(path)
        for path in SOURCES
        for node in nodes(path)
        if is_attribute(node, "pickle", "load")
        or is_attribute(node, "pickle", "loads")
        or is_attribute(node, "pickle", "Unpickler")
    }
    assert readers == set(PICKLES)


def test_readers_of_arrays_and_weights_run_no_pickle():
    for path in SOURCES:
        for name, call in calls(path):
            keywords = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
            assert keywords.get("allow_pickle", "False") == "False", name_of(path)
            if name == "load" and is_attribute(call.func, "torch", "load"):
                assert keywords.get("weights_only") == "True", name_of(path)
            if is_attribute(call.func, "yaml", "load") or is_attribute(call.func, "yaml", "unsafe_load"):
                raise AssertionError(f"{name_of(path)}: yaml.load constructs objects")


def test_the_search_path_of_modules_changes_in_few_places():
    """`sys.path` is assigned, deleted from, or changed by a method."""
    changes = {
        name_of(path)
        for path in SOURCES
        for node in nodes(path)
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and is_attribute(node.func.value, "sys", "path")
        )
        or (isinstance(node, ast.Delete) and "sys.path" in ast.unparse(node))
        or (isinstance(node, ast.Assign) and "sys.path" in ast.unparse(node.targets[0]))
        or (
            isinstance(node, ast.Constant)
            and "sys.path" in str(node.value)
            and "import sys" in str(node.value)
        )
    }
    assert changes <= set(SEARCH_PATHS)
