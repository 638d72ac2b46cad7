"""Red, green and blue at every photosite of a Bayer mosaic."""

from __future__ import annotations

import warnings
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.spectra import colour_science

Demosaic = Literal["malvar", "menon", "bilinear"]
Floats = NDArray[np.float32]
_MARGIN = 8  # photosites; even, to keep the pattern, and beyond the reach of the widest of the three


def demosaiced(sites: Floats, pattern: str, method: Demosaic) -> Floats:
    """`(h, w, 3)` colours of a mosaic `(h, w)` with even sides, by the library colour-demosaicing.

    Methods: "malvar", linear filters that follow the other colours' gradients (Malvar, He and Cutler 2004,
    ICASSP); "menon", directional filters with a choice afterwards (Menon, Andriani and Calvagno 2007, IEEE
    Trans. Image Process. 16:132); "bilinear", the mean of the nearest photosites of a colour.

    The mosaic is mirrored about its outermost photosites before, which keeps the pattern; two methods of the
    library mirror about the edge, which mixes colours there.
    """
    bayer = _library()
    method_of = {
        "malvar": bayer.demosaicing_CFA_Bayer_Malvar2004,
        "menon": bayer.demosaicing_CFA_Bayer_Menon2007,
        "bilinear": bayer.demosaicing_CFA_Bayer_bilinear,
    }
    framed = np.pad(sites, _MARGIN, mode="reflect")
    colours = method_of[method](framed, pattern.upper())
    return colours[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].astype(np.float32)


def _library() -> Any:
    """colour-demosaicing, which takes scipy's functions from where they will be until SciPy 2."""
    colour_science()  # the quiet way to what it imports
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Please import `convolve", DeprecationWarning)
        import colour_demosaicing
    return colour_demosaicing
