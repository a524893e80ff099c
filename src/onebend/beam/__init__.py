"""Pure mechanics of a planar slender beam, on arrays: no file, no camera, no estimation."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
