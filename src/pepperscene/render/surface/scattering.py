"""Scattering of light by plant organs: a diffuse, possibly translucent body under a rough dielectric cuticle.

Side s of a sheet reflects by the gloss f_g of its cuticle, two GGX lobes with separable Smith masking
(`pepperscene.render.surface.scattering`) whose directional albedo is E_s(i), and all light that the gloss
does not send out (refracted, masked, or sent below the horizon) reaches the body. With the openness
A_s = 1 - E_s, its cosine-weighted mean a_s = <A_s>, and the body's reflectances R_s and transmittance T
(fractions of the light that reaches it),

    f_r(i, o) = f_g(i, o) + A_s(i) A_s(o) / a_s    R'_s / pi,       R'_s = R_s + T - T'_s
    f_t(i, o) =             A_s(i) A_o(o) / a_o    T'_s / pi,       T'_s = T min(a_s, a_o) / a_s

where the index o of A_o and a_o is the other side. That is the coupling of Kelemen & Szirmay-Kalos 2001
(after Ashikhmin & Shirley 2000), carried through a sheet. It is physically sound:

- Reciprocity: f_r is symmetric as written; f_t = A_s(i) A_o(o) T min(a_s, a_o) / (pi a_s a_o) is the same
  from either side.
- Energy: the cosine-weighted means of A_s / a_s and A_o / a_o are 1, so the body sends out
  A_s(i) (R'_s + T'_s). Light that entered through the more open side and that the less open side cannot let
  out is sent back, and R'_s + T'_s = R_s + T on both sides. So side s sends out
  E_s(i) + A_s(i) (R_s + T): never more than 1, and 1 if and only if R_s + T = 1.

E_s is tabulated per surface and side (`pepperscene.materials.gloss`) and a_s is the mean of the interpolant
itself, so the body's part is exact; the gloss errs by the interpolation, below 4e-4 between cosines and, for
a relief that is filtered, below 3e-3 between slope variances.

Residue, opaque, matt and of reflectance r, covers the fraction f_s of side s of a place, independently of the
other side. There is no gloss on it: that of side s becomes (1 - f_s) f_g with the albedo E' = (1 - f_s) E, so
that its openness is A' = (1 - f_s) A + f_s and its mean a' = (1 - f_s) a + f_s. Light that enters meets body
and residue in proportion to their areas, and what comes through the sheet is reflected between body and
residue (Stokes 1862); o is the other side:

    R_s -> f_s r + (1 - f_s) (R_s + f_o r T^2 / (1 - r R_o))        T -> (1 - f_s) (1 - f_o) T

The formulas above then hold as they are, with the primed openness: f_s is the same for all directions, so
both are symmetric, and R + T stays at most 1: r T^2 / (1 - r R_o) <= T because 1 - R_o >= T, so that a place
whose side s is bare sends out at most R_s + f_o T + (1 - f_o) T. With r = 1 a lossless sheet stays lossless.

A relief turns the shading frame only (Blinn 1978). Directions on different sides of it and of the smooth
surface cannot be used: of the light of a matt body on a slope of angle t the fraction l = (1 - cos t) / 2.
Such light meets the surface again, which sends out what it does not absorb, and so on. With p_s = R_s + T the
body sends out p_s (1 - l) (1 + l p_s + ...) = p_s (1 - l) k_s with k_s = 1 / (1 - l p_s), so that

    T''_s = T'_s min(k_s, k_o),        R''_s = k_s p_s - T''_s

conserve the energy of a matt body for every slope. All are reciprocal for directions on the same side of both
surfaces, because l depends on the place alone. For a body under gloss, which sends less light to the horizon,
l is an upper limit, and gloss below the smooth surface is still lost: together they change the light that a
lossless surface sends out by less than 1.5 % (`tests/laws/test_furnace.py`).
Directions above the smooth surface and below its triangle, or the other way round, cannot be used either:
rays would enter an opaque body, or leave one. What they would carry is added in the same way.

Gloss of a rough dielectric cuticle: two GGX lobes of the same index on fractions of its area.

Lobe k reflects by single scattering with separable Smith masking (Walter et al. 2007, EGSR),

    f_k(i, o) = D_k(h) F(i . h) G1_k(i) G1_k(o) / (4 cos_i cos_o),       f_g = (1 - w) f_1 + w f_2.

Normals are sampled from those visible to the viewer (Heitz 2018, JCGT 7(4)), of lobe 2 with probability w.
The mirrored directions have the density (1 - w) p_1 + w p_2 with p_k = D_k(h) G1_k(i) / (4 cos_i), and
f_g cos_o is the sum of its parts times F G1_k(o).

Places on surfaces: what a hit needs of the tables of `Optics`, whatever the wavelength.

Light at any number of wavelengths or in any number of bands is scattered by the same lobes at such a place:
only the reflectance and the transmittance of the body differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Final

from pepperscene.materials.gloss import TABLE_SCALE, TABLE_SIZE
from pepperscene.render.surface.normals import lost_fraction
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


_NODES_PER_LOG: Final = (TABLE_SIZE - 1) / math.log1p(1.0 / TABLE_SCALE)
MIN_COSINE: Final = 1e-5
"""No light is scattered to or from directions closer to the horizon. Chosen: single precision resolves no
angles there, and only 1e-10 of a diffuse lobe is beyond it."""


@dataclass(frozen=True, eq=False)
class SurfacePoint:
    """The optical state at a hit, seen from the viewer's side.

    Attributes:
        frame: shading frame of the relief within the smooth one.
        triangle: normal of the triangle in the smooth frame.
        wi: direction to the viewer in the relief's frame, above it.
        flip: -1 if the viewer is on the back side.
        reflectance, transmittance: R' and T' of the body, to the viewer's side and to the other, by
            wavelength or channel.
        gloss: of the cuticle on the viewer's side.
        entering: 1 - E, the fraction of light along `wi` that reaches the body or the residue.
        openness: tables of all cuticles.
        near, far: openness of the cuticles on the viewer's side and on the other.
        by_lobe: whether values are given by lobe: the factor of the reflectance, that of the transmittance,
            and the gloss, as a `Color3f`. Directions are sampled as otherwise.
    """

    frame: Any
    triangle: Any
    wi: Any
    flip: Any
    reflectance: Any
    transmittance: Any
    gloss: GlossLobes
    entering: Any
    openness: Any
    near: SideOpenness
    far: SideOpenness
    by_lobe: bool = False

    def eval_pdf(self, wo: Any) -> Any:
        """BSDF times cosine, and sampling density, for a direction in the smooth local frame."""
        return self.eval_pdf_in_relief(*self.to_relief(wo))

    def to_relief(self, wo: Any) -> tuple[Any, Any]:
        """A direction in the relief's frame with the viewer above, and whether no side changes."""
        mi, _ = mitsuba_modules()
        local = self.frame.to_local(wo)
        return mi.Vector3f(local.x, local.y, local.z * self.flip), self._is_same_side(wo, local.z)

    def _is_same_side(self, wo: Any, height: Any) -> Any:
        """Whether a direction is on the same side of the relief, the smooth surface and the triangle.

        `wo` is in the smooth frame, and `height` its z in the relief's.
        """
        _, dr = mitsuba_modules()
        return (wo.z * height > 0.0) & (dr.dot(self.triangle, wo) * height > 0.0)

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """Sample a direction.

        Returns:
            The direction in the smooth local frame, its density, its weight (value over density), and the
            number of its lobe: 0 gloss, 1 diffuse reflection, 2 diffuse transmission.
        """
        mi, dr = mitsuba_modules()
        gloss, through = self._lobe_probabilities()
        mirror = sample1 < gloss
        remainder = (sample1 - gloss) / dr.maximum(1.0 - gloss, 1e-6)
        mirrored = self.gloss.sample(self.wi, sample1 / dr.maximum(gloss, 1e-6), sample2)
        scattered = mi.warp.square_to_cosine_hemisphere(sample2)
        scattered.z = dr.select(remainder < through, -scattered.z, scattered.z)
        local = dr.select(mirror, mirrored, scattered)
        wo = self.frame.to_world(mi.Vector3f(local.x, local.y, local.z * self.flip))
        # A mirrored direction can end below; one on a relief can end on the other side of the smooth surface.
        valid = (~mirror | (local.z > 0.0)) & self._is_same_side(wo, local.z * self.flip)
        value, density = self.eval_pdf_in_relief(local, valid)
        lobe = dr.select(mirror, mi.UInt32(0), dr.select(remainder < through, mi.UInt32(2), mi.UInt32(1)))
        return wo, density, value / dr.maximum(density, 1e-20), lobe

    def sample_gloss(self, sample1: Any, sample2: Any) -> tuple[Any, Any, Any]:
        """Sample a direction of the gloss alone; returns it with BSDF times cosine and density as `eval_pdf`.

        Both are 0 if it ends below the surface.
        """
        mi, _ = mitsuba_modules()
        local = self.gloss.sample(self.wi, sample1, sample2)
        wo = self.frame.to_world(mi.Vector3f(local.x, local.y, local.z * self.flip))
        valid = (local.z > 0.0) & self._is_same_side(wo, local.z * self.flip)
        return wo, *self.eval_pdf_in_relief(local, valid)

    def gloss_density(self, wo: Any) -> Any:
        """Density of `sample_gloss` at a direction in the smooth local frame."""
        _, dr = mitsuba_modules()
        local, is_same_side = self.to_relief(wo)
        return dr.select(is_same_side & (local.z > 0.0), self.gloss.eval_pdf(self.wi, local)[1], 0.0)

    def albedo(self) -> Any:
        """Reflectance and transmittance of the body together."""
        return self.reflectance + self.transmittance

    def diffuse_reflectance(self) -> Any:
        """Fraction of even light from all directions that the body sends back, without gloss: R'' a (1 - l).

        It is the radiance factor of the body under light that is equal from all directions above the smooth
        surface, as a mean over the directions of view, which differ by their openness only. Between 0 and 1;
        1 for a lossless matt surface with any relief, and the reflectance of a grey card.
        """
        return self.reflectance * (self.near.mean * (1.0 - lost_fraction(self.frame, self.triangle)))

    def _lobe_probabilities(self) -> Any:
        """Probabilities of the gloss and, if it is not chosen, of diffuse transmission.

        Lobes are chosen by their albedos, the root mean square over the wavelengths of the ray: for lobes
        that do not overlap that minimises the variance of the weights, summed over the wavelengths.
        """
        _, dr = mitsuba_modules()
        specular = dr.maximum(1.0 - self.entering, 0.0)
        # `dr.mean` would write the number of rays into the code, which then compiles for each number.
        per_wavelength = 1.0 / len(self.reflectance)
        reflected = dr.sqrt(dr.sum(dr.square(self.reflectance)) * per_wavelength)
        transmitted = dr.sqrt(dr.sum(dr.square(self.transmittance)) * per_wavelength)
        body = self.entering * (reflected + transmitted)
        gloss = dr.select(specular > 0.0, specular / (specular + body), 0.0)
        through = dr.select(transmitted > 0.0, transmitted / (reflected + transmitted), 0.0)
        return gloss, through

    def eval_pdf_in_relief(self, wo: Any, active: Any) -> Any:
        """BSDF times cosine, and density, for a direction in the relief's frame with the viewer above."""
        mi, dr = mitsuba_modules()
        cos_i, cos_o = self.wi.z, dr.abs(wo.z)
        same_side = wo.z > 0.0
        lambert = cos_o * dr.inv_pi
        side = dr.select(same_side, self.near, self.far)
        leaving = side.at(self.openness, cos_o) / side.mean
        diffuse = self.entering * leaving * lambert
        gloss_value, gloss_density = self.gloss.eval_pdf(self.wi, wo)
        gloss_value *= 1.0 - self.near.cover
        if self.by_lobe:
            value = mi.Color3f(diffuse & same_side, diffuse & ~same_side, gloss_value & same_side)
        else:
            body = dr.select(same_side, self.reflectance, self.transmittance)
            value = diffuse * body + (gloss_value & same_side)

        gloss, through = self._lobe_probabilities()
        lambert *= 1.0 - gloss
        density = dr.select(same_side, lambert * (1.0 - through) + gloss * gloss_density, lambert * through)
        usable = active & (cos_i > MIN_COSINE) & (cos_o > MIN_COSINE)
        return value & usable, dr.select(usable, density, 0.0)


@dataclass
class SideOpenness:
    """Openness of one side of a sheet at a hit: A' = (1 - f) A + f.

    Attributes:
        table: first entry of the two tables, of smaller and of larger slope variance.
        blur: weight of the second one.
        cover: f, the fraction of the side that residue covers.
        mean: a', the cosine-weighted mean of A'.
    """

    table: Any
    blur: Any
    cover: Any
    mean: Any

    @classmethod
    def of(cls, tables: Any, table: Any, blur: Any, cover: Any) -> SideOpenness:
        """Read the mean, which follows the entries of the nodes."""
        mi, dr = mitsuba_modules()
        entry = dr.gather(mi.Vector4f, tables, table + TABLE_SIZE)
        return cls(table, blur, cover, dr.lerp(dr.lerp(entry.x, entry.z, blur), 1.0, cover))

    def at(self, tables: Any, cosine: Any) -> Any:
        """A' at cosines, linear between the nodes of the tables and between the tables."""
        mi, dr = mitsuba_modules()
        position = dr.log(dr.fma(cosine, 1.0 / TABLE_SCALE, 1.0)) * _NODES_PER_LOG
        # Written like this, the NaN of an inactive lane reads entry 0, not an address outside the table.
        position = dr.select(position > 0.0, dr.minimum(position, TABLE_SIZE - 1.0), 0.0)
        node = dr.floor(position)
        entry = dr.gather(mi.Vector4f, tables, self.table + mi.UInt32(node))
        fraction = position - node
        smaller, larger = dr.fma(entry.y, fraction, entry.x), dr.fma(entry.w, fraction, entry.z)
        return dr.lerp(dr.lerp(smaller, larger, self.blur), 1.0, self.cover)


def by_lobe(lobes: Any, reflectance: Any, transmittance: Any) -> Any:
    """Values by wavelength or channel from values by lobe; see `SurfacePoint.by_lobe`."""
    return lobes.x * reflectance + lobes.y * transmittance + lobes.z


def select_point(mask: Any, first: SurfacePoint, second: SurfacePoint) -> SurfacePoint:
    """The first optical state where the mask is true, else the second; both of the same surfaces."""
    _, dr = mitsuba_modules()
    names = [field.name for field in fields(SurfacePoint) if field.name not in ("openness", "by_lobe")]
    return replace(
        first, **{name: dr.select(mask, getattr(first, name), getattr(second, name)) for name in names}
    )


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
        lost: fraction of the body's light below the horizon of the smooth surface or of its triangle.
        is_scanned: whether a scan gives the colour; None if no organ has any.
        colour: linear sRGB of the scan.
        change: relative change of the body's reflectance by a fine texture, where the body absorbs all other
            light; None without fine textures.
    """

    row: Any
    next_row: Any
    fraction: Any
    residue: Any
    cover: Any
    cover_behind: Any
    in_front: Any
    leaving: Any
    lost: Any
    is_scanned: Any | None = None
    colour: Any = None
    change: Any | None = None


@dataclass(frozen=True, eq=False)
class SurfacePlace:
    """A place on a surface, seen from the viewer's side; see `SurfacePoint`, which adds the spectra.

    Attributes:
        body: of the sheet.
        frame, triangle, wi, gloss, near, far: as of `SurfacePoint`.
    """

    body: BodyPlace
    frame: Any
    triangle: Any
    wi: Any
    gloss: GlossLobes
    near: SideOpenness
    far: SideOpenness
