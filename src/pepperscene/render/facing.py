"""Shading normals that turn no side of a mesh away from who sees it.

Normals interpolated over flat triangles tell of a smooth surface that is not there. Near an outline the
viewer v still sees triangles (geometric normal g, towards v) whose shading normal n looks away or nearly so:
such a surface seems to be seen from within, or mirrors into itself, and a dark line follows every outline.
There n is turned towards g by the least k for which its mirror direction leaves the surface (the condition of
Keller et al. 2017, "The Iray light transport simulation and rendering system", section 4):

    n' = (n + k g) / |n + k g|,      2 (n' . v) (n' . g) >= g . v

The smallest root of that quadratic is k = (|a g - b n| - a) / b, with a = n . v, b = g . v, c = n . g; it is
positive where 2 a c < b or a < 0. So n' . v > 0 as well, no normal turns farther than to g, and where
triangles are flat (n = g) nothing changes.
"""

from __future__ import annotations

from typing import Any, Final

from pepperscene.render.variant import kernel

_LEAST_SQUARE: Final = 1e-20
"""Chosen: below the square of any length here that single precision tells from 0."""


def facing(si: Any) -> Any:
    """The interactions with shading normals turned as far as needed, and `wi` in the new frames.

    The viewer is then on the same side of the shading normal as of the triangle.

    Args:
        si: surface interactions; `n` and `sh_frame.n` point out of the same side of the mesh.
    """
    mi, dr = kernel()
    towards = si.to_world(si.wi)
    # Seen from behind, g and n are both the other way round, which leaves c as it is.
    b = dr.dot(si.n, towards)
    a = dr.mulsign(dr.dot(si.sh_frame.n, towards), b)
    b = dr.abs(b)
    c = dr.dot(si.sh_frame.n, si.n)
    length = dr.sqrt(dr.maximum(a * a + b * b - 2.0 * a * b * c, _LEAST_SQUARE))
    turned = b * si.sh_frame.n + (length - a) * si.n
    # A normal right against its triangle's leaves nothing in between.
    square = dr.squared_norm(turned)
    some = square > _LEAST_SQUARE
    turned = dr.select(some, turned * dr.rsqrt(dr.select(some, square, 1.0)), si.n)

    # Where nothing needs turning the frame stays as it is, to the last bit.
    needed = (a <= 0.0) | (2.0 * a * c < b)
    found = mi.SurfaceInteraction3f(si)
    found.sh_frame = dr.select(needed, mi.Frame3f(mi.Normal3f(turned)), si.sh_frame)
    found.wi = dr.select(needed, found.to_local(towards), si.wi)
    return found
