"""The result of a benchmark task: one line of measures for each method, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pepperscene.colour.comparison.tables import UNKNOWN, TextTable

FORMAT: Final = "pepperscene task 1"


@dataclass(frozen=True)
class TaskMeasure:
    """One measure of a task.

    Attributes:
        name: key in the JSON data.
        heading: of its column, with the unit.
        digits: decimals in the table.
        factor: by which the table multiplies it: 100 for per cent.
    """

    name: str
    heading: str
    digits: int = 1
    factor: float = 1.0


@dataclass(frozen=True)
class Score:
    """The measures of one method, of one part of the data if the task has parts.

    Attributes:
        method: name of a baseline, or of what a user submitted.
        part: of the data, such as "holes"; "" for all.
        values: by the name of the measure; nan where it is not defined.
    """

    method: str
    part: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class TaskResult:
    """The scores of methods in a task.

    Attributes:
        task: its name.
        title: what was scored, in one line.
        measures: in the order of the columns.
        scores: in the order of the rows.
        part: heading of the column of parts; "" if the task has none.
        notes: lines below the table.
    """

    task: str
    title: str
    measures: tuple[TaskMeasure, ...]
    scores: tuple[Score, ...]
    part: str = ""
    notes: tuple[str, ...] = ()

    def table(self) -> TextTable:
        """All scores."""
        heads = ("method", *([self.part] if self.part else []), *(one.heading for one in self.measures))
        return TextTable(self.title, heads, tuple(map(self._row, self.scores)), self.notes)

    def to_json(self) -> dict[str, Any]:
        """JSON data: all numbers are finite, and an undefined one is null."""
        return {
            "format": FORMAT,
            "task": self.task,
            "title": self.title,
            "scores": [
                {
                    "method": score.method,
                    **({"part": score.part} if self.part else {}),
                    **{
                        name: float(value) if np.isfinite(value) else None
                        for name, value in score.values.items()
                    },
                }
                for score in self.scores
            ],
            "notes": list(self.notes),
        }

    def score(self, method: str, part: str = "") -> Mapping[str, float]:
        """The measures of a method and part; raises `KeyError` if there are none."""
        for score in self.scores:
            if (score.method, score.part) == (method, part):
                return score.values
        raise KeyError((method, part))

    def _row(self, score: Score) -> tuple[str, ...]:
        cells = [self._cell(one, score.values.get(one.name, np.nan)) for one in self.measures]
        return (score.method, *([score.part] if self.part else []), *cells)

    def _cell(self, measure: TaskMeasure, value: float) -> str:
        if not np.isfinite(value):
            return UNKNOWN
        # Adding zero turns a rounded minus zero into zero.
        return f"{round(measure.factor * value, measure.digits) + 0.0:,.{measure.digits}f}"
