"""What a run leaves on disk: the learned beam, its tables, the observations, the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.results.model import (
        Origin as Origin,
        load_instruments as load_instruments,
        load_modulus as load_modulus,
    )
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.results.model": "Origin load_instruments load_modulus",
        },
    )
