"""How all plant organs scatter light: a diffuse, possibly translucent body under a rough dielectric cuticle.

With F the Fresnel reflectance of the cuticle, F_mean its cosine-weighted hemispherical mean, R and T the
body's reflectance and transmittance,

    f_r = D G F(h) / (4 cos_i cos_o) + (1 - F(i)) (1 - F(o)) / (1 - F_mean) R / pi      (same side)
    f_t =                              (1 - F(i)) (1 - F(o)) / (1 - F_mean) T / pi      (other side)

which is reciprocal, and whose diffuse part sends out exactly (1 - F(i)) (R + T) of what comes in (coupling
after Ashikhmin & Shirley 2000; GGX after Walter et al. 2007). Front and back differ in R and in roughness.
All surfaces of a scene share these tables and this code, so that the kernel needs no indirect calls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pepperscene.render.tables import STEP_NM, SurfaceTables
from pepperscene.render.variant import kernel


class Optics:
    """The surface tables of a scene on the device."""

    def __init__(self, tables: SurfaceTables) -> None:
        mi, dr = kernel()
        self.first_nm = mi.Float(tables.first_nm)
        self.columns = mi.UInt32(tables.columns)
        self.spectra = mi.Float(tables.spectra)
        self.first_row = mi.UInt32(tables.first_row)
        self.last_state = mi.Float(tables.last_state)
        self.roughness = mi.Float(tables.roughness)
        self.details = mi.Float(tables.details)
        self.first_texel = mi.UInt32(tables.first_texel)
        self.width = mi.UInt32(tables.width)
        self.height = mi.UInt32(tables.height)
        self.ior = mi.Float(tables.ior)
        self.mean_fresnel = mi.Float([mean_fresnel(float(ior)) for ior in tables.ior])
        # Literals would be compiled into the kernel, and every new scene would compile anew.
        dr.make_opaque(self.first_nm, self.columns)

    def at(self, si: Any, surface: Any, state: Any, active: Any) -> Point:
        """The optical state at surface interactions.

        Args:
            si: interactions, with shading frame, uv and its partials.
            surface: number of the surface.
            state: pigment state in [0, 1], before the pattern.
            active: mask.
        """
        mi, dr = kernel()
        offset, slope_u, slope_v = self._detail(si.uv, surface, active)
        front, back, through = self._body(si.wavelengths, surface, dr.clip(state + offset, 0.0, 1.0), active)
        frame = _relief_frame(si, slope_u, slope_v)
        wi = frame.to_local(si.wi)
        # The relief may not turn a side of the sheet away from a viewer who sees it.
        keep = wi.z * si.wi.z > 0.0
        frame = dr.select(keep, frame, mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0)))
        wi = dr.select(keep, wi, si.wi)
        facing = wi.z > 0.0
        side = dr.select(facing, mi.UInt32(0), mi.UInt32(1))
        alpha = dr.gather(mi.Float, self.roughness, surface * 2 + side, active)
        return Point(
            frame=frame,
            wi=mi.Vector3f(wi.x, wi.y, dr.abs(wi.z)),
            flip=dr.select(facing, mi.Float(1.0), mi.Float(-1.0)),
            reflectance=dr.select(facing, front, back),
            transmittance=through,
            ior=dr.gather(mi.Float, self.ior, surface, active),
            mean_fresnel=dr.gather(mi.Float, self.mean_fresnel, surface, active),
            gloss=mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.maximum(alpha, 1e-3), True),
        )

    def _detail(self, uv: Any, surface: Any, active: Any) -> Any:
        """State offset, and the relief's slopes over u and v in metres, bilinear in the texels."""
        mi, dr = kernel()
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
        mi, dr = kernel()
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
class Point:
    """The optical state at a hit, seen from the side that the viewer is on.

    Attributes:
        frame: the relief's shading frame within the smooth one.
        wi: direction to the viewer in the relief's frame, above it.
        flip: -1 where the viewer is on the back side.
        reflectance, transmittance: of the body, by wavelength.
        ior, mean_fresnel: of the cuticle.
        gloss: its GGX distribution.
    """

    frame: Any
    wi: Any
    flip: Any
    reflectance: Any
    transmittance: Any
    ior: Any
    mean_fresnel: Any
    gloss: Any

    def eval_pdf(self, wo: Any) -> Any:
        """BSDF times cosine, and sampling density, for a direction in the smooth local frame."""
        mi, _ = kernel()
        turned = self.frame.to_local(wo)
        local = mi.Vector3f(turned.x, turned.y, turned.z * self.flip)
        return self._eval_pdf(local, wo.z * turned.z > 0.0)

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """A direction in the smooth local frame, its density and its weight (value over density).

        Also returns the number of the lobe: 0 gloss, 1 diffuse reflection, 2 diffuse transmission.
        """
        mi, dr = kernel()
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
        """Probabilities of the gloss and, of what remains, of diffuse transmission."""
        _, dr = kernel()
        specular = _fresnel(self.wi.z, self.ior)
        reflected, transmitted = dr.mean(self.reflectance), dr.mean(self.transmittance)
        body = (1.0 - specular) * (reflected + transmitted)
        gloss = dr.select(specular > 0.0, specular / (specular + body), 0.0)
        through = dr.select(transmitted > 0.0, transmitted / (reflected + transmitted), 0.0)
        return gloss, through

    def _eval_pdf(self, wo: Any, active: Any) -> Any:
        """Value times cosine, and density, for `wo` in the relief's frame with the viewer above."""
        _, dr = kernel()
        cos_i, cos_o = self.wi.z, dr.abs(wo.z)
        same = wo.z > 0.0
        entering = (1.0 - _fresnel(cos_i, self.ior)) * (1.0 - _fresnel(cos_o, self.ior))
        diffuse = entering / (1.0 - self.mean_fresnel) * dr.inv_pi * cos_o
        value = diffuse * dr.select(same, self.reflectance, self.transmittance)
        half = dr.normalize(self.wi + wo)
        mirror = _fresnel(dr.dot(self.wi, half), self.ior) * self.gloss.eval(half)
        mirror *= self.gloss.G(self.wi, wo, half) / (4.0 * cos_i)
        value += dr.select(same & (self.ior > 1.0), mirror, 0.0)

        gloss, through = self._shares()
        lambert = cos_o * dr.inv_pi * (1.0 - gloss)
        glossy = gloss * self.gloss.pdf(self.wi, half) / (4.0 * dr.dot(wo, half))
        density = dr.select(same, lambert * (1.0 - through) + glossy, lambert * through)
        usable = active & (cos_i > 1e-5) & (cos_o > 1e-5)
        return value & usable, dr.select(usable, density, 0.0)


def mean_fresnel(ior: float, steps: int = 2048) -> float:
    """Cosine-weighted hemispherical mean of the outer Fresnel reflectance (midpoint rule in cos^2)."""
    if ior <= 1.0:
        return 0.0
    cos_i = np.sqrt((np.arange(steps) + 0.5) / steps)
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / ior**2)
    parallel = (ior * cos_i - cos_t) / (ior * cos_i + cos_t)
    across = (cos_i - ior * cos_t) / (cos_i + ior * cos_t)
    return float(np.mean((parallel**2 + across**2) / 2.0))


def _fresnel(cosine: Any, ior: Any) -> Any:
    """Unpolarised reflectance of the outer interface; 0 where the index is 1."""
    mi, dr = kernel()
    return dr.select(ior > 1.0, mi.fresnel(dr.maximum(cosine, 0.0), ior)[0], 0.0)


def _relief_frame(si: Any, slope_u: Any, slope_v: Any) -> Any:
    """The shading frame on the relief, in local coordinates of the smooth one (Blinn 1978)."""
    mi, dr = kernel()
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
