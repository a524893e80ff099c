"""Closed loops with a real robot and a camera: a learned beam bent to a goal, watched, recorded, let go."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
