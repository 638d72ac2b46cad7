"""Normals of triangles, and of the smooth surfaces that they stand for."""

from __future__ import annotations

from typing import Any, Final

from pepperscene.render.variant import mitsuba_modules

_MIN_SQUARE: Final = 1e-20
"""Chosen: below the square of any length here that single precision distinguishes from 0."""


def shading_normals(si: Any) -> Any:
    """Turn shading normals as far as needed for the viewer to see the front of both surfaces.

    Returns interactions in which the viewer is on the same side of the shading normal as of the triangle,
    with `wi` in the new frames.

    Args:
        si: surface interactions; `n` and `sh_frame.n` point out of the same side of the mesh.
    """
    mi, dr = mitsuba_modules()
    view = si.to_world(si.wi)
    # Seen from behind, both normals are reversed, which leaves c unchanged.
    b = dr.dot(si.n, view)
    a = dr.mulsign(dr.dot(si.sh_frame.n, view), b)
    b = dr.abs(b)
    c = dr.dot(si.sh_frame.n, si.n)
    length = dr.sqrt(dr.maximum(a * a + b * b - 2.0 * a * b * c, _MIN_SQUARE))
    normal = b * si.sh_frame.n + (length - a) * si.n
    # A shading normal opposite to the triangle's leaves no direction between the two.
    square = dr.squared_norm(normal)
    valid = square > _MIN_SQUARE
    normal = dr.select(valid, normal * dr.rsqrt(dr.select(valid, square, 1.0)), si.n)

    # Where no turn is needed the frame keeps its exact bits.
    needed = (a <= 0.0) | (2.0 * a * c < b)
    result = mi.SurfaceInteraction3f(si)
    result.sh_frame = dr.select(needed, mi.Frame3f(mi.Normal3f(normal)), si.sh_frame)
    result.wi = dr.select(needed, result.to_local(view), si.wi)
    return result


_LEAST_COSINE: Final = 0.88
"""Chosen: up to this angle, 28 degrees, light of fine bands adds up to that of a broad one within .1 %."""


def lost_fraction(frame: Any, triangle: Any) -> Any:
    """l: the fraction of a matt body's light below the smooth surface or its triangle; see `scattering`.

    At outlines, where normals can differ by more than 28 degrees, the fraction is that at 28 degrees: beyond,
    the mean of a channel does not follow from the mean and the variance of its reflectance.
    """
    _, dr = mitsuba_modules()
    return 0.5 - 0.5 * dr.clip(dr.dot(frame.n, triangle), _LEAST_COSINE, frame.n.z)
