"""Rendering with Mitsuba: kernel scenes, light transport, ground truth, derivatives and denoising.

No other package imports Mitsuba or Dr.Jit. Importing this one does not import them yet; the first frame does.
"""

from pepperscene.render.quality import QUALITIES, Quality, find_quality, resolve_quality
from pepperscene.render.renderer import Renderer, render_scene
from pepperscene.render.surface.textures import prepare_surfaces
from pepperscene.render.variant import variant_name, wanted_threads

__all__ = [
    "QUALITIES",
    "Quality",
    "Renderer",
    "find_quality",
    "prepare_surfaces",
    "render_scene",
    "resolve_quality",
    "variant_name",
    "wanted_threads",
]
