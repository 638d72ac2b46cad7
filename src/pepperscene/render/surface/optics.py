"""The surfaces of a scene in a few flat device arrays, so that one BSDF without branches serves them all.

Light that meets one surface on its way from a light to the camera is an integral over wavelength of the
light's spectrum, the sensor's response and the surface's spectrum. Only the last differs between hits, the
body's part of it is linear between the surface's states, and the cuticle reflects all wavelengths equally. So
the integrals are taken once for each row of spectra, before any ray is traced, and the first hit needs no
wavelengths and has none of their noise:

    R_c = sum_l R(l) S_c(l) L(l) / sum_l S_c(l) L(l)

on the same grid that scattered light is traced on. A white body has R_c = 1 in every channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.gloss import TABLE_SIZE, cuticle_transmittance
from pepperscene.render.kernel.arrays import device_array, device_float, device_uint
from pepperscene.render.surface.scattering import SurfacePoint, interpolate_openness
from pepperscene.render.variant import mitsuba_modules

STEP_NM: Final = 1.0
"""Spacing of all wavelength grids, chosen. The kernel takes a surface's nearest entry: with wavelengths
spread over a pixel's samples that is the midpoint rule; its error is below 2e-4 for all shipped surfaces."""

MIN_ALPHA: Final = 1e-3
"""Chosen: smoother cuticles are packed with this roughness, a mirror for every lens and safe in single
precision."""


@dataclass(frozen=True, eq=False)
class Optics:
    """All surfaces of a scene, in the order of the mesh's `surfaces`.

    Attributes:
        first_nm: wavelength of the first column of `spectra`.
        columns: wavelengths per row, `STEP_NM` apart.
        spectra: `(rows * columns * 4,)` reflectance of front and back, transmittance, 0.
        first_row: `(k,)` row of a surface's first state.
        last_state: `(k,)` number of its states minus 1.
        sides: `(k * 2 * 4,)` for front and back: the cuticle's GGX alpha, its index of refraction, the
            cosine-weighted mean of its openness, and the fraction of the body's transmittance that leaves on
            the other side (the rest is sent back).
        openness: `(k * 2 * NODES * 2,)` for front and back: the cuticle's openness 1 - E at the nodes,
            relative to its mean, and the difference to the next node.
        details: `(texels * 2,)` offset of the state, and relief in local units.
        first_texel, width, height: `(k,)` the part of `details` that belongs to a surface.
        channels: number of sensor channels that `spectra` holds colours for; None if it holds spectra.
    """

    first_nm: Any
    columns: Any
    spectra: Any
    first_row: Any
    last_state: Any
    sides: Any
    openness: Any
    details: Any
    first_texel: Any
    width: Any
    height: Any
    channels: int | None = None

    @classmethod
    def pack(
        cls, surfaces: Sequence[Surface], first_nm: float, last_nm: float, unit_m: float = 1.0
    ) -> Optics:
        """Pack surfaces on a wavelength grid over [first_nm, last_nm], and reliefs in local units.

        Spectra are constant beyond their ends.

        Raises:
            ValueError: there are no surfaces, or a pattern and a relief differ in size.
        """
        if not surfaces:
            raise ValueError("the scene has no surfaces: assemble it with them to render colour")
        grid = np.arange(first_nm, last_nm + STEP_NM, STEP_NM)
        blocks = [spectra_rows(surface, grid) for surface in surfaces]
        details = [_details(surface, unit_m) for surface in surfaces]
        states = np.array([len(block) for block in blocks])
        texels = np.array([detail.shape[0] * detail.shape[1] for detail in details])
        sides, openness = zip(*(cuticle_tables(surface) for surface in surfaces), strict=True)
        return cls(
            first_nm=device_float(first_nm),
            columns=device_uint(grid.size),
            spectra=device_array(np.concatenate(blocks)),
            first_row=device_array(_block_starts(states), np.uint32),
            last_state=device_array(states - 1),
            sides=device_array(np.stack(sides)),
            openness=device_array(np.stack(openness)),
            details=device_array(np.concatenate([detail.ravel() for detail in details])),
            first_texel=device_array(_block_starts(texels), np.uint32),
            width=device_array([detail.shape[1] for detail in details], np.uint32),
            height=device_array([detail.shape[0] for detail in details], np.uint32),
        )

    def by_channel(self, weights: NDArray[np.float64]) -> Optics:
        """Integrate the spectra to the colours that c sensor channels, 1 or 3, see under one light.

        Args:
            weights: `(n, c)` response times light on the grid of the spectra; any scale.
        """
        spectra = np.asarray(self.spectra).reshape(-1, len(weights), 4)
        total = weights.sum(axis=0)
        fractions = weights / np.where(total > 0.0, total, 1.0)
        colours = np.einsum("rls,lc->rcs", spectra.astype(np.float64), fractions)
        return replace(self, spectra=device_array(colours), channels=weights.shape[1])

    def point(self, si: Any, surface: Any, state: Any, active: Any) -> SurfacePoint:
        """Look up the optical state at surface interactions.

        Args:
            si: with shading frame, uv and its partial derivatives.
            surface: number of the surface.
            state: pigment state in [0, 1], before the pattern.
            active: mask.
        """
        mi, dr = mitsuba_modules()
        offset, slope_u, slope_v = self._texture(si.uv, surface, active)
        front, back, through = self._body(si.wavelengths, surface, dr.clip(state + offset, 0.0, 1.0), active)
        frame = _relief_frame(si, slope_u, slope_v)
        wi = frame.to_local(si.wi)
        # The relief must not turn the visible side of the sheet away from the viewer.
        keep = wi.z * si.wi.z > 0.0
        frame = dr.select(keep, frame, mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0)))
        wi = dr.select(keep, wi, si.wi)
        in_front = wi.z > 0.0
        wi.z = dr.abs(wi.z)
        # The cuticle on the viewer's side, and the start of both sides' tables.
        side = surface * 2 + dr.select(in_front, mi.UInt32(0), mi.UInt32(1))
        cuticle = dr.gather(mi.Vector4f, self.sides, side, active)
        near_table = dr.select(active, side * TABLE_SIZE, 0)
        far_table = dr.select(active, (side ^ 1) * TABLE_SIZE, 0)
        openness = interpolate_openness(self.openness, near_table, wi.z)
        leaving = through * cuticle.w
        return SurfacePoint(
            frame=frame,
            wi=wi,
            flip=dr.select(in_front, mi.Float(1.0), mi.Float(-1.0)),
            reflectance=dr.select(in_front, front, back) + (through - leaving),
            transmittance=leaving,
            ior=cuticle.y,
            gloss=mi.MicrofacetDistribution(mi.MicrofacetType.GGX, cuticle.x, True),
            entering=openness * cuticle.z,
            openness=self.openness,
            near_table=near_table,
            far_table=far_table,
        )

    def _texture(self, uv: Any, surface: Any, active: Any) -> Any:
        """State offset, and slopes of the relief along u and v in local units, bilinear in the texels."""
        mi, dr = mitsuba_modules()
        width = dr.gather(mi.UInt32, self.width, surface, active)
        height = dr.gather(mi.UInt32, self.height, surface, active)
        first = dr.gather(mi.UInt32, self.first_texel, surface, active)
        x = uv.x * mi.Float(width) - 0.5
        y = uv.y * mi.Float(height) - 0.5
        left, top = dr.floor(x), dr.floor(y)
        fx, fy = x - left, y - top

        def texel(dx: int, dy: int) -> Any:
            # Tubes and fruit are periodic in u; on a leaf this affects half a texel at the margin.
            wrapped = left + dx
            wrapped = dr.select(wrapped < 0.0, wrapped + mi.Float(width), wrapped)
            column = mi.UInt32(dr.select(wrapped < mi.Float(width), wrapped, wrapped - mi.Float(width)))
            row = mi.UInt32(dr.clip(top + dy, 0.0, mi.Float(height) - 1.0))
            return dr.gather(mi.Point2f, self.details, first + row * width + column, active)

        a, b, c, d = texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)
        offset = dr.lerp(dr.lerp(a.x, b.x, fx), dr.lerp(c.x, d.x, fx), fy)
        slope_u = dr.lerp(b.y - a.y, d.y - c.y, fy) * mi.Float(width)
        slope_v = dr.lerp(c.y - a.y, d.y - b.y, fx) * mi.Float(height)
        return offset, slope_u, slope_v

    def _body(self, wavelengths: Any, surface: Any, state: Any, active: Any) -> Any:
        """Front and back reflectance and transmittance, at each wavelength or in each channel."""
        mi, dr = mitsuba_modules()
        last_state = dr.gather(mi.Float, self.last_state, surface, active)
        position = state * last_state
        low = dr.floor(position)
        row = dr.gather(mi.UInt32, self.first_row, surface, active) + mi.UInt32(low)
        next_row = mi.UInt32(dr.minimum(low + 1.0, last_state) - low)
        columns: Any = range(self.channels or 0)
        spectrum, row_length = (mi.Color3f if self.channels == 3 else mi.Color1f), self.channels
        if self.channels is None:
            spectrum, row_length = mi.Spectrum, self.columns
            last = mi.Float(self.columns) - 1.0
            columns = [
                mi.UInt32(dr.clip((nm - self.first_nm) / STEP_NM + 0.5, 0.0, last)) for nm in wavelengths
            ]
        front, back, through = spectrum(0.0), spectrum(0.0), spectrum(0.0)
        for k, column in enumerate(columns):
            entry = row * row_length + column
            a = dr.gather(mi.Vector4f, self.spectra, entry, active)
            b = dr.gather(mi.Vector4f, self.spectra, entry + next_row * row_length, active)
            front[k] = dr.lerp(a.x, b.x, position - low)
            back[k] = dr.lerp(a.y, b.y, position - low)
            through[k] = dr.lerp(a.z, b.z, position - low)
        return front, back, through


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


def spectra_rows(surface: Surface, grid_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(s, n, 4)` spectra of a surface by state: front and back reflectance, transmittance, 0."""

    def resample(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(grid_nm, surface.wavelength_nm, row) for row in rows])

    front, back = resample(surface.reflectance[:, 0]), resample(surface.reflectance[:, 1])
    through = resample(surface.transmittance)
    return np.stack([front, back, through, np.zeros_like(front)], axis=-1)


def cuticle_tables(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`(2, 4)` constants of a surface's two sides and `(2, NODES, 2)` tables of their openness."""
    ior = max(float(surface.ior), 1.0)
    alphas = [max(float(alpha), MIN_ALPHA) for alpha in surface.roughness]
    tables, means = zip(*(cuticle_transmittance(ior, alpha) for alpha in alphas), strict=True)
    smallest = min(means)
    sides = np.array([(alpha, ior, mean, smallest / mean) for alpha, mean in zip(alphas, means, strict=True)])
    relative = np.stack([table / mean for table, mean in zip(tables, means, strict=True)])
    steps = np.diff(relative, axis=1, append=relative[:, -1:])
    packed = np.stack([relative, steps], axis=-1)
    assert packed.shape == (2, TABLE_SIZE, 2)
    return sides, packed


def _details(surface: Surface, unit_m: float) -> NDArray[np.float32]:
    """`(h, w, 2)` pattern and relief of a surface; one zero texel if it has neither."""
    sizes = [image.shape for image in (surface.pattern, surface.relief_mm) if image is not None]
    if len(set(sizes)) > 1:
        raise ValueError(f"{surface.name}: pattern and relief differ in size: {sizes}")
    packed = np.zeros((*(sizes[0] if sizes else (1, 1)), 2), np.float32)
    if surface.pattern is not None:
        packed[..., 0] = surface.pattern
    if surface.relief_mm is not None:
        packed[..., 1] = surface.relief_mm * (1e-3 / unit_m)
    return packed


def _block_starts(counts: NDArray[np.int_]) -> NDArray[np.uint32]:
    """Start of each block when blocks of these lengths follow one another."""
    return (np.cumsum(counts) - counts).astype(np.uint32)
