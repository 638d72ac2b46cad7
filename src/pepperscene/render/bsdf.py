"""The BSDF of all plant organs: a diffuse, possibly translucent body under a rough dielectric cuticle.

With F the Fresnel reflectance of the cuticle, F_mean its cosine-weighted hemispherical mean, R and T the
body's reflectance and transmittance,

    f_r = D G F(h) / (4 cos_i cos_o) + (1 - F(i)) (1 - F(o)) / (1 - F_mean) R / pi      (same side)
    f_t =                              (1 - F(i)) (1 - F(o)) / (1 - F_mean) T / pi      (other side)

which is reciprocal, and whose diffuse part sends out exactly (1 - F(i)) (R + T) of what comes in (coupling
after Ashikhmin & Shirley 2000; GGX after Walter et al. 2007). Front and back differ in R and in roughness.
One instance serves a whole scene: the surface's number is an attribute of the face, its pigment state one of
the vertex, so that the kernel has no indirect calls.
"""

from __future__ import annotations

import functools
from typing import Any

from pepperscene.render.tables import STEP_NM, SurfaceTables
from pepperscene.render.variant import kernel

PLUGIN = "pepper_surface"


@functools.cache
def surface_bsdf() -> Any:
    """The BSDF class, registered with Mitsuba as `pepper_surface`; made once the variant is known."""
    mi, dr = kernel()

    class SurfaceBSDF(mi.BSDF):
        """Body under cuticle; construct through `with_tables`."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | both,
                mi.BSDFFlags.DiffuseReflection | both,
                mi.BSDFFlags.DiffuseTransmission | both,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1] | self.m_components[2]

        @classmethod
        def with_tables(cls, tables: SurfaceTables) -> Any:
            """An instance for the surfaces of one scene."""
            self = cls(mi.Properties())
            self.first_nm = mi.Float(tables.first_nm)
            self.columns = mi.UInt32(tables.columns)
            self.spectra = mi.Float(tables.spectra)
            self.first_row = mi.UInt32(tables.first_row)
            self.last_state = mi.Float(tables.last_state)
            self.ior = mi.Float(tables.ior)
            self.roughness = mi.Float(tables.roughness)
            self.details = mi.Float(tables.details)
            self.first_texel = mi.UInt32(tables.first_texel)
            self.width = mi.UInt32(tables.width)
            self.height = mi.UInt32(tables.height)
            self.mean_fresnel = mi.Float([mean_fresnel(float(ior)) for ior in tables.ior])
            # Literals would be compiled into the kernel, and every new scene would compile anew.
            dr.make_opaque(self.first_nm, self.columns)
            return self

        # --- what the surface is like at a point --------------------------------------------------------

        def _surface(self, si: Any, active: Any) -> Any:
            """Number of the surface at the point."""
            return mi.UInt32(si.shape.eval_attribute_1("face_surface", si, active) + 0.5)

        def _detail(self, si: Any, surface: Any, active: Any) -> Any:
            """State offset, and relief's slopes over u and v in metres, bilinear in the texels."""
            width = dr.gather(mi.UInt32, self.width, surface, active)
            height = dr.gather(mi.UInt32, self.height, surface, active)
            first = dr.gather(mi.UInt32, self.first_texel, surface, active)
            x = si.uv.x * mi.Float(width) - 0.5
            y = si.uv.y * mi.Float(height) - 0.5
            left, top = dr.floor(x), dr.floor(y)
            fx, fy = x - left, y - top

            def texel(dx: int, dy: int) -> Any:
                column = mi.UInt32(dr.clip(left + dx, 0.0, mi.Float(width) - 1.0))
                row = mi.UInt32(dr.clip(top + dy, 0.0, mi.Float(height) - 1.0))
                return dr.gather(mi.Point2f, self.details, first + row * width + column, active)

            a, b, c, d = texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)
            offset = dr.lerp(dr.lerp(a.x, b.x, fx), dr.lerp(c.x, d.x, fx), fy)
            slope_u = dr.lerp(b.y - a.y, d.y - c.y, fy) * mi.Float(width)
            slope_v = dr.lerp(c.y - a.y, d.y - b.y, fx) * mi.Float(height)
            return offset, slope_u, slope_v

        def _tilted(self, si: Any, slope_u: Any, slope_v: Any) -> Any:
            """The shading frame on the relief, in local coordinates of the smooth one (Blinn 1978)."""
            along_u = si.to_local(si.dp_du)
            along_v = si.to_local(si.dp_dv)
            # Gradient g of the height in the tangent plane: g . dp_du = slope_u, g . dp_dv = slope_v.
            det = along_u.x * along_v.y - along_u.y * along_v.x
            safe = dr.abs(det) > 1e-12
            scale = dr.select(safe, dr.rcp(dr.select(safe, det, 1.0)), 0.0)
            gx = (slope_u * along_v.y - slope_v * along_u.y) * scale
            gy = (slope_v * along_u.x - slope_u * along_v.x) * scale
            steep = dr.sqrt(gx * gx + gy * gy)
            limit = dr.minimum(
                1.0, 1.0 / dr.maximum(steep, 1e-6)
            )  # chosen: no relief steeper than 45 degrees
            return mi.Frame3f(dr.normalize(mi.Normal3f(-gx * limit, -gy * limit, 1.0)))

        def _point(self, si: Any, active: Any) -> Any:
            """Everything that eval, pdf and sample need of the point."""
            surface = self._surface(si, active)
            offset, slope_u, slope_v = self._detail(si, surface, active)
            state = dr.clip(si.shape.eval_attribute_1("vertex_state", si, active) + offset, 0.0, 1.0)
            state *= dr.gather(mi.Float, self.last_state, surface, active)
            low = dr.minimum(dr.floor(state), dr.gather(mi.Float, self.last_state, surface, active))
            row = dr.gather(mi.UInt32, self.first_row, surface, active) + mi.UInt32(low)
            step = dr.select(low < dr.gather(mi.Float, self.last_state, surface, active), mi.UInt32(1), 0)
            front, back, through = self._body(si.wavelengths, row, step, state - low, active)
            frame = self._tilted(si, slope_u, slope_v)
            wi = frame.to_local(si.wi)
            # The relief may not turn a side of the sheet away from a viewer who sees it.
            keep = wi.z * si.wi.z > 0.0
            frame = dr.select(keep, frame, mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0)))
            wi = dr.select(keep, wi, si.wi)
            facing = wi.z > 0.0
            alpha = dr.gather(
                mi.Float, self.roughness, surface * 2 + dr.select(facing, mi.UInt32(0), 1), active
            )
            return _Point(
                frame=frame,
                wi=dr.select(facing, wi, mi.Vector3f(wi.x, wi.y, -wi.z)),
                flip=dr.select(facing, mi.Float(1.0), -1.0),
                reflectance=dr.select(facing, front, back),
                transmittance=through,
                ior=dr.gather(mi.Float, self.ior, surface, active),
                mean_fresnel=dr.gather(mi.Float, self.mean_fresnel, surface, active),
                gloss=mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.maximum(alpha, 1e-3), True),
            )

        def _body(self, wavelengths: Any, row: Any, step: Any, weight: Any, active: Any) -> Any:
            """Front and back reflectance and transmittance at each of the ray's wavelengths."""
            front, back, through = mi.Spectrum(0.0), mi.Spectrum(0.0), mi.Spectrum(0.0)
            last = mi.Float(self.columns) - 1.0
            for k in range(len(wavelengths)):
                column = mi.UInt32(dr.clip((wavelengths[k] - self.first_nm) / STEP_NM + 0.5, 0.0, last))
                here = row * self.columns + column
                a = dr.gather(mi.Vector4f, self.spectra, here, active)
                b = dr.gather(mi.Vector4f, self.spectra, here + step * self.columns, active)
                front[k] = dr.lerp(a.x, b.x, weight)
                back[k] = dr.lerp(a.y, b.y, weight)
                through[k] = dr.lerp(a.z, b.z, weight)
            return front, back, through

        # --- the three lobes ----------------------------------------------------------------------------

        def _shares(self, point: Any) -> Any:
            """Probabilities of the gloss and, of what remains, of diffuse transmission."""
            specular = fresnel(point.wi.z, point.ior)
            reflected, transmitted = dr.mean(point.reflectance), dr.mean(point.transmittance)
            body = (1.0 - specular) * (reflected + transmitted)
            gloss = dr.select(specular > 0.0, specular / (specular + body), 0.0)
            through = dr.select(transmitted > 0.0, transmitted / (reflected + transmitted), 0.0)
            return gloss, through

        def _eval_pdf(self, point: Any, wo: Any) -> Any:
            """Value times the cosine, and density, for `wo` in the flipped local frame of the point."""
            cos_i, cos_o = point.wi.z, dr.abs(wo.z)
            same = wo.z > 0.0
            entering = (1.0 - fresnel(cos_i, point.ior)) * (1.0 - fresnel(cos_o, point.ior))
            diffuse = entering / (1.0 - point.mean_fresnel) * dr.inv_pi * cos_o
            value = diffuse * dr.select(same, point.reflectance, point.transmittance)
            half = dr.normalize(point.wi + wo)
            mirror = fresnel(dr.dot(point.wi, half), point.ior) * point.gloss.eval(half)
            mirror *= point.gloss.G(point.wi, wo, half) / (4.0 * cos_i)
            value += dr.select(same & (point.ior > 1.0), mirror, 0.0)

            gloss, through = self._shares(point)
            lambert = cos_o * dr.inv_pi * (1.0 - gloss)
            glossy = gloss * point.gloss.pdf(point.wi, half) / (4.0 * dr.dot(wo, half))
            density = dr.select(same, lambert * (1.0 - through) + glossy, lambert * through)
            usable = (cos_i > 1e-5) & (cos_o > 1e-5)
            return value & usable, dr.select(usable, density, 0.0)

        # --- Mitsuba's interface ------------------------------------------------------------------------

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            point = self._point(si, active)
            gloss, through = self._shares(point)
            pick_gloss = sample1 < gloss
            rest = (sample1 - gloss) / dr.maximum(1.0 - gloss, 1e-6)
            normal, _ = point.gloss.sample(point.wi, sample2)
            mirrored = 2.0 * dr.dot(point.wi, normal) * mi.Vector3f(normal) - point.wi
            scattered = mi.warp.square_to_cosine_hemisphere(sample2)
            scattered.z = dr.select(rest < through, -scattered.z, scattered.z)
            wo = dr.select(pick_gloss, mirrored, scattered)
            value, density = self._eval_pdf(point, wo)
            good = active & (density > 0.0) & (~pick_gloss | (wo.z > 0.0))
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = point.to_smooth(wo)
            good &= _same_side(bs.wo, si, wo.z * point.flip)
            bs.pdf = dr.select(good, density, 0.0)
            bs.eta = 1.0
            bs.sampled_component = dr.select(
                pick_gloss, mi.UInt32(0), dr.select(rest < through, mi.UInt32(2), 1)
            )
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            return bs, (value / dr.maximum(density, 1e-20)) & good

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            point = self._point(si, active)
            local = point.to_relief(wo)
            value, density = self._eval_pdf(point, local)
            good = active & _same_side(wo, si, local.z * point.flip)
            return value & good, dr.select(good, density, 0.0)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            """Body reflectance and transmittance together: the denoiser's albedo."""
            point = self._point(si, active)
            return point.reflectance + point.transmittance

        def traverse(self, callback: Any) -> None:
            callback.put("spectra", self.spectra, mi.ParamFlags.Differentiable)
            callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"SurfaceBSDF[surfaces={dr.width(self.first_row)}]"

    def _same_side(wo: Any, si: Any, relief_z: Any) -> Any:
        """Whether a direction lies on the same side of the relief and of the smooth surface."""
        return wo.z * relief_z > 0.0

    class _Point:
        """The optical state at a point, seen from the side that `wi` is on."""

        def __init__(self, **parts: Any) -> None:
            self.frame = parts["frame"]
            self.wi = parts["wi"]
            self.flip = parts["flip"]
            self.reflectance = parts["reflectance"]
            self.transmittance = parts["transmittance"]
            self.ior = parts["ior"]
            self.mean_fresnel = parts["mean_fresnel"]
            self.gloss = parts["gloss"]

        def to_relief(self, v: Any) -> Any:
            """From the smooth local frame to the relief's, flipped so that `wi` is above."""
            turned = self.frame.to_local(v)
            return mi.Vector3f(turned.x, turned.y, turned.z * self.flip)

        def to_smooth(self, v: Any) -> Any:
            """The inverse of `to_relief`."""
            return self.frame.to_world(mi.Vector3f(v.x, v.y, v.z * self.flip))

    def fresnel(cosine: Any, ior: Any) -> Any:
        """Unpolarised reflectance of the outer interface; 0 where the index is 1."""
        return dr.select(ior > 1.0, mi.fresnel(dr.maximum(cosine, 0.0), ior)[0], 0.0)

    mi.register_bsdf(PLUGIN, SurfaceBSDF)
    return SurfaceBSDF


def mean_fresnel(ior: float, steps: int = 2048) -> float:
    """Cosine-weighted hemispherical mean of the outer Fresnel reflectance (midpoint rule in cos^2)."""
    import numpy as np

    if ior <= 1.0:
        return 0.0
    cos_i = np.sqrt((np.arange(steps) + 0.5) / steps)
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / ior**2)
    parallel = (ior * cos_i - cos_t) / (ior * cos_i + cos_t)
    across = (cos_i - ior * cos_t) / (cos_i + ior * cos_t)
    return float(np.mean((parallel**2 + across**2) / 2.0))
