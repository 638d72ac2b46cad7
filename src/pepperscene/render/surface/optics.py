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

from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.materials import Surface
from pepperscene.materials.gloss import BLUR_NODES, LARGEST_BLUR, TABLE_SIZE
from pepperscene.materials.surface import AGEING_RANGE
from pepperscene.render.arrays import channel_array, device_array, device_float, device_uint
from pepperscene.render.surface.normals import lost_fraction
from pepperscene.render.surface.scanned_colours import ScannedColours
from pepperscene.render.surface.scattering import (
    BodyPlace,
    GlossLobes,
    SideOpenness,
    SurfacePlace,
    SurfacePoint,
)
from pepperscene.render.surface.skins import SkinTables, changed_reflectance
from pepperscene.render.surface.tables import (
    channel_colours,
    channel_fractions,
    cuticle_tables,
    narrowest_alpha,
    spectra_rows,
)
from pepperscene.render.surface.textures import TextureSample, TextureTables
from pepperscene.render.variant import mitsuba_modules

STEP_NM: Final = 0.5
"""Spacing of all wavelength grids, chosen. The kernel takes a surface's nearest entry: with wavelengths
spread over a pixel's samples that is the midpoint rule; its error is below 2e-5 for all shipped surfaces.
With 1 nm it is 3e-4 of a leaf's blue signal, because a flash's blue LED changes by 6 % per nanometre."""

_COLOURS: Final = (1, 3)  # channels of sensors without bands

_MOST_COVER: Final = 0.95
"""Largest cover with residue, as `Surface` describes."""


@dataclass(frozen=True, eq=False)
class Optics:
    """All surfaces of a scene, in the order of the mesh's `surfaces`, and the organs that have them.

    Attributes:
        first_nm: wavelength of the first column of `spectra`.
        columns: wavelengths per row, `STEP_NM` apart; or bands.
        spectra: `(rows * columns * 4,)` reflectance of front and back, transmittance, and, for channels, the
            variance of their sum over wavelength.
        organs: `(o * 4,)` number of an organ's surface; 1 plus that of its texture, negative if mirrored in
            u; residue; ageing.
        bodies: `(k * 4,)` row of a surface's first state, number of its states minus 1, rate of ageing
            (0 for a surface that does not age), reflectance of residue.
        residue_behind: `(k,)` cover of the back with residue over that of the front.
        blurs: `(k * 2,)` 1 over the square of the narrowest lobe's roughness, and tables per logarithm: see
            `pepperscene.materials.gloss.blur_nodes`.
        sides: `(k * 2 * 4,)` for front and back: the cuticle's GGX alphas, share of the second, and index.
        openness: `(k * 2 * (BLUR_NODES - 1) * (NODES + 1) * 4,)` for front and back, from each slope variance
            of a filtered relief to the next: the cuticle's openness 1 - E at the nodes and the difference to
            the next node, for the smaller variance and for the larger. After the last node come the means.
        textures: over uv.
        channels: number of sensor channels that `spectra` holds colours for; None if it holds spectra.
        scanned: reflectance of colours that come from scans; None if there are none.
        skins: fine textures; None if no surface has one.
    """

    first_nm: Any
    columns: Any
    spectra: Any
    organs: Any
    bodies: Any
    residue_behind: Any
    blurs: Any
    sides: Any
    openness: Any
    textures: TextureTables
    channels: int | None = None
    scanned: ScannedColours | None = None
    skins: SkinTables | None = None

    @classmethod
    def pack(
        cls,
        surfaces: Sequence[Surface],
        first_nm: float,
        last_nm: float,
        unit_m: float = 1.0,
        organs: NDArray[np.float64] | None = None,
        *,
        has_colours: bool = False,
    ) -> Optics:
        """Pack surfaces on a wavelength grid over [first_nm, last_nm], and reliefs in local units.

        Spectra are constant beyond their ends. `organs` are `(o, 4)` as in the attributes; None for one
        without residue and ageing for each surface, with its first texture. `has_colours` if `point` is
        called with colours.

        Raises:
            ValueError: there are no surfaces, or textures of one differ in size.
        """
        if not surfaces:
            raise ValueError("there are no surfaces to pack")
        if organs is None:
            organs = np.array([(k, 1.0, 0.0, 0.0) for k in range(len(surfaces))])
        grid = np.arange(first_nm, last_nm + STEP_NM, STEP_NM)
        blocks = [spectra_rows(surface, grid) for surface in surfaces]
        states = np.array([len(block) for block in blocks])
        ageing = [_ageing_rate(surface) for surface in surfaces]
        residue = [surface.residue_reflectance for surface in surfaces]
        behind = [surface.residue_behind for surface in surfaces]
        narrowest = np.array([narrowest_alpha(surface) for surface in surfaces])
        per_log = (BLUR_NODES - 1) / np.log1p(LARGEST_BLUR / narrowest**2)
        sides, openness = zip(*(cuticle_tables(surface) for surface in surfaces), strict=True)
        return cls(
            first_nm=device_float(first_nm),
            columns=device_uint(grid.size),
            spectra=device_array(np.concatenate(blocks)),
            organs=device_array(organs),
            bodies=device_array(np.column_stack([np.cumsum(states) - states, states - 1, ageing, residue])),
            residue_behind=device_array(behind),
            blurs=device_array(np.column_stack([narrowest**-2.0, per_log])),
            sides=device_array(np.stack(sides)),
            openness=device_array(np.stack(openness)),
            textures=TextureTables.pack(surfaces, unit_m),
            scanned=ScannedColours.pack(grid) if has_colours else None,
            skins=SkinTables.pack(surfaces, unit_m),
        )

    def by_channel(self, weights: NDArray[np.float64]) -> Optics:
        """Integrate the spectra to the colours that c sensor channels see under one light.

        Args:
            weights: `(n, c)` response times light on the grid of the spectra; any scale. c is 1, 3 or, for
                bands, a multiple of `BATCH`.
        """
        spectra, channels = np.asarray(self.spectra).reshape(-1, len(weights), 4), weights.shape[1]
        colours = device_array(channel_colours(spectra, weights))
        scanned = None if self.scanned is None else self.scanned.by_channel(channel_fractions(weights))
        # The number of bands is kernel data, so that another one compiles nothing.
        columns = self.columns if channels in _COLOURS else device_uint(channels)
        return replace(self, spectra=colours, channels=channels, columns=columns, scanned=scanned)

    def with_colours(
        self, surfaces: Sequence[Surface], grid_nm: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> Optics:
        """The same surfaces as `by_channel` shows them, over another grid of wavelengths.

        Args:
            surfaces: those that were packed.
            grid_nm: `(n,)` wavelengths.
            weights: `(n, c)` response times light there; any scale.
        """
        colours = [channel_colours(spectra_rows(surface, grid_nm), weights) for surface in surfaces]
        scanned = None
        if self.scanned is not None:
            scanned = ScannedColours.pack(grid_nm).by_channel(channel_fractions(weights))
        spectra = device_array(np.concatenate(colours))
        return replace(self, spectra=spectra, channels=weights.shape[1], scanned=scanned)

    def point(
        self,
        si: Any,
        organ: Any,
        state: Any,
        active: Any,
        footprint: Any | None = 0.0,
        colour: Any | None = None,
    ) -> SurfacePoint:
        """Look up the optical state at surface interactions.

        Args:
            si: with shading frame, uv and its partial derivatives.
            organ: number of the organ.
            state: pigment state in [0, 1] of healthy tissue, before the pattern.
            active: mask.
            footprint: area that a pixel covers there, squared local units; None for hits that no camera ray
                found. See `TextureTables.look_up`.
            colour: linear sRGB of the body, negative where pigments give the colour; None for pigments
                everywhere.
        """
        surface = self.locate(si, organ, state, active, footprint, colour)
        return self.seen(surface, self._columns(si.wavelengths), active)

    def locate(
        self,
        si: Any,
        organ: Any,
        state: Any,
        active: Any,
        footprint: Any | None = 0.0,
        colour: Any | None = None,
    ) -> SurfacePlace:
        """Look up what the optical state at surface interactions is at all wavelengths; see `point`."""
        mi, dr = mitsuba_modules()
        values = dr.gather(mi.Vector4f, self.organs, organ, active)
        surface, texture = mi.UInt32(values.x), mi.UInt32(dr.maximum(dr.abs(values.y) - 1.0, 0.0))
        texel = self.textures.look_up(si, surface, texture, values.y < 0.0, footprint, active)
        change = shown = None
        if self.skins is not None and footprint is not None:
            texel, change, shown = self.skins.added_to(texel, si, surface, texture, footprint, active)
        frame = mi.Frame3f(mi.Normal3f(0.0, 0.0, 1.0))
        relief, blur = _relief(si, texel)
        wi = si.wi
        if footprint is not None:
            wi = relief.to_local(si.wi)
            # The relief must not turn the visible side of the sheet away from the viewer.
            keep = wi.z * si.wi.z > 0.0
            frame = dr.select(keep, relief, frame)
            wi = dr.select(keep, wi, si.wi)
        triangle, in_front = si.to_local(mi.Vector3f(si.n)), wi.z > 0.0
        wi = mi.Vector3f(wi.x, wi.y, dr.abs(wi.z))

        # The cuticle on the viewer's side, and how open both sides are.
        side = surface * 2 + dr.select(in_front, mi.UInt32(0), mi.UInt32(1))
        cuticle = dr.gather(mi.Vector4f, self.sides, side, active)
        width = blur if shown is None else blur - shown
        gloss = GlossLobes(cuticle.w, dr.square(cuticle.x) + width, dr.square(cuticle.y) + width, cuticle.z)
        cover = dr.clip(values.z * texel.residue, 0.0, _MOST_COVER)
        cover_behind = cover * dr.gather(mi.Float, self.residue_behind, surface, active)
        table, weight = self._blurred_table(surface, blur, active)
        length = (BLUR_NODES - 1) * (TABLE_SIZE + 1)
        near, far = (
            SideOpenness.of(
                self.openness,
                dr.select(active, number * length + table, 0),
                weight,
                dr.select(is_front, cover, cover_behind),
            )
            for number, is_front in ((side, in_front), (side ^ 1, ~in_front))
        )

        # The pigment state of the body.
        body = dr.gather(mi.Vector4f, self.bodies, surface, active)
        aged = dr.clip(values.w - texel.ageing, 0.0, 1.0) * body.z
        healthy = dr.clip(state + texel.state, 0.0, 1.0)
        row, next_row, fraction = _between_states(body, healthy - dr.minimum(aged, 1.0) * (1.0 + healthy))
        place = BodyPlace(
            row=row,
            next_row=next_row,
            fraction=fraction,
            residue=body.w,
            cover=cover,
            cover_behind=cover_behind,
            in_front=in_front,
            leaving=dr.minimum(1.0, far.mean / near.mean),
            lost=lost_fraction(frame, triangle),
            # Rounding may take the scanned black below 0.
            is_scanned=None if colour is None or self.scanned is None else colour.x > 0.5 * PIGMENTS,
            colour=colour,
            change=change,
        )
        return SurfacePlace(place, frame, triangle, wi, gloss, near, far)

    def seen(self, surface: SurfacePlace, columns: Any, active: Any) -> SurfacePoint:
        """The optical state at a place in some columns of the tables."""
        mi, dr = mitsuba_modules()
        reflectance, transmittance = self.reflectances(surface.body, columns, active)
        return SurfacePoint(
            frame=surface.frame,
            triangle=surface.triangle,
            wi=surface.wi,
            flip=dr.select(surface.body.in_front, mi.Float(1.0), mi.Float(-1.0)),
            reflectance=reflectance,
            transmittance=transmittance,
            gloss=surface.gloss,
            entering=surface.near.at(self.openness, surface.wi.z),
            openness=self.openness,
            near=surface.near,
            far=surface.far,
        )

    def reflectances(self, place: BodyPlace, columns: Any, active: Any) -> tuple[Any, Any]:
        """R' and T' of the body at a place, in some columns of the tables: see `SurfacePoint`.

        The body is under residue. On a relief, light beyond the horizon meets it again.
        """
        _, dr = mitsuba_modules()
        cover, cover_behind, residue = place.cover, place.cover_behind, place.residue
        front, back, through, variance = self._body(place, columns, active)
        if place.is_scanned is not None and self.scanned is not None:
            seen, spread = self.scanned.body(columns, place.colour, active)
            front, back = dr.select(place.is_scanned, seen, front), dr.select(place.is_scanned, seen, back)
            through = dr.select(place.is_scanned, 0.0, through)
            variance = dr.select(place.is_scanned, spread, variance)
        if place.change is not None:
            front, back = (changed_reflectance(side, through, place.change) for side in (front, back))
        squared, least = through * through * residue, 1e-6
        front_backed = front + cover_behind * squared / dr.maximum(1.0 - residue * back, least)
        back_backed = back + cover * squared / dr.maximum(1.0 - residue * front, least)
        front = dr.lerp(front_backed, residue, cover)
        back = dr.lerp(back_backed, residue, cover_behind)
        through *= (1.0 - cover) * (1.0 - cover_behind)
        total = dr.select(place.in_front, front, back) + through
        transmitted = through * place.leaving
        total_behind = dr.select(place.in_front, back, front) + through
        # In a channel, the mean of what is scattered twice exceeds the square of the mean.
        variance *= dr.square(1.0 - cover)
        again, again_behind = (
            dr.rcp(1.0 - place.lost * (both + variance / dr.maximum(both, least)))
            for both in (total, total_behind)
        )
        total, transmitted = total * again, transmitted * dr.minimum(again, again_behind)
        return dr.maximum(total - transmitted, 0.0), transmitted

    def _columns(self, wavelengths: Any) -> Any:
        """Columns of `spectra`: one for each channel, or those nearest to wavelengths."""
        mi, dr = mitsuba_modules()
        if self.channels is not None:
            return range(self.channels)
        last = mi.Float(self.columns) - 1.0
        return [mi.UInt32(dr.clip((nm - self.first_nm) / STEP_NM + 0.5, 0.0, last)) for nm in wavelengths]

    def _blurred_table(self, surface: Any, blur: Any, active: Any) -> tuple[Any, Any]:
        """First entry of the tables around a slope variance in those of one side, and its weight there."""
        mi, dr = mitsuba_modules()
        scale = dr.gather(mi.Point2f, self.blurs, surface, active)
        position = dr.log(dr.fma(blur, scale.x, 1.0)) * scale.y
        # Written like this, the NaN of an inactive lane becomes 0.
        position = dr.select(position > 0.0, dr.minimum(position, BLUR_NODES - 1.0), 0.0)
        row = dr.minimum(dr.floor(position), BLUR_NODES - 2.0)
        return mi.UInt32(row) * (TABLE_SIZE + 1), position - row

    def _body(self, place: BodyPlace, columns: Any, active: Any) -> Any:
        """Front and back reflectance, transmittance, and the variance in a channel of their sum."""
        mi, dr = mitsuba_modules()
        row_length = self.channels if self.channels in _COLOURS else self.columns
        spectrum = channel_array(len(columns))
        front, back, through, variance = (spectrum(0.0) for _ in range(4))
        for k, column in enumerate(columns):
            entry = place.row * row_length + column
            a = dr.gather(mi.Vector4f, self.spectra, entry, active)
            b = dr.gather(mi.Vector4f, self.spectra, entry + place.next_row * row_length, active)
            front[k] = dr.lerp(a.x, b.x, place.fraction)
            back[k] = dr.lerp(a.y, b.y, place.fraction)
            through[k] = dr.lerp(a.z, b.z, place.fraction)
            if self.channels is not None:
                variance[k] = dr.lerp(a.w, b.w, place.fraction)
        return front, back, through, variance


def _between_states(body: Any, state: Any) -> tuple[Any, Any, Any]:
    """Row of the spectra below a pigment state, rows to the one above, and the fraction of the way there.

    `body` is the surface's entry of `bodies`, and `state` in [-1, 1] if it ages, else in [0, 1].
    """
    mi, dr = mitsuba_modules()
    last_state = body.y
    position = dr.select(body.z > 0.0, 0.5 * (state + 1.0), state) * last_state
    low = dr.floor(position)
    next_row = mi.UInt32(dr.minimum(low + 1.0, last_state) - low)
    return mi.UInt32(body.x) + mi.UInt32(low), next_row, position - low


def _relief(si: Any, texel: TextureSample) -> tuple[Any, Any]:
    """The shading frame on the relief, in local coordinates of the smooth one (Blinn 1978), and its blur.

    The blur is twice the slope variance per axis that was filtered out.
    """
    mi, dr = mitsuba_modules()
    along_u = si.to_local(si.dp_du)
    along_v = si.to_local(si.dp_dv)
    # Gradients of u and v in the tangent plane: that of u has the products 1 with dp_du and 0 with dp_dv.
    det = along_u.x * along_v.y - along_u.y * along_v.x
    safe = dr.abs(det) > 1e-12
    scale = dr.select(safe, dr.rcp(dr.select(safe, det, 1.0)), 0.0)
    u_x, u_y = along_v.y * scale, -along_v.x * scale
    v_x, v_y = -along_u.y * scale, along_u.x * scale
    gx = texel.slope_u * u_x + texel.slope_v * v_x
    gy = texel.slope_u * u_y + texel.slope_v * v_y
    # Chosen: no relief steeper than 45 degrees.
    limit = dr.minimum(1.0, dr.rsqrt(dr.maximum(gx * gx + gy * gy, 1e-12)))
    frame = mi.Frame3f(dr.normalize(mi.Normal3f(-gx * limit, -gy * limit, 1.0)))
    blur = texel.variance_u * (u_x * u_x + u_y * u_y) + texel.variance_v * (v_x * v_x + v_y * v_y)
    return frame, dr.clip(blur, 0.0, LARGEST_BLUR)


def _ageing_rate(surface: Surface) -> float:
    """What fraction of its tissue ages for each unit of ageing; 0 for a surface that does not age."""
    if surface.first_state == 0.0:
        return 0.0
    return 1.0 if surface.ageing_order is None else 1.0 / AGEING_RANGE
