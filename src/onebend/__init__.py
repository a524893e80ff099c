"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want.

Most work needs the verbs and records here. The rest is in `onebend.beam`, `recording`, `learning`, `control`, `lab`
(beams that do not exist or are still to be made), `design` (which push to make next), `paper` (the paper's own
regression), `forecast`, `streaming` (a camera and a sensor that still run), `results`, `records` and `errors`.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
