"""Gloss of a rough dielectric cuticle: two GGX lobes of the same index on fractions of its area.

Lobe k reflects by single scattering with separable Smith masking (Walter et al. 2007, EGSR),

    f_k(i, o) = D_k(h) F(i . h) G1_k(i) G1_k(o) / (4 cos_i cos_o),       f_g = (1 - w) f_1 + w f_2.

Normals are sampled from those visible to the viewer (Heitz 2018, JCGT 7(4)), of lobe 2 with probability w.
The mirrored directions have the density (1 - w) p_1 + w p_2 with p_k = D_k(h) G1_k(i) / (4 cos_i), and
f_g cos_o is the sum of its parts times F G1_k(o).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class GlossLobes:
    """The gloss of a cuticle at a hit.

    Attributes:
        ior: refractive index.
        square, wide_square: squared roughness of the two lobes.
        wide_share: w, the fraction of the area with the second one.
    """

    ior: Any
    square: Any
    wide_square: Any
    wide_share: Any

    def sample(self, wi: Any, sample1: Any, sample2: Any) -> Any:
        """Sample a mirrored direction of `wi`, which is above the surface; it can end below."""
        mi, dr = mitsuba_modules()
        alpha = dr.sqrt(dr.select(sample1 < self.wide_share, self.wide_square, self.square))
        lobe = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        normal, _ = lobe.sample(wi, sample2)
        return 2.0 * dr.dot(wi, normal) * mi.Vector3f(normal) - wi

    def eval_pdf(self, wi: Any, wo: Any) -> tuple[Any, Any]:
        """Gloss times cosine, and the density of mirrored directions, for directions above the surface."""
        mi, dr = mitsuba_modules()
        half = dr.normalize(wi + wo)
        across = dr.square(half.x) + dr.square(half.y)
        along = dr.square(half.z)

        def parts(square: Any) -> tuple[Any, Any]:
            """Density p_k, and p_k G1_k(o)."""
            stretched = across / square + along
            normals = dr.inv_pi / (square * dr.square(stretched))
            density = 0.5 * normals / _unmasked(wi.z, square)  # G1(i) = 2 cos_i over this
            return density, density * (2.0 * wo.z / _unmasked(wo.z, square))

        (narrow, narrow_out), (wide, wide_out) = parts(self.square), parts(self.wide_square)
        fresnel = mi.fresnel(dr.maximum(dr.dot(wi, half), 0.0), self.ior)[0]
        value = fresnel * dr.lerp(narrow_out, wide_out, self.wide_share)
        return value, dr.lerp(narrow, wide, self.wide_share)


def _unmasked(cosine: Any, square: Any) -> Any:
    """Cosine plus the root in Smith's masking, G1 = 2 cosine / (cosine + root)."""
    _, dr = mitsuba_modules()
    z = dr.square(cosine)
    return cosine + dr.sqrt(dr.fma(square, dr.maximum(1.0 - z, 0.0), z))
