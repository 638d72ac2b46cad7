"""`Optics` as a Mitsuba BSDF, so that Mitsuba's own integrators can render our scenes.

The number of the surface is an attribute of the face, its pigment state one of the vertex.
"""

from __future__ import annotations

import functools
from typing import Any

from pepperscene.render.surface.optics import Optics, shading_normals
from pepperscene.render.variant import mitsuba_modules

PLUGIN = "pepper_surface"


@functools.cache
def surface_bsdf() -> Any:
    """The BSDF class, registered with Mitsuba as `pepper_surface`; made once the variant is known."""
    mi, dr = mitsuba_modules()

    class SurfaceBSDF(mi.BSDF):  # type: ignore[name-defined]
        """Body under cuticle; construct through `of`."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | both,
                mi.BSDFFlags.DiffuseReflection | both,
                mi.BSDFFlags.DiffuseTransmission | both,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1] | self.m_components[2]
            self.optics: Optics

        @classmethod
        def of(cls, optics: Optics) -> Any:
            """An instance for the surfaces of one scene."""
            self = cls(mi.Properties())
            self.optics = optics
            return self

        def _point(self, si: Any, active: Any) -> Any:
            """The interactions with normals that face the viewer, and the optical state there."""
            surface = mi.UInt32(si.shape.eval_attribute_1("face_surface", si, active) + 0.5)
            state = si.shape.eval_attribute_1("vertex_state", si, active)
            # Mitsuba finds the place in the triangle by normal equations, whose determinant is 0 in single
            # precision where it is thousands of times longer than wide, as wires' are: of one state all over.
            state = dr.select(dr.isfinite(state), state, 0.5)
            turned = shading_normals(si)
            return turned, self.optics.at(turned, surface, state, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            turned, point = self._point(si, active)
            wo, density, weight, lobe = point.sample(sample1, sample2)
            bs = dr.zeros(mi.BSDFSample3f)
            # The caller's directions are in the frame that it gave.
            bs.wo = si.to_local(turned.to_world(wo))
            bs.pdf, bs.eta = dr.select(active, density, 0.0), 1.0
            bs.sampled_component = lobe
            bs.sampled_type = dr.select(
                lobe == 0,
                mi.UInt32(int(mi.BSDFFlags.GlossyReflection)),
                dr.select(
                    lobe == 1,
                    mi.UInt32(int(mi.BSDFFlags.DiffuseReflection)),
                    mi.UInt32(int(mi.BSDFFlags.DiffuseTransmission)),
                ),
            )
            return bs, weight & active

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            turned, point = self._point(si, active)
            value, density = point.eval_pdf(turned.to_local(si.to_world(wo)))
            return value & active, dr.select(active, density, 0.0)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return self._point(si, active)[1].albedo() & active

        def traverse(self, callback: Any) -> None:
            callback.put("spectra", self.optics.spectra, mi.ParamFlags.Differentiable)
            # Roughness is no parameter: the openness tables would have to follow it.

        def to_string(self) -> str:
            return f"SurfaceBSDF[surfaces={dr.width(self.optics.first_row)}]"

    mi.register_bsdf(PLUGIN, SurfaceBSDF)
    return SurfaceBSDF
