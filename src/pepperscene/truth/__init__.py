"""Ground truth: encodings of labels, amodal masks, harvest truth, and statistics of labelled images."""

from pepperscene.truth.encodings import (
    class_colour,
    class_from_colour,
    class_pixel_counts,
    decode_rle,
    distance_code,
    distance_from_code,
    encode_rle,
)
from pepperscene.truth.statistics import (
    CENTRE_AREA,
    HUE_BINS,
    ImageStatistics,
    centre_crop,
    centre_falloff,
    centre_side,
    grey_values,
    hue_spectrum_correlation,
    mean_hue,
    saturated_fraction,
)

__all__ = [
    "CENTRE_AREA",
    "HUE_BINS",
    "ImageStatistics",
    "centre_crop",
    "centre_falloff",
    "centre_side",
    "class_colour",
    "class_from_colour",
    "class_pixel_counts",
    "decode_rle",
    "distance_code",
    "distance_from_code",
    "encode_rle",
    "grey_values",
    "hue_spectrum_correlation",
    "mean_hue",
    "saturated_fraction",
]
