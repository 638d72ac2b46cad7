"""The camera: lens, sensor, flash and poses, and the conversion of light to images."""

import lazy_loader

# The public names are listed in `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
