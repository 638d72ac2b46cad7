"""What an export can add to what its format needs."""

from __future__ import annotations

from collections.abc import Sequence

from pepperscene.dataset.store import Dataset


def in_all(dataset: Dataset, indices: Sequence[int], outputs: Sequence[str]) -> tuple[str, ...]:
    """Those of some outputs that all frames have."""
    return tuple(
        output for output in outputs if all(dataset.path(index, output).is_file() for index in indices)
    )
