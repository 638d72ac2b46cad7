"""The only room that knows Mitsuba: kernel scenes, plugins, light transport, ground truth and the denoiser.

Importing this room does not import Mitsuba yet; the first render does.
"""

from pepperscene.render.quality import QUALITIES, Quality, find_quality, resolve_quality
from pepperscene.render.renderer import Renderer, render_scene, warm_up
from pepperscene.render.variant import variant_name, wanted_threads

__all__ = [
    "QUALITIES",
    "Quality",
    "Renderer",
    "find_quality",
    "render_scene",
    "resolve_quality",
    "variant_name",
    "wanted_threads",
    "warm_up",
]
