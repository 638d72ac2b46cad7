"""The only room that knows Mitsuba: kernel scenes, plugins, light transport, ground truth and the denoiser.

Importing this room does not import Mitsuba yet; the first render does.
"""

from pepperscene.render.renderer import QUALITIES, Quality, Renderer, quality_named, render
from pepperscene.render.variant import variant_name

__all__ = ["QUALITIES", "Quality", "Renderer", "quality_named", "render", "variant_name"]
