"""Textures of rinds over uv: variation of pigment, height and cork of fruit, stems, stalks and calyces.

Every surface has several textures, which `Appearance.variant` chooses from. Their random fields are drawn
together and made uncorrelated, so that no two fruit show the same patches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.cultivar import OrganForm
from pepperscene.materials.patterns import noise_mm
from pepperscene.spectra.spectrum import FloatArray

FRUIT_TEXTURES: Final = 8  # chosen: as many as a frame shows fruit at close range
GREEN_TEXTURES: Final = 6  # chosen: of a stem, a stalk or a calyx
SHAPE: Final = (256, 256)
"""Rows and columns of a fruit's textures: a texel is 0.6 by 1 mm."""
GREEN_SHAPE: Final = (256, 128)
"""Of those of stems, stalks and calyces: a texel of a stem is 0.4 by 0.2 mm."""

# Skin of fruit; all chosen from photographs of sweet peppers at close range.
PATCHES: Final = 0.045  # standard deviation of ripeness in patches that turn earlier than others
SPECKLE: Final = 0.012  # and in fine speckle
PATCH_MM: Final = (25.0, 50.0)  # shortest and longest wavelength of the patches
SPECKLE_MM: Final = (3.0, 6.0)
WAVINESS_MM: Final = 0.012
"""Standard deviation of the height of a fruit's skin at the wavelengths `WAVE_MM`: chosen, a third of the 20
to 50 micrometres between crests and troughs that make the edges of highlights uneven by a degree or two."""
WAVE_MM: Final = (3.0, 8.0)
BODY_EXPONENT: Final = 2.6
"""Of the superellipse that stands for a fruit's profile: chosen, between a round and a blocky one."""
RUSSET_MM: Final = (1.0, 5.0)  # chosen: width of the corky net beyond the teeth of the calyx
RUSSET_MESH_MM: Final = (2.0, 3.5)  # wavelengths of the field whose zeros are the lines of the net
STYLE_SCAR_MM: Final = 2.2  # chosen: radius of the corky scar at the blossom end
DUST: Final = 0.006  # chosen: cover of the skin outside scars and russet, dried drops of spray
SCRATCHES: Final = 1.2  # chosen: mean number of healed scratches of a fruit
_MIN_OWN: Final = 1e-6
"""Of the part of a field that no other has, over the largest such part. Chosen: ten times the rounding of the
fields, which are sums in single precision."""
_WAVES: Final = 14  # chosen: enough that no single one shows as a stripe
_ALL_ROWS: Final = slice(None)
_COVER: Final = 0.5, 0.8, 0.5  # chosen: of the lines of russet, the scar of the style, and scratches


def uncorrelated(fields: FloatArray) -> FloatArray:
    """Fields `(t, h, w)` less what they share, each with mean 0 and variance 1 (Gram-Schmidt).

    On an organ much smaller than their grain, fields consist of the same few waves, so that what they do not
    share is rounding. Such fields keep what they share; one without any variation stays 0.
    """
    flat = fields.reshape(len(fields), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    covariance = flat @ flat.T / flat.shape[1]
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        factor = np.zeros_like(covariance)
    own = np.diag(factor)
    if own.min() > _MIN_OWN * own.max():
        return np.asarray(np.linalg.solve(factor, flat)).reshape(fields.shape)
    spread = np.sqrt(np.diag(covariance))[:, None]
    return np.asarray(np.divide(flat, spread, out=np.zeros_like(flat), where=spread > 0.0)).reshape(
        fields.shape
    )


@dataclass(frozen=True, eq=False)
class FruitBody:
    """A body of revolution in place of all fruit that share textures, at the texels' centres."""

    points_mm: FloatArray  # `(h, w, 3)`
    radius_mm: FloatArray  # `(h,)` distance from the axis
    wall_mm: FloatArray  # `(h,)` distance from the stalk along the wall, in proportion to v
    length_mm: float  # of the wall, from the stalk to the blossom end

    @classmethod
    def of(cls, girth_mm: float, height_mm: float) -> FruitBody:
        """The body of this girth and height; the cavity at its stalk and its furrows are left out."""
        angle = np.linspace(0.0, np.pi, 721)
        sine, cosine = np.sin(angle), np.cos(angle)
        power = 2.0 / BODY_EXPONENT
        radius = 0.5 * girth_mm / np.pi * sine**power
        height = -0.5 * height_mm * np.sign(cosine) * np.abs(cosine) ** power
        wall = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
        at = (np.arange(SHAPE[0]) + 0.5) / SHAPE[0] * wall[-1]
        around = 2.0 * np.pi * (np.arange(SHAPE[1]) + 0.5) / SHAPE[1]
        radius, height = np.interp(at, wall, radius), np.interp(at, wall, height)
        points = np.empty((*SHAPE, 3))
        points[..., 0] = radius[:, None] * np.cos(around)
        points[..., 1] = radius[:, None] * np.sin(around)
        points[..., 2] = height[:, None]
        return cls(points, radius, at, float(wall[-1]))

    def noise(
        self, rng: np.random.Generator, wavelength_mm: tuple[float, float], rows: slice = _ALL_ROWS
    ) -> FloatArray:
        """`(FRUIT_TEXTURES, h, w)` smooth noise of mean 0 and variance 1, without a seam.

        Plane waves of random direction and of wavelengths in the given range, evaluated on the body
        (Shinozuka & Deodatis 1991). Amplitudes are in proportion to the wavelength, so that all have the same
        slope. Outside `rows` the noise is 0, which saves the time to compute it.
        """
        shape = (FRUIT_TEXTURES, _WAVES)
        direction = rng.standard_normal((*shape, 3))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        low, high = np.log(wavelength_mm)
        length = np.exp(rng.uniform(low, high, shape))
        phase = rng.uniform(0.0, 2.0 * np.pi, shape)
        points = self.points_mm[rows].reshape(-1, 3).astype(np.float32)
        wave, sum_of_waves = np.empty((2, len(points)), np.float32)
        result = np.zeros((FRUIT_TEXTURES, *SHAPE))
        for field, vectors, amplitudes, phases in zip(
            result,
            (2.0 * np.pi * direction / length[..., None]).astype(np.float32),
            length.astype(np.float32),
            phase.astype(np.float32),
            strict=True,
        ):
            # One wave at a time stays in the processor's cache.
            sum_of_waves[:] = 0.0
            for vector, amplitude, shift in zip(vectors, amplitudes, phases, strict=True):
                np.matmul(points, vector, out=wave)
                wave += shift
                np.cos(wave, out=wave)
                wave *= amplitude
                sum_of_waves += wave
            field[rows] = sum_of_waves.reshape(field[rows].shape)
        result[:, rows] = uncorrelated(result[:, rows])
        return result


@dataclass(frozen=True, eq=False)
class FruitTextures:
    """Textures `(t, h, w)` of fruit over uv."""

    pattern: FloatArray  # difference of ripeness
    relief_mm: FloatArray
    cover: FloatArray  # fraction of the skin that cork or dried spray covers, in [0, 1)


def fruit_textures(size_mm: tuple[float, float], calyx_mm: float, rng: np.random.Generator) -> FruitTextures:
    """Draw the textures of fruit, of which the mean has this girth and height, and radius of its calyx."""
    body = FruitBody.of(*size_mm)
    speckle = body.noise(rng, SPECKLE_MM)
    pattern = PATCHES * body.noise(rng, PATCH_MM) + SPECKLE * speckle
    relief_mm = WAVINESS_MM * body.noise(rng, WAVE_MM)
    # Drops dry in faint blotches: a lognormal field of mean `DUST`.
    cover = DUST * np.exp(0.7 * speckle - 0.5 * 0.7**2)
    corky = _russet(body, calyx_mm, rng), _style_scars(body, rng), _scratches(body, rng)
    for most, part in zip(_COVER, corky, strict=True):
        cover = np.maximum(cover, most * part)
    return FruitTextures(pattern, relief_mm, cover)


def _russet(body: FruitBody, calyx_mm: float, rng: np.random.Generator) -> FloatArray:
    """A net of fine corky lines around the calyx, 1 on its lines; its outer edge is uneven."""
    upper = body.wall_mm < 0.5 * body.length_mm
    rim_mm = float(np.interp(calyx_mm, body.radius_mm[upper], body.wall_mm[upper]))
    low, high = RUSSET_MM
    rows = slice(0, int(np.searchsorted(body.wall_mm, rim_mm + 1.3 * high)) + 1)
    reach = np.clip(0.5 * (low + high) + 0.5 * (high - low) * body.noise(rng, PATCH_MM, rows), low, high)
    lines = np.exp(-((body.noise(rng, RUSSET_MESH_MM, rows) / 0.35) ** 2))
    # Lines thin out towards the edge of the net; below the calyx they cannot be seen.
    beyond = np.maximum(body.wall_mm - rim_mm, 0.0)[None, :, None]
    return lines * np.clip(1.3 - beyond / reach, 0.0, 1.0)


def _style_scars(body: FruitBody, rng: np.random.Generator) -> FloatArray:
    """The corky disc that the style leaves at the blossom end, with an uneven edge."""
    to_end = body.length_mm - body.wall_mm
    rows = slice(int(np.searchsorted(-to_end, -3.0 * STYLE_SCAR_MM)), SHAPE[0])
    radius = STYLE_SCAR_MM * np.maximum(1.0 + 0.3 * body.noise(rng, (2.0, 5.0), rows), 0.3)
    return np.clip(2.0 - 2.0 * to_end[None, :, None] / radius, 0.0, 1.0)


def _scratches(body: FruitBody, rng: np.random.Generator) -> FloatArray:
    """Healed scratches, which leaves and stems have rubbed into young fruit: straight, 5 to 25 mm long."""
    result = np.zeros((FRUIT_TEXTURES, *SHAPE))
    for field, count in zip(result, rng.poisson(SCRATCHES, FRUIT_TEXTURES), strict=True):
        rows = rng.integers(SHAPE[0] // 5, 4 * SHAPE[0] // 5, count)
        columns = rng.integers(0, SHAPE[1], count)
        for row, column in zip(rows, columns, strict=True):
            offset = body.points_mm - body.points_mm[row, column]
            direction = rng.standard_normal(3)
            direction /= np.linalg.norm(direction)
            along = offset @ direction
            half = rng.uniform(2.5, 12.5)
            squared = np.sum(offset**2, axis=-1) - np.clip(along, -half, half) * (
                2.0 * along - np.clip(along, -half, half)
            )
            # A third of a millimetre to either side, fainter than russet.
            np.maximum(field, rng.uniform(0.3, 0.8) * np.exp(-np.maximum(squared, 0.0) / 0.6**2), out=field)
    return result


# Ribs and warts: chosen, as greenhouse cucumbers look.
_RIB_WARP: Final = 0.1  # by which ribs wander to either side, of the distance between two
_RIB_WAVE_MM: Final = (60.0, 120.0)  # wavelengths of that
_STREAKS: Final = 0.35  # decrease of the state along the crests of ribs, at the blossom end
_WART_SIZES: Final = 0.6, 1.4  # smallest and largest radius and height of warts, over the mean


@dataclass(frozen=True)
class FruitSkin:
    """What the skin of fruit has beside waves and scars; nothing by default."""

    ribs: int = 0
    rib_height_mm: float = 0.0  # of a crest over the furrows beside it
    warts_per_cm2: float = 0.0
    wart_height_mm: float = 0.0  # mean
    wart_width_mm: float = 1.0  # mean diameter


def add_skin(
    textures: FruitTextures, size_mm: tuple[float, float], skin: FruitSkin, rng: np.random.Generator
) -> FruitTextures:
    """Add ribs and warts to the relief of fruit, and pale streaks on the ribs to their pattern.

    `size_mm` are girth and height of the mean fruit.
    """
    if skin.ribs == 0 and skin.warts_per_cm2 == 0.0:
        return textures
    pattern, relief_mm = textures.pattern, textures.relief_mm
    body = FruitBody.of(*size_mm)
    if skin.ribs > 0:
        crest = _crests(body, skin.ribs, rng)
        # Ribs end in both ends of the fruit; streaks begin at the blossom end and reach half of the way up.
        along = body.wall_mm / body.length_mm
        relief_mm = relief_mm + skin.rib_height_mm * crest * np.sqrt(np.sin(np.pi * along))[:, None]
        pattern = pattern - _STREAKS * crest**3 * (np.clip(2.0 * along - 1.0, 0.0, 1.0) ** 2)[:, None]
    if skin.warts_per_cm2 * skin.wart_height_mm > 0.0:
        relief_mm = relief_mm + _warts(body, skin, rng)
    return FruitTextures(pattern, relief_mm, textures.cover)


def _crests(body: FruitBody, ribs: int, rng: np.random.Generator) -> FloatArray:
    """`(t, h, w)` 1 on the crests of ribs, 0 in the furrows between them."""
    around = 2.0 * np.pi * (np.arange(SHAPE[1]) + 0.5) / SHAPE[1]
    warp = 2.0 * np.pi * _RIB_WARP * np.clip(body.noise(rng, _RIB_WAVE_MM), -1.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(ribs * around + warp))


def _warts(body: FruitBody, skin: FruitSkin, rng: np.random.Generator) -> FloatArray:
    """`(t, h, w)` millimetres: round warts, evenly scattered over the skin."""
    heights = np.zeros((FRUIT_TEXTURES, *SHAPE))
    girth_mm = 2.0 * np.pi * body.radius_mm
    step_mm = body.length_mm / SHAPE[0]
    # The chance of a row is its area.
    count = round(skin.warts_per_cm2 * girth_mm.sum() * step_mm / 100.0)
    for texture in heights:
        rows = rng.choice(SHAPE[0], count, p=girth_mm / girth_mm.sum())
        columns, sizes = rng.integers(SHAPE[1], size=count), rng.uniform(*_WART_SIZES, count)
        for row, column, size in zip(rows.tolist(), columns.tolist(), sizes.tolist(), strict=True):
            radius_mm = 0.5 * size * skin.wart_width_mm
            near = np.flatnonzero(np.abs(body.wall_mm - body.wall_mm[row]) < radius_mm)
            texel_mm = girth_mm[row] / SHAPE[1]
            reach = min(int(radius_mm / texel_mm), SHAPE[1] // 2 - 1)
            aside = np.arange(-reach, reach + 1)
            distance = np.hypot((body.wall_mm[near] - body.wall_mm[row])[:, None], aside * texel_mm)
            wart = size * skin.wart_height_mm * np.clip(1.0 - (distance / radius_mm) ** 2, 0.0, 1.0) ** 2
            part = np.ix_(near, (column + aside) % SHAPE[1])
            texture[part] = np.maximum(texture[part], wart)
    return heights


@dataclass(frozen=True)
class RindTexture:
    """Variation of a green rind's state and height over its surface; all chosen from photographs."""

    streaks: float  # standard deviation of the state in streaks along the organ
    mottle: float  # standard deviation of the state in blotches of some millimetres
    ribs_mm: float  # standard deviation of the height of ribs along the organ
    rib_width: float  # as a fraction of the girth
    flecks: float = 0.0  # decrease of the state in lenticels, corky flecks some millimetres long
    fissures: float = 0.0  # decrease of the state in the fissures of cork
    fissure_mm: float = 0.0  # their depth


# The large ridges are part of the mesh. Fissures show on cork, where a lower state is dark brown; on a green
# stem they are hardly darker than the rest.
STEM_TEXTURE: Final = RindTexture(
    streaks=0.06, mottle=0.03, ribs_mm=0.08, rib_width=0.05, flecks=0.25, fissures=0.13, fissure_mm=0.08
)
TEXTURES: Final[dict[OrganForm, RindTexture]] = {
    "stalk": RindTexture(streaks=0.06, mottle=0.04, ribs_mm=0.05, rib_width=0.05),
    # Slightly ribbed in addition to the mesh's five ribs.
    "peduncle": RindTexture(streaks=0.07, mottle=0.03, ribs_mm=0.09, rib_width=0.035, flecks=0.12),
    # The veins that run into the teeth are part of the mesh.
    "calyx": RindTexture(streaks=0.05, mottle=0.05, ribs_mm=0.05, rib_width=0.03),
}
CALYX_RIM_V: Final = 0.69
"""Surface coordinate v of the rim of a calyx, half-way between its upper and its lower side."""


def green_textures(
    form: OrganForm, size_mm: tuple[float, float], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Textures of a stem, a stalk or a calyx: differences of the state, and heights in millimetres.

    Both are `(GREEN_TEXTURES, h, w)`. Forms that `TEXTURES` does not have look like a stem. `size_mm` are
    girth and length.
    """
    texture, girth = TEXTURES.get(form, STEM_TEXTURE), size_mm[0]

    def noise(around_mm: float, along_mm: float) -> FloatArray:
        fields = [noise_mm(rng, GREEN_SHAPE, size_mm, (around_mm, along_mm)) for _ in range(GREEN_TEXTURES)]
        return uncorrelated(np.stack(fields))

    # Streaks are narrow around (u) and long (v); ribs run along the whole organ.
    pattern = texture.streaks * noise(0.02 * girth, 12.0) + texture.mottle * noise(1.5, 6.0)
    relief_mm = texture.ribs_mm * noise(texture.rib_width * girth, 60.0)
    if texture.flecks:
        # Flecks are the peaks of a field of short streaks: the upper tenth, with soft edges.
        pattern = pattern - texture.flecks * np.clip((noise(0.25, 1.6) - 1.3) / 0.7, 0.0, 1.0)
    if texture.fissures:
        # Cork splits into long meshes: fissures are the zeros of a field that is long along the stem.
        fissure = np.exp(-((noise(0.06 * girth, 9.0) / 0.14) ** 2))
        pattern, relief_mm = pattern - texture.fissures * fissure, relief_mm - texture.fissure_mm * fissure
    if form == "calyx":
        pattern = pattern - _dry_rim(noise)
    # On a small organ two sums of few streaks and spots would be alike by chance.
    level, spread = pattern.mean(axis=(1, 2), keepdims=True), pattern.std(axis=(1, 2), keepdims=True)
    return level + spread * uncorrelated(pattern), relief_mm


def _dry_rim(noise: Callable[[float, float], FloatArray]) -> FloatArray:
    """Decrease of a calyx' state in dry spots along its rim, about the mean that the mesh gives the rim."""
    v = (np.arange(GREEN_SHAPE[0]) + 0.5) / GREEN_SHAPE[0]
    near = np.exp(-(((v - CALYX_RIM_V) / 0.05) ** 2))[None, :, None]
    spots = np.clip(noise(1.2, 2.0), 0.0, 2.0)
    return 0.2 * near * (spots - spots.mean())
