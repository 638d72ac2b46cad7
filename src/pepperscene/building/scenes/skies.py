"""The sky above the plants of a frame: the frame's own, or one under other daylight."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.recipe.plan import FrameSpec, Stream, random_generator
from pepperscene.recipe.resolve.frame_setups import FrameSetup

if TYPE_CHECKING:
    from pepperscene.scene import Sky


def sky_above(builder: SceneBuilder, setup: FrameSetup, spec: FrameSpec, **light: float) -> Sky:
    """The sky below the cover of a frame's greenhouse, over a floor that its crop shades.

    `light` is as of `partly_cloudy_sky`.
    """
    from pepperscene.scene import partly_cloudy_sky

    return partly_cloudy_sky(
        random_generator(builder.recipe.seed, Stream.SKY, spec.set),
        cover=setup.cover,
        leaf_area_index=builder.leaf_area_index(spec.set),
        **light,
    )


def sky_under_daylight(
    builder: SceneBuilder,
    setup: FrameSetup,
    spec: FrameSpec,
    direct_lx: float,
    diffuse_lx: float,
    **shape: float,
) -> Sky:
    """The sky below the cover of a frame's greenhouse for daylight of sun and sky above it, on a level plane.

    `shape` is `cloud_cover`, `sun_azimuth_rad` and `sun_elevation_rad`, as of `partly_cloudy_sky`.
    """
    from pepperscene.scene.sky import MAX_SUN_FRACTION
    from pepperscene.spectra import illuminance, sky_spectrum, sun_spectrum

    if setup.cover is not None:
        through = setup.cover.transmittance
        sun, sky = sun_spectrum(shape["sun_elevation_rad"]), sky_spectrum("d65")
        direct_lx *= illuminance(sun.times(through)) / illuminance(sun)
        diffuse_lx *= illuminance(sky.times(through)) / illuminance(sky)
    total = direct_lx + diffuse_lx
    sun_fraction = min(direct_lx / total, MAX_SUN_FRACTION)
    return sky_above(builder, setup, spec, illuminance_lx=total, sun_fraction=sun_fraction, **shape)
