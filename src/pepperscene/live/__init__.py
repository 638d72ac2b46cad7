"""A scene that stays open: views from anywhere, edits, and queries of what is where."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
