"""A physically based spectral renderer of sweet-pepper plants: labelled, radiometrically calibrated images.

The whole program in one line; every arrow is one function:

    Cultivar -> Plant -> Mesh -> Scene -> render_scene() -> Frame -> Dataset

Names are loaded on first use, so importing the package takes next to no time.
"""

import lazy_loader

# The public names are listed in `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
