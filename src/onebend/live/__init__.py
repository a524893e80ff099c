"""k(s) while a beam is pushed: cameras and force sensors, a recorder, and a learner that follows frame by frame."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
