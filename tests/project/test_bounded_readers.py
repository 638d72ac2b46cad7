"""Every file is opened for reading by `pepperscene.user_files`, except for what is listed here."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pepperscene

PACKAGE = Path(pepperscene.__file__).parent
READER = PACKAGE / "user_files.py"
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
    (
        "building/subprocess_rpc.py",
        "pickle.load(self._process.stdout)",
    ): "a pipe between processes of one build",
    ("building/subprocess_rpc.py", "pickle.load(self._requests)"): "a pipe between processes of one build",
    ("cli/datasets.py", "webbrowser.open(page.absolute().as_uri())"): "a page for the browser",
    (
        "learning/models/efficientnet.py",
        "torch.load(file, map_location='cpu', weights_only=True)",
    ): "of an installed package",
    ("notebook_view.py", "Image.open(picture, formats=('PNG',))"): "opened by the caller",
}


def reading_calls(source):
    """The calls in a module that may read a file by its name."""
    tree = ast.parse(source)
    opened = {
        target.id
        for node in ast.walk(tree)
        for value, targets in _bindings(node)
        if BOUNDED.search(ast.unparse(value))
        for target in targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name, text = ast.unparse(node.func), ast.unparse(node)
        is_method = isinstance(node.func, ast.Attribute) and node.func.attr in METHODS
        if not is_method and name not in FUNCTIONS:
            continue
        first = ast.unparse(node.args[0]) if node.args else ""
        if first not in opened and not BOUNDED.search(first) and not WRITING.search(text):
            yield text


def _bindings(node):
    if isinstance(node, ast.Assign):
        yield node.value, node.targets
    elif isinstance(node, ast.AnnAssign) and node.value is not None:
        yield node.value, [node.target]
    elif isinstance(node, ast.withitem):
        yield node.context_expr, [node.optional_vars]


def test_every_file_is_opened_by_the_bounded_reader_or_listed():
    found = {
        (path.relative_to(PACKAGE).as_posix(), call)
        for path in PACKAGE.rglob("*.py")
        if path != READER
        for call in reading_calls(path.read_text(encoding="utf-8"))
    }
    assert found == set(EXCEPTIONS)


def test_calls_that_read_files_by_name_are_found():
    for call in (
        "open(path)", "path.open()", "path.open('rb')", "path.read_text()", "path.read_bytes()",
        "np.load(path)", "Image.open(path)", "OpenEXR.File(str(path))", "parquet.read_table(path)",
        "safe_open(path)", "trimesh.load(path)", "tarfile.open(path)", "shutil.copyfile(path, other)",
    ):  # fmt: skip
        assert list(reading_calls(call)) == [call.replace('"', "'")]
    for call in ("path.open('w')", "with open_file(path, 'image') as f:\n Image.open(f)"):
        assert not list(reading_calls(call))
