"""Data sets: a recipe defines one, a plan numbers its frames, a build renders them, a report shows them.

Names are loaded on first use: frames and worker processes need no checks, exports or reports.
"""

import lazy_loader

# The public names are listed in `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
