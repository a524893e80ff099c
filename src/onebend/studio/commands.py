from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Annotated

import typer

from onebend.cli.common import say
from onebend.extras import require

Folder = Annotated[Path, typer.Argument(metavar="DIR")]
Port = Annotated[int, typer.Option(min=0, max=65535, metavar="N")]
NoOpen = Annotated[bool, typer.Option("--no-open")]

NEEDED = ("starlette", "uvicorn", "websockets")


def studio(folder: Folder = Path(), *, port: Port = 0, no_open: NoOpen = False) -> None:
    require(NEEDED, "studio")
    from onebend.studio.server import serve  # here: an optional part

    def ready(address: str) -> None:
        say(f"The studio of {folder.resolve()} is at\n\n  {address}\n\nCtrl-C ends it.")
        if not no_open:
            Thread(target=_shown, args=(address,), daemon=True).start()  # some browsers block their caller

    serve(folder, port=port, ready=ready)


def _shown(address: str) -> None:
    with suppress(webbrowser.Error):  # the address is in the terminal
        webbrowser.open(address)
