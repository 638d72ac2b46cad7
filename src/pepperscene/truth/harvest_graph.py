"""How fruit hangs on the plant: every organ from each fruit down to the main stem, in view or not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance


def organ_graph(
    lines: Iterable[Sequence[int]], instances: Sequence[Instance], pixels: NDArray[np.integer[Any]]
) -> dict[str, list[Any]]:
    """Nodes and edges as JSON tells them; an edge goes from what grows to what it grows on.

    Args:
        lines: for each fruit its index, that of what it grows on, and so on down to the main stem's organ.
        instances: of the scene.
        pixels: how many each value of the instance image has.
    """
    told = list(lines)
    nodes = sorted({index for line in told for index in line})
    edges = sorted({(child, parent) for line in told for child, parent in pairwise(line)})
    return {
        "nodes": [
            {
                "instance": index + 1,
                "kind": instances[index].kind,
                "class": int(instances[index].organ_class),
                "plant": instances[index].plant,
                "phytomer": instances[index].phytomer,
                "pixels": int(pixels[index + 1]) if index + 1 < len(pixels) else 0,
            }
            for index in nodes
        ],
        "edges": [[child + 1, parent + 1] for child, parent in edges],
    }
