"""How all plant organs scatter light: a diffuse, possibly translucent body under a rough dielectric cuticle.

A side s of a sheet mirrors by a single-scattering GGX lobe with separable Smith masking (Walter et al. 2007)

    f_g(i, o) = D(h) F(i . h) G1(i) G1(o) / (4 cos_i cos_o),          E_s(i) its directional albedo,

and whatever that lobe does not send out (refracted, masked, or sent below the horizon) reaches the body. With
the openness A_s = 1 - E_s, its cosine-weighted mean a_s = <A_s>, and the body's reflectances R_s and
transmittance T (shares of the light that reaches it),

    f_r(i, o) = f_g(i, o) + A_s(i) A_s(o) / a_s    R'_s / pi,       R'_s = R_s + T - T'_s
    f_t(i, o) =             A_s(i) A_o(o) / a_o    T'_s / pi,       T'_s = T min(a_s, a_o) / a_s

where the index o of A_o and a_o is the other side. That is the coupling of Kelemen & Szirmay-Kalos 2001
(after Ashikhmin & Shirley 2000), carried through a sheet. Why it is right:

- Reciprocity: f_r is symmetric as written; f_t = A_s(i) A_o(o) T min(a_s, a_o) / (pi a_s a_o) is the same
  from either side.
- Energy: the cosine-weighted means of A_s / a_s and A_o / a_o are 1, so the body sends out
  A_s(i) (R'_s + T'_s). What the less open side cannot let out of the light that came in through the more
  open one is thrown back there, and R'_s + T'_s = R_s + T on both. So side s sends out
  E_s(i) + A_s(i) (R_s + T): never more than 1, and 1 if and only if R_s + T = 1.

E_s is tabulated per surface and side (`pepperscene.materials.gloss`) and a_s is the mean of the very
interpolant, so that the body's part is exact; the gloss' part errs by the interpolation, below 4e-4.

A relief turns the shading frame only (Blinn 1978). Directions that are on different sides of it and of the
smooth surface are lost: for a matt body on a slope of angle t a share (1 - cos t) / 2, which on the plant is
0.2 % for leaves, 0.1 % for stems and petioles, and 1.3 % for the calyx. It is left at that: such light meets
the surface again, which absorbs most of it in the visible, and to mirror all of it back would be as wrong.

All surfaces of a scene share these tables and this code, so that the kernel needs no indirect calls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pepperscene.materials.gloss import NODE_SCALE, NODES
from pepperscene.render.kernel.arrays import device_number, device_table
from pepperscene.render.surface.tables import STEP_NM, SurfaceTables
from pepperscene.render.variant import mitsuba_modules

_LEAST_SQUARE: Final = 1e-20
"""Chosen: below the square of any length here that single precision tells from 0."""


def shading_normals(si: Any) -> Any:
    """The interactions with shading normals turned as far as needed, and `wi` in the new frames.

    The viewer is then on the same side of the shading normal as of the triangle.

    Args:
        si: surface interactions; `n` and `sh_frame.n` point out of the same side of the mesh.
    """
    mi, dr = mitsuba_modules()
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


_NODES_PER_LOG: Final = (NODES - 1) / math.log1p(1.0 / NODE_SCALE)
_LEAST_COSINE: Final = 1e-5
"""Nothing is scattered to or from beyond: chosen, for single precision has no angles left there, and only
1e-10 of a diffuse lobe lies there."""


class Optics:
    """The surface tables of a scene on the device."""

    def __init__(self, tables: SurfaceTables) -> None:
        # Literals would be compiled into the kernel, and every new scene would compile anew.
        self.first_nm = device_number(tables.first_nm)
        self.columns = device_number(tables.columns, whole=True)
        self.spectra = device_table(tables.spectra)
        self.first_row = device_table(tables.first_row, np.uint32)
        self.last_state = device_table(tables.last_state)
        self.sides = device_table(tables.sides)
        self.openness = device_table(tables.openness)
        self.details = device_table(tables.details)
        self.first_texel = device_table(tables.first_texel, np.uint32)
        self.width = device_table(tables.width, np.uint32)
        self.height = device_table(tables.height, np.uint32)

    def at(self, si: Any, surface: Any, state: Any, active: Any) -> SurfacePoint:
        """The optical state at surface interactions.

        Args:
            si: interactions, with shading frame, uv and its partials.
            surface: number of the surface.
            state: pigment state in [0, 1], before the pattern.
            active: mask.
        """
        mi, dr = mitsuba_modules()
        offset, slope_u, slope_v = self._detail(si.uv, surface, active)
        front, back, through = self._body(si.wavelengths, surface, dr.clip(state + offset, 0.0, 1.0), active)
        frame = _relief_frame(si, slope_u, slope_v)
        wi = frame.to_local(si.wi)
        # The relief may not turn a side of the sheet away from a viewer who sees it.
        keep = wi.z * si.wi.z > 0.0
        frame = dr.select(keep, frame, mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0)))
        wi = dr.select(keep, wi, si.wi)
        facing = wi.z > 0.0
        wi.z = dr.abs(wi.z)
        # The cuticle on the viewer's side, and where the tables of both sides begin.
        side = surface * 2 + dr.select(facing, mi.UInt32(0), mi.UInt32(1))
        cuticle = dr.gather(mi.Vector4f, self.sides, side, active)
        table = dr.select(active, side * NODES, 0)
        beyond = dr.select(active, (side ^ 1) * NODES, 0)
        openness = _interpolated(self.openness, table, wi.z)
        leaving = through * cuticle.w
        return SurfacePoint(
            frame=frame,
            wi=wi,
            flip=dr.select(facing, mi.Float(1.0), mi.Float(-1.0)),
            reflectance=dr.select(facing, front, back) + (through - leaving),
            transmittance=leaving,
            ior=cuticle.y,
            gloss=mi.MicrofacetDistribution(mi.MicrofacetType.GGX, cuticle.x, True),
            entering=openness * cuticle.z,
            tables=self.openness,
            table=table,
            beyond=beyond,
        )

    def _detail(self, uv: Any, surface: Any, active: Any) -> Any:
        """State offset, and the relief's slopes over u and v in metres, bilinear in the texels."""
        mi, dr = mitsuba_modules()
        width = dr.gather(mi.UInt32, self.width, surface, active)
        height = dr.gather(mi.UInt32, self.height, surface, active)
        first = dr.gather(mi.UInt32, self.first_texel, surface, active)
        x = uv.x * mi.Float(width) - 0.5
        y = uv.y * mi.Float(height) - 0.5
        left, top = dr.floor(x), dr.floor(y)
        fx, fy = x - left, y - top

        def texel(dx: int, dy: int) -> Any:
            # Tubes and fruit close on themselves in u; on a leaf that concerns half a texel at the margin.
            place = left + dx
            place = dr.select(place < 0.0, place + mi.Float(width), place)
            column = mi.UInt32(dr.select(place < mi.Float(width), place, place - mi.Float(width)))
            row = mi.UInt32(dr.clip(top + dy, 0.0, mi.Float(height) - 1.0))
            return dr.gather(mi.Point2f, self.details, first + row * width + column, active)

        a, b, c, d = texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)
        offset = dr.lerp(dr.lerp(a.x, b.x, fx), dr.lerp(c.x, d.x, fx), fy)
        slope_u = dr.lerp(b.y - a.y, d.y - c.y, fy) * mi.Float(width)
        slope_v = dr.lerp(c.y - a.y, d.y - b.y, fx) * mi.Float(height)
        return offset, slope_u, slope_v

    def _body(self, wavelengths: Any, surface: Any, state: Any, active: Any) -> Any:
        """Front and back reflectance and transmittance at each of the ray's wavelengths."""
        mi, dr = mitsuba_modules()
        last_state = dr.gather(mi.Float, self.last_state, surface, active)
        place = state * last_state
        low = dr.floor(place)
        row = dr.gather(mi.UInt32, self.first_row, surface, active) + mi.UInt32(low)
        next_row = mi.UInt32(dr.minimum(low + 1.0, last_state) - low) * self.columns
        front, back, through = mi.Spectrum(0.0), mi.Spectrum(0.0), mi.Spectrum(0.0)
        last_column = mi.Float(self.columns) - 1.0
        for k in range(len(wavelengths)):
            column = mi.UInt32(dr.clip((wavelengths[k] - self.first_nm) / STEP_NM + 0.5, 0.0, last_column))
            here = row * self.columns + column
            a = dr.gather(mi.Vector4f, self.spectra, here, active)
            b = dr.gather(mi.Vector4f, self.spectra, here + next_row, active)
            front[k] = dr.lerp(a.x, b.x, place - low)
            back[k] = dr.lerp(a.y, b.y, place - low)
            through[k] = dr.lerp(a.z, b.z, place - low)
        return front, back, through


@dataclass(frozen=True, eq=False)
class SurfacePoint:
    """The optical state at a hit, seen from the side that the viewer is on.

    Attributes:
        frame: the relief's shading frame within the smooth one.
        wi: direction to the viewer in the relief's frame, above it.
        flip: -1 where the viewer is on the back side.
        reflectance, transmittance: what the body sends out on the viewer's side and on the other (R' and T'),
            by wavelength.
        ior: of the cuticle on the viewer's side.
        gloss: its GGX distribution.
        entering: 1 - E, the share of light along `wi` that reaches the body.
        tables: openness of all cuticles over its mean.
        table, beyond: where those of the viewer's side and of the other begin.
    """

    frame: Any
    wi: Any
    flip: Any
    reflectance: Any
    transmittance: Any
    ior: Any
    gloss: Any
    entering: Any
    tables: Any
    table: Any
    beyond: Any

    def eval_pdf(self, wo: Any) -> Any:
        """BSDF times cosine, and sampling density, for a direction in the smooth local frame."""
        mi, _ = mitsuba_modules()
        turned = self.frame.to_local(wo)
        local = mi.Vector3f(turned.x, turned.y, turned.z * self.flip)
        return self._eval_pdf(local, wo.z * turned.z > 0.0)

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """A direction in the smooth local frame, its density and its weight (value over density).

        Also returns the number of the lobe: 0 gloss, 1 diffuse reflection, 2 diffuse transmission.
        """
        mi, dr = mitsuba_modules()
        gloss, through = self._shares()
        mirror = sample1 < gloss
        rest = (sample1 - gloss) / dr.maximum(1.0 - gloss, 1e-6)
        normal, _ = self.gloss.sample(self.wi, sample2)
        mirrored = 2.0 * dr.dot(self.wi, normal) * mi.Vector3f(normal) - self.wi
        scattered = mi.warp.square_to_cosine_hemisphere(sample2)
        scattered.z = dr.select(rest < through, -scattered.z, scattered.z)
        local = dr.select(mirror, mirrored, scattered)
        wo = self.frame.to_world(mi.Vector3f(local.x, local.y, local.z * self.flip))
        # A mirrored direction can end up below; a relief's can end up on the smooth surface's other side.
        good = (~mirror | (local.z > 0.0)) & (wo.z * local.z * self.flip > 0.0)
        value, density = self._eval_pdf(local, good)
        lobe = dr.select(mirror, mi.UInt32(0), dr.select(rest < through, mi.UInt32(2), mi.UInt32(1)))
        return wo, density, value / dr.maximum(density, 1e-20), lobe

    def albedo(self) -> Any:
        """Body reflectance and transmittance together."""
        return self.reflectance + self.transmittance

    def _shares(self) -> Any:
        """Probabilities of the gloss and, of what remains, of diffuse transmission.

        Lobes are chosen by their albedos, the root mean square over the ray's wavelengths: for lobes that do
        not overlap that makes the variance of the weights, summed over the wavelengths, least.
        """
        _, dr = mitsuba_modules()
        specular = dr.maximum(1.0 - self.entering, 0.0)
        # `dr.mean` would write the number of rays into the code, which would be compiled for each anew.
        share = 1.0 / len(self.reflectance)
        reflected = dr.sqrt(dr.sum(dr.square(self.reflectance)) * share)
        transmitted = dr.sqrt(dr.sum(dr.square(self.transmittance)) * share)
        body = self.entering * (reflected + transmitted)
        gloss = dr.select(specular > 0.0, specular / (specular + body), 0.0)
        through = dr.select(transmitted > 0.0, transmitted / (reflected + transmitted), 0.0)
        return gloss, through

    def _eval_pdf(self, wo: Any, active: Any) -> Any:
        """Value times cosine, and density, for `wo` in the relief's frame with the viewer above."""
        mi, dr = mitsuba_modules()
        cos_i, cos_o = self.wi.z, dr.abs(wo.z)
        same = wo.z > 0.0
        lambert = cos_o * dr.inv_pi
        leaving = _interpolated(self.tables, dr.select(same, self.table, self.beyond), cos_o)
        diffuse = self.entering * leaving * lambert
        # Gloss: density of the mirrored visible normals; their share of the light is F(i . h) G1(o).
        half = dr.normalize(self.wi + wo)
        visible = self.gloss.eval(half) * self.gloss.smith_g1(self.wi, half) / (4.0 * cos_i)
        fresnel = mi.fresnel(dr.maximum(dr.dot(self.wi, half), 0.0), self.ior)[0]
        mirror = visible * fresnel * self.gloss.smith_g1(wo, half)
        value = dr.select(same, diffuse * self.reflectance + mirror, diffuse * self.transmittance)

        gloss, through = self._shares()
        lambert *= 1.0 - gloss
        density = dr.select(same, lambert * (1.0 - through) + gloss * visible, lambert * through)
        usable = active & (cos_i > _LEAST_COSINE) & (cos_o > _LEAST_COSINE)
        return value & usable, dr.select(usable, density, 0.0)


def _interpolated(tables: Any, first: Any, cosine: Any) -> Any:
    """The table that begins at entry `first`, at cosines, linear in the nodes' variable."""
    mi, dr = mitsuba_modules()
    place = dr.log(dr.fma(cosine, 1.0 / NODE_SCALE, 1.0)) * _NODES_PER_LOG
    # So written, the NaN of a lane that has ended reads entry 0, and not beyond all memory.
    place = dr.select(place > 0.0, dr.minimum(place, NODES - 1.0), 0.0)
    node = dr.floor(place)
    entry = dr.gather(mi.Point2f, tables, first + mi.UInt32(node))
    return dr.fma(entry.y, place - node, entry.x)


def _relief_frame(si: Any, slope_u: Any, slope_v: Any) -> Any:
    """The shading frame on the relief, in local coordinates of the smooth one (Blinn 1978)."""
    mi, dr = mitsuba_modules()
    along_u = si.to_local(si.dp_du)
    along_v = si.to_local(si.dp_dv)
    # Gradient g of the height in the tangent plane: g . dp_du = slope_u, g . dp_dv = slope_v.
    det = along_u.x * along_v.y - along_u.y * along_v.x
    safe = dr.abs(det) > 1e-12
    scale = dr.select(safe, dr.rcp(dr.select(safe, det, 1.0)), 0.0)
    gx = (slope_u * along_v.y - slope_v * along_u.y) * scale
    gy = (slope_v * along_u.x - slope_u * along_v.x) * scale
    # Chosen: no relief steeper than 45 degrees.
    limit = dr.minimum(1.0, dr.rsqrt(dr.maximum(gx * gx + gy * gy, 1e-12)))
    return mi.Frame3f(dr.normalize(mi.Normal3f(-gx * limit, -gy * limit, 1.0)))
