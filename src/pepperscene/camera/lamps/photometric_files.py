"""Photometric files of luminaires: IES LM-63 and EULUMDAT.

Both are lists of numbers: angles, and candela in planes about the axis. No library on PyPI reads them safely:
of those that are maintained, photompy 0.3 reads neither EULUMDAT files that have planes left out by their
symmetry, nor IES files in other encodings than UTF-8.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.lamps.beam import Beam
from pepperscene.errors import InputError
from pepperscene.user_files import read_file

Array = NDArray[np.float64]

ENDINGS: Final = (".ies", ".ldt")
_MOST_VALUES: Final = 200_000  # candela values; chosen: files of goniophotometers have up to 73 x 361
_HEADER: Final = 13  # numbers of an IES file before the angles
_STEP: Final = 1e-6  # degrees, of a step from dark to light; chosen: far below those of goniophotometers
_NUMBER: Final = re.compile(r"[\s,]+")
# Lines of a EULUMDAT file, from 0.
_SYMMETRY, _PLANES, _ANGLES, _FACTOR, _LAMP_SETS = 2, 3, 5, 23, 25
_LINES_PER_SET, _RATIOS = 6, 10


def read_beam(path: Path) -> Beam:
    """Read the beam of a photometric file, in candela of the whole luminaire.

    Raises:
        InputError: the file is missing, incomplete or not valid.
    """
    text = read_file(path, "spectra").decode("latin-1")
    try:
        planes, angles, values = (_read_ldt if path.suffix.lower() == ".ldt" else _read_ies)(text)
        return Beam(*_full_turn(planes, angles, values))
    except _FormatError as error:
        raise InputError(path, str(error)) from None
    except ValueError as error:
        raise InputError(path, f"is not a photometric file of a lamp: {error}") from None


class _FormatError(Exception):
    """What is wrong with a file."""


def _read_ies(text: str) -> tuple[Array, Array, Array]:
    """Planes and angles in degrees and candela of an IES file (ANSI/IES LM-63-19), of type C."""
    found = re.search(r"^TILT[ \t]*=[ \t]*(\S+)[^\n]*$", text, re.MULTILINE)
    if found is None:
        raise _FormatError("is not an IES LM-63 file: it has no line that begins with TILT=")
    if found[1].upper() != "NONE":
        raise _FormatError(f"must have TILT=NONE, not TILT={found[1][:40]}")
    numbers = _numbers(text[found.end() :].replace("\x1a", " "))
    if len(numbers) < _HEADER:
        problem = f"it has {len(numbers)} numbers after TILT, at least 13 are needed"
        raise _FormatError(f"ends too early: {problem}")
    if numbers[5] != 1:
        raise _FormatError(f"must have photometry of type C (1), not {numbers[5]:g}")
    count, planes = (_count(number, "angles and planes") for number in numbers[3:5])
    # The candela multiplier and the ballast's factor.
    factor = numbers[2] * numbers[10]
    values = numbers[_HEADER:]
    needed = count + planes + count * planes
    if len(values) < needed:
        raise _FormatError(f"ends too early: it has {len(values)} of {needed} angles and candela values")
    angle, plane, candela = np.split(np.array(values[:needed]), [count, count + planes])
    return plane, angle, factor * candela.reshape(planes, count)


def _read_ldt(text: str) -> tuple[Array, Array, Array]:
    """Planes and angles in degrees and candela of a EULUMDAT file (Stockmar 1990)."""
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace(",", ".")
    lines = [line.strip() for line in text.split("\n")]
    if len(lines) <= _LAMP_SETS:
        raise _FormatError(f"ends too early: it has {len(lines)} lines, a EULUMDAT file has more than 26")
    symmetry, planes, count, sets = (
        _count(_number(lines[row], row), "planes, angles, symmetry and lamps", least)
        for row, least in ((_SYMMETRY, 0), (_PLANES, 1), (_ANGLES, 1), (_LAMP_SETS, 1))
    )
    if symmetry > 4:
        raise _FormatError(f"must have a symmetry of 0 to 4 in line 3, not {symmetry}")
    after = _LAMP_SETS + 1 + _LINES_PER_SET * sets + _RATIOS
    first = planes // 4 * 3 + 1 if symmetry == 3 else 1
    last = {0: planes, 1: 1, 2: planes // 2 + 1, 3: first + planes // 2, 4: planes // 4 + 1}[symmetry]
    shown = last - first + 1
    needed = planes + count + shown * count
    rows = [line for line in lines[after:] if line]
    if len(rows) < needed:
        raise _FormatError(f"ends too early: it has {max(len(rows), 0)} of {needed} angles and intensities")
    numbers = np.array([_number(line, after + row) for row, line in enumerate(rows[:needed])])
    plane, angle, per_kilolumen = np.split(numbers, [planes, planes + count])
    lumens = sum(abs(_number(lines[_LAMP_SETS + 3 + _LINES_PER_SET * k], 0)) for k in range(sets))
    factor = _number(lines[_FACTOR], _FACTOR) or 1.0
    candela = per_kilolumen.reshape(shown, count) * (lumens / 1000.0 * factor)
    if symmetry == 1:
        return np.zeros(1), angle, candela
    # Planes that begin at 270 degrees go on beyond a full turn.
    return plane[np.arange(first - 1, last) % planes], angle, candela


def _full_turn(planes: Array, angles: Array, candela: Array) -> tuple[Array, Array, Array]:
    """The table over a full turn, in radians, from one over a quarter, a half, a full turn or one plane."""
    if angles[0] == 90.0:  # of an uplight, whose file leaves out the dark half
        angles, candela = np.append([0.0, 90.0 - _STEP], angles), np.pad(candela, ((0, 0), (2, 0)))
    if angles[0] != 0:
        raise _FormatError(f"must have angles from 0 (the axis) or 90 degrees on, not from {angles[0]:g}")
    if planes.size == 1:
        return np.zeros(1), np.radians(angles), candela
    # A half turn may begin at 90 or 270 degrees; it is mirrored like one from 0, and then turned back.
    start = float(planes[0])
    if start in (90.0, 270.0):
        planes = (planes - start) % 360.0
    if planes[0] != 0 or np.any(np.diff(planes) <= 0) or planes[-1] > 360.0:
        raise _FormatError("must have planes that increase from 0 degrees to at most 360")
    for half in (90.0, 180.0):
        if planes[-1] == half:  # mirrored at its last plane
            planes = np.append(planes, 2.0 * half - planes[-2::-1])
            candela = np.concatenate([candela, candela[-2::-1]])
    if planes[-1] == 360.0:
        planes, candela = planes[:-1], candela[:-1]
    planes = (planes + start) % 360.0
    order = np.argsort(planes)
    planes, candela = np.append(planes[order], 360.0 + planes[order[0]]), candela[[*order, order[0]]]
    if planes[0] != 0:
        raise _FormatError("must have a plane at 0 degrees")
    return np.radians(planes), np.radians(angles), candela


def _numbers(text: str) -> list[float]:
    words = [word for word in _NUMBER.split(text) if word]
    if len(words) > 2 * _MOST_VALUES:
        raise _FormatError(f"has more than {2 * _MOST_VALUES} numbers")
    return [_number(word) for word in words]


def _number(word: str, row: int | None = None) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        where = "" if row is None else f" in line {row + 1}"
        raise _FormatError(f"must have a finite number{where} instead of {word[:40]!r}")
    return value


def _count(value: float, what: str, least: int = 1) -> int:
    if not (value == int(value) and least <= value <= _MOST_VALUES):
        raise _FormatError(f"must have whole numbers of {what}, at least {least}, not {value:g}")
    return int(value)
