"""Changes of valid files, and attempts to read them: only errors of this package may come out."""

from __future__ import annotations

import contextlib
import signal
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.errors import PepperError

EXAMPLES = pytest.mark.parametrize(
    "examples", [pytest.param(15, id="few"), pytest.param(3_000, id="many", marks=pytest.mark.long)]
)
"""Of every test: the first runs always, the second in the long set."""

TIME_LIMIT_S = 20
"""For one attempt; chosen: a hundred times what any takes on a busy machine."""

NUMBERS = (
    b"0", b"-0.0", b"-1", b"1e308", b"1e-308", b"1e999", b"nan", b"inf", b"-inf", b"9223372036854775808",
    b"18446744073709551615", b"1" + 400 * b"0", b"0.5", b"2", b"100000", b"true", b'"7"', b"[]", b"{}",
)  # fmt: skip
BYTES = (
    b"\x00", b"\xff", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\n", b"\r", b"\r\n", b",", b'"', b"'",
    b"[", b"]", b"[[", b"{", b"}", b"=", b".", b"#", b"\\", b"\\ud800", b"\xff\xff\xff\xff", 300 * b"[",
    b"../", b"/dev/null", b"\xe2\x80\xa8", b"\x7f",
)  # fmt: skip
KINDS = ("flip", "cut", "delete", "insert", "repeat", "swap", "number", "number", "line", "byte")

POSITION = st.integers(0, 2**20)
CHOICES = (st.sampled_from(BYTES), st.sampled_from(NUMBERS), st.integers(0, 7))
EDITS = st.lists(st.tuples(st.sampled_from(KINDS), POSITION, POSITION, *CHOICES), min_size=1, max_size=4)


def mutated(content, edits):
    """The content after the edits, in their order."""
    for edit in edits:
        content = _edited(content, *edit)
    return content


def _edited(content, kind, first, second, inserted, number, bit):
    at = first % (len(content) + 1)
    end = min(at + second % 50 + 1, len(content))
    if kind == "flip" and at < len(content):
        return content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
    if kind == "byte" and at < len(content):
        return content[:at] + bytes([second % 256]) + content[at + 1 :]
    if kind == "cut":
        return content[:at]
    if kind == "delete":
        return content[:at] + content[end:]
    if kind == "insert":
        return content[:at] + inserted + content[at:]
    if kind == "repeat":
        return content[:end] + content[at:]
    if kind == "swap":
        other = second % (len(content) + 1)
        low, high = sorted((at, other))
        width = min(16, high - low)
        first, second = (slice(start, start + width) for start in (low, high))
        middle = content[low + width : high]
        return content[:low] + content[second] + middle + content[first] + content[high + width :]
    if kind == "number":
        return _with_number(content, first, number)
    if kind == "line":
        lines = content.splitlines(keepends=True)
        if not lines:
            return content
        row, other = first % len(lines), second % len(lines)
        lines[row] = (lines[other], lines[row] + lines[row], b"")[bit % 3]
        return b"".join(lines)
    return content


def _with_number(content, first, number):
    """The content with another number in place of one that it holds."""
    digits = b"0123456789"
    start = next((i for i in range(first % (len(content) + 1), len(content)) if content[i] in digits), None)
    if start is None:
        return content
    end = start
    while end < len(content) and content[end] in b"0123456789.eE+-_":
        end += 1
    return content[:start] + number + content[end:]


@contextlib.contextmanager
def time_limit():
    """An error if the block takes too long."""

    def stop(*_args):
        raise AssertionError(f"took more than {TIME_LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, TIME_LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def attempt(examples, strategy, read):
    """Call `read` with many values; every error is a sentence of this package.

    Returns:
        The number of values that were read, and the number of those that were refused.
    """
    counts = [0, 0]

    @settings(settings.get_profile("ci"), max_examples=examples)
    @given(strategy)
    def once(value):
        try:
            with time_limit(), warnings.catch_warnings():
                read(value)
        except PepperError as error:
            message = str(error)
            counts[1] += 1
        else:
            message = ""
            counts[0] += 1
        assert "\n" not in message
        assert "Traceback" not in message
        assert message == message.encode("utf-8", "backslashreplace").decode()

    once()
    return tuple(counts)


def attempt_file(examples, path, contents, read):
    """Call `read` with the path of a changed copy of one of the contents."""

    def once(value):
        number, edits = value
        path.write_bytes(mutated(contents[number], edits))
        read(path)

    counts = attempt(examples, st.tuples(st.integers(0, len(contents) - 1), EDITS), once)
    # The valid files can be read, so that errors are those of the changes.
    for content in contents:
        path.write_bytes(content)
        read(path)
    return counts
