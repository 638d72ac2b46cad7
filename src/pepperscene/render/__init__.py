"""The only room that knows Mitsuba: kernel scenes, plugins, light transport, ground truth and the denoiser.

Importing this room does not import Mitsuba yet; the first render does.
"""

from pepperscene.render.quality import QUALITIES, Quality, quality_named, quality_of
from pepperscene.render.renderer import Renderer, begin, render
from pepperscene.render.variant import variant_name, wanted_threads

__all__ = [
    "QUALITIES",
    "Quality",
    "Renderer",
    "begin",
    "quality_named",
    "quality_of",
    "render",
    "variant_name",
    "wanted_threads",
]
