"""Ground truth as arrays: the published data set's encodings, their inverses, and counts."""

from pepperscene.truth.counts import class_pixels
from pepperscene.truth.encodings import (
    FARTHEST_CODED_M,
    class_colour,
    class_from_colour,
    distance_code,
    distance_from_code,
)

__all__ = [
    "FARTHEST_CODED_M",
    "class_colour",
    "class_from_colour",
    "class_pixels",
    "distance_code",
    "distance_from_code",
]
