"""One of the sets that a page shows: what was measured of it, and its pictures as they stand in the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.report.records import Records
from pepperscene.truth import Statistics


@dataclass(frozen=True, eq=False)
class Side:
    """One of the sets that a page shows.

    Attributes:
        key: "a" for the data set, "b" for the one beside it; tells its colour.
        name: of the set.
        frames: how many it has.
        statistics: measures of those that were looked at.
        records: what its own tables say of all frames; None where it has none.
        cards: the pictures shown, as HTML.
        lines: the same pictures as rows of a table, as HTML.
    """

    key: str
    name: str
    frames: int
    statistics: Statistics
    records: Records | None
    cards: tuple[str, ...]
    lines: tuple[str, ...]

    def shares(self) -> NDArray[np.float64]:
        """Share of each class `(8,)`: of all frames where its tables tell, else of those measured."""
        known = None if self.records is None else self.records.shares()
        return self.statistics.shares() if known is None else known

    def unlabelled(self) -> float:
        """Share of pixels of the label images that have no label."""
        void = self.statistics.unlabelled
        return void / max(1, void + int(self.statistics.pixels.sum()))

    def counted(self) -> int:
        """Of how many frames the shares are."""
        if self.records is None or self.records.shares() is None:
            return self.statistics.labelled
        return int(np.isfinite(self.records.pixels).all(axis=1).sum())
