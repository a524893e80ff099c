"""The tabs that look on, and what is sent to each."""

from __future__ import annotations

import asyncio
import itertools
import json
from typing import Any

from starlette.websockets import WebSocket

from onebend.strict_json import plain

_MOST_WAITING = 64
_ENOUGH = 3  # messages that wait for a slow tab: it does without the next one that passes


class Client:
    """One tab."""

    count = itertools.count(1)

    def __init__(self, socket: WebSocket) -> None:
        self.socket, self.number = socket, next(self.count)
        self.waiting: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def put(self, message: dict[str, Any], *, passing: bool = False) -> None:
        """Send, soon; a tab that takes nothing any more misses it, and asks again when it is back. `passing`: a newer
        one will take its place."""
        size = self.waiting.qsize()
        if size < _MOST_WAITING and not (passing and size > _ENOUGH):
            self.waiting.put_nowait(message)

    async def write(self) -> None:
        while True:
            message = await self.waiting.get()
            await self.socket.send_text(text_of(message))


def text_of(message: dict[str, Any]) -> str:
    """JSON; a number that is not finite as null."""
    try:
        return json.dumps(message, allow_nan=False)
    except ValueError:
        return json.dumps(plain(message), allow_nan=False)
