"""Structure of the package: public names, imports, sizes of modules."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter

import pytest
from source_trees import PACKAGE, SOURCES, name_of, nodes, tree

MODULES = {
    f"pepperscene.{name_of(path)[:-3].replace('/', '.')}".removesuffix(".__init__"): path for path in SOURCES
}
PUBLIC_PACKAGES = [
    "pepperscene",
    *sorted(f"pepperscene.{folder.parent.name}" for folder in PACKAGE.glob("*/__init__.py")),
]
SUB_PACKAGES = [
    name for name, path in MODULES.items() if path.name == "__init__.py" and name != "pepperscene"
]
HEAVY = {
    "mitsuba", "drjit", "colour", "torch", "scipy", "skimage", "trimesh", "pyoidn", "OpenEXR", "matplotlib",
    "tomlkit",
}  # fmt: skip
MOST_LINES = 400
LAZY = {name for name, path in MODULES.items() if path.with_suffix(".pyi").is_file()}
"""Packages whose names are listed in a stub and loaded on first use."""


def _sort_key(name: str) -> tuple[int, str]:
    """Constants, then classes, then functions, each in alphabetical order, as ruff sorts them (RUF022)."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


@pytest.mark.parametrize("package", PUBLIC_PACKAGES)
def test_public_names_are_sorted_documented_and_no_modules(package: str) -> None:
    module = importlib.import_module(package)
    # lazy_loader sorts the names of a stub by character.
    key = None if package in LAZY else _sort_key
    names = getattr(module, "__all__", ())
    assert list(names) == sorted(set(names), key=key)
    # `package.name` would be the function or the module, depending on what was imported first.
    modules = {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == package}
    for name in names:
        value = getattr(module, name)
        assert name not in modules or inspect.ismodule(value), name
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{package}.{name} has no docstring"


def _re_exports(package: str) -> Iterator[tuple[str, ast.alias]]:
    """The module and the name of each re-export of a package."""
    path = MODULES[package].with_suffix(".pyi" if package in LAZY else ".py")
    for node in tree(path).body:
        if isinstance(node, ast.ImportFrom):
            source = f"{package}.{node.module}" if node.level == 1 else str(node.module)
            yield from ((source, alias) for alias in node.names)


def test_names_of_stubs_are_loaded_on_first_use() -> None:
    for package in LAZY - {"pepperscene"}:
        assert [ast.unparse(statement) for statement in tree(MODULES[package]).body[1:]] == [
            "import lazy_loader",
            "__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)",
        ]
        for statement in tree(MODULES[package].with_suffix(".pyi")).body:
            assert isinstance(statement, ast.ImportFrom)
            assert statement.level == 1
            assert all(alias.asname == alias.name for alias in statement.names)


def test_init_modules_only_re_export() -> None:
    for package in set(SUB_PACKAGES) - LAZY:
        docstring, *statements = tree(MODULES[package]).body
        assert isinstance(docstring, ast.Expr)
        assert isinstance(docstring.value, ast.Constant)
        for statement in statements:
            is_all = isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__"
            assert is_all or isinstance(statement, ast.ImportFrom), f"{package}: {ast.unparse(statement)}"


def test_public_class_names_are_unique() -> None:
    names = Counter(
        node.name
        for module in MODULES
        for node in tree(MODULES[module]).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_modules_are_short() -> None:
    lines = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}


def _imported_modules(module: str, exported: dict[tuple[str, str], tuple[str, str]]) -> Iterator[str]:
    """Modules that a module imports from, anywhere in the file; re-exports count as the defining module."""
    for node in nodes(MODULES[module]):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("pepperscene"):
            continue
        for alias in node.names:
            source, name = str(node.module), alias.name
            while (source, name) in exported:
                source, name = exported[source, name]
            target = f"{source}.{name}" if f"{source}.{name}" in MODULES else source
            if target != module:
                yield target


def _sub_package(module: str) -> str:
    """The sub-package of a module; the module itself if it is at the root of its package."""
    name = ".".join(module.split(".")[:3])
    return name if name in SUB_PACKAGES else module


@pytest.mark.parametrize("unit", [str, _sub_package], ids=["modules", "sub-packages"])
def test_no_imports_are_circular(unit: Callable[[str], str]) -> None:
    # Imports inside functions and under TYPE_CHECKING count as well.
    exported = {
        (package, alias.asname or alias.name): (source, alias.name)
        for package in SUB_PACKAGES
        for source, alias in _re_exports(package)
    }
    graph: dict[str, set[str]] = {}
    for module in (name for name in MODULES if name not in SUB_PACKAGES and name != "pepperscene"):
        imported = {unit(target) for target in _imported_modules(module, exported)}
        graph.setdefault(unit(module), set()).update(imported - {unit(module)})
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_processes_import_only_what_they_need() -> None:
    """The package alone no heavy library, and workers no package that they do not need."""
    others = ("export", "review", "building.execution", "dataset.readers")
    code = (
        f"import sys, pepperscene; print(sorted({HEAVY!r} & set(sys.modules))); "
        "from pepperscene.building.scenes import plants; "
        f"print([name for name in {others!r} if f'pepperscene.{{name}}' in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == ["[]", "[]", ""]
