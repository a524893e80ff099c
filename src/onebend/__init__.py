"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want.

Most work needs the functions and records here. The layers of the core are `onebend.beam`, `recording`, `learning`,
`control`, `results`, `records` and `errors`; its wings are `live` (record and learn while a beam is pushed), `many`
(thousands of recordings), `lab` (virtual benches, films, parts to print) and `studio` (a local page).
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
