"""Functions of the user in tasks: they need a permission, and whatever they raise is one sentence."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from commands import rejected

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.tasks import depth_task, view_task
from pepperscene.user_code import import_callable, user_errors

MODULE = """
open({marker!r}, "a").close()
def leave(*_):
    raise SystemExit(7)
def leave_silently(*_):
    raise SystemExit
def stop(*_):
    raise GeneratorExit
def wrong(*_):
    raise KeyError("two\\nlines")
class Later:
    def __array__(self, dtype=None, copy=None):
        raise SystemExit(7)
def later(*_):
    return Later()
text = "no function"
"""
ENDS = {
    "leave": "failed with SystemExit: 7",
    "leave_silently": "failed with SystemExit",
    "stop": "failed with GeneratorExit",
    "later": "failed with SystemExit: 7",
    "wrong": "failed with KeyError: 'two\\nlines'",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "evil_method.py").write_text(MODULE.format(marker=str(tmp_path / "marker")))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    yield tmp_path
    sys.modules.pop("evil_method", None)


@pytest.mark.parametrize("task", ["depth_completion", "next_best_view"])
def test_a_method_needs_the_permission(folder, task):
    error = rejected("task", task, "demo", "--method", "evil_method:leave")
    assert "--method: the code of evil_method:leave runs only with --allow-code" in error
    assert not (folder / "marker").exists()


@pytest.mark.parametrize("end", ["raise SystemExit(7)", "raise GeneratorExit"])
def test_a_module_that_exits_is_one_sentence(folder, end):
    (folder / "leaving_method.py").write_text(end)
    words = ("task", "depth_completion", "demo", "--method", "leaving_method:fill", "--allow-code")
    assert rejected(*words).startswith("error: --method: leaving_method cannot be imported (")


@pytest.mark.parametrize("name", ENDS)
def test_whatever_a_method_raises_is_one_sentence(folder, name):
    method = import_callable(f"evil_method:{name}", "method", allow_code=True)
    sensor, colour = np.ones((2, 3), np.float32), np.zeros((2, 3, 3), np.uint8)
    calls = [lambda: depth_task._apply("mine", method, colour, sensor, np.ones((2, 3), bool))]
    # A result of `later` ends the program where it is read.
    calls += [lambda: view_task._choose("mine", method, None)] if name != "later" else []
    for call in calls:
        with pytest.raises(InputError) as caught:
            call()
        assert str(caught.value) == f"mine: {ENDS[name]}"
        assert not isinstance(caught.value, ArgumentError)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, InputError("a", "b")])
def test_interrupts_and_a_lack_of_memory_are_passed_on(error):
    with pytest.raises(type(error) if isinstance(error, Exception) else error), user_errors("mine"):
        raise error
