"""Harvest truth against the labels of the same frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

FORMAT = "pepperscene harvest 1"


def harvest_faults(images: Mapping[str, Any], facts: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Kind, output and description of what of a frame's harvest JSON cannot be.

    Args:
        images: the frame's, by output name, those that are there.
        facts: the frame's JSON.
    """
    harvest, instances = images.get("harvest"), images.get("instance")
    if harvest is None:
        return
    if harvest.get("format") != FORMAT or not isinstance(harvest.get("fruit"), list):
        yield "damaged", "harvest", f"is no {FORMAT!r}"
        return
    counts = None if instances is None else np.bincount(instances.ravel())
    for fruit in harvest["fruit"]:
        try:
            yield from (("contradiction", "harvest", what) for what in _fruit_faults(fruit, counts))
        except (KeyError, TypeError, IndexError) as fault:
            yield "damaged", "harvest", f"tells a fruit without its {fault}"
            return


def _fruit_faults(fruit: Mapping[str, Any], counts: Any) -> Iterator[str]:
    number, visible, amodal = fruit["instance"], fruit["visible_pixels"], fruit["amodal_pixels"]
    if counts is not None:
        seen = int(counts[number]) if number < len(counts) else 0
        if seen != visible:
            yield f"fruit {number} has {seen} visible pixels, the JSON says {visible}"
    if not 0 <= visible <= amodal:
        yield f"fruit {number} has {visible} visible pixels of {amodal}"
    # COCO's run lengths: together they are the picture, every second one is the fruit.
    size, runs = fruit["amodal"]["size"], fruit["amodal"]["counts"]
    if sum(runs) != size[0] * size[1] or sum(runs[1::2]) != amodal:
        yield f"the amodal mask of fruit {number} has {sum(runs[1::2])} pixels, the JSON says {amodal}"
