"""The command that opens the studio."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Annotated

import typer

from onebend.cli.common import clean_errors, say
from onebend.extras import require

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder with your recordings and results.")]
Port = Annotated[int, typer.Option(min=0, max=65535, metavar="N", help="Port on 127.0.0.1; default: a free one.")]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Print the address only.")]

NEEDED = ("starlette", "uvicorn", "websockets")


def studio(folder: Folder = Path(), *, port: Port = 0, no_open: NoOpen = False) -> None:
    """Open a local page: record, learn, look at results, bend learned beams with the pointer, rehearse loops.

    It is served on this computer alone, to whoever has the address with its token. Ctrl-C ends it; a film that is being
    recorded then ends and is kept, and a recording that is being learned is stopped, and what was found of it is kept.
    """
    with clean_errors():
        require(NEEDED, "studio")
        from onebend.studio.server import serve  # here: it is an optional part

        def ready(address: str) -> None:
            say(f"The studio of {folder.resolve()} is at\n\n  {address}\n\nCtrl-C ends it.")
            if not no_open:
                Thread(target=_shown, args=(address,), daemon=True).start()  # some browsers hold on to who calls them

        serve(folder, port=port, ready=ready)


def _shown(address: str) -> None:
    with suppress(webbrowser.Error):  # the address stands in the terminal
        webbrowser.open(address)
