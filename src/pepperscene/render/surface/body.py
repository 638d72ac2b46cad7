"""Places on surfaces: what a hit needs of the tables of `Optics`, whatever the wavelength.

Light at any number of wavelengths or in any number of bands is scattered by the same lobes at such a place:
only the reflectance and the transmittance of the body differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pepperscene.render.surface.microfacets import GlossLobes
from pepperscene.render.surface.scattering import SideOpenness


@dataclass(frozen=True, eq=False)
class BodyPlace:
    """Where the spectra of a body are found, and what changes them.

    Attributes:
        row, next_row, fraction: row of the pigment state below, number of rows to the one above (0 or 1), and
            the fraction of the way there.
        residue: reflectance of residue.
        cover, cover_behind: fractions of the front and of the back that residue covers.
        in_front: whether the viewer is on the front.
        leaving: fraction of the transmitted light that the other side lets out.
        lost: fraction of the body's light that a relief sends below the horizon; None without relief.
        is_scanned: whether a scan gives the colour; None if no organ has any.
        colour: linear sRGB of the scan.
    """

    row: Any
    next_row: Any
    fraction: Any
    residue: Any
    cover: Any
    cover_behind: Any
    in_front: Any
    leaving: Any
    lost: Any | None = None
    is_scanned: Any | None = None
    colour: Any | None = None


@dataclass(frozen=True, eq=False)
class SurfacePlace:
    """A place on a surface, seen from the viewer's side; see `SurfacePoint`, which adds the spectra.

    Attributes:
        body: of the sheet.
        frame, wi, gloss, near, far: as of `SurfacePoint`.
    """

    body: BodyPlace
    frame: Any
    wi: Any
    gloss: GlossLobes
    near: SideOpenness
    far: SideOpenness
