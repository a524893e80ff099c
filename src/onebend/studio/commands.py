from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from threading import Thread

from onebend.cli.common import say
from onebend.extras import require

NEEDED = ("starlette", "uvicorn", "websockets")


def studio(folder: Path = Path(), *, port: int = 0, no_open: bool = False) -> None:
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
