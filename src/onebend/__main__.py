"""`python -m onebend`, and the program `onebend`."""

from __future__ import annotations

import sys


def main() -> None:
    """The program. An interrupt while it is being loaded ends it without a traceback."""
    try:
        from onebend.cli import main as begin
    except KeyboardInterrupt:
        sys.exit(130)
    begin()


if __name__ == "__main__":
    main()
