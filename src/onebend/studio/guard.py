"""Access: only the page of this studio, in a browser on this computer, with the token.

Every request must name this host (against DNS rebinding) and show the cookie; changes and sockets must come from this
page (`Origin`).
"""

from __future__ import annotations

import secrets
from asyncio import BaseTransport, Transport
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_STRANGERS = 64  # connections: as many as a system lets wait
Address = tuple[str, int]
SAFE_METHODS = ("GET", "HEAD")
REFUSED = "Open the address that `onebend studio` shows in the terminal: it holds the key to this page.\n"


class Strangers:
    """Connections on which nobody has shown the cookie yet: of too many the oldest ends, so that there is always room
    for the page."""

    def __init__(self, most: int = MOST_STRANGERS) -> None:
        self._most = most
        self._open: dict[Address, BaseTransport] = {}

    def came(self, transport: BaseTransport) -> None:
        self._open[transport.get_extra_info("peername")] = transport
        if len(self._open) > self._most:
            self._open = {who: one for who, one in self._open.items() if not one.is_closing()}
        while len(self._open) > self._most:
            oldest = self._open.pop(next(iter(self._open)))
            oldest.abort() if isinstance(oldest, Transport) else oldest.close()

    def known(self, who: Address) -> None:
        """The cookie was shown on this connection."""
        self._open.pop(who, None)


class Guard:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app, self.token, self.port = app, token, port
        self.strangers = Strangers()
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self.cookie = f"onebend-studio-{port}"  # cookies ignore ports
        self.session = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        answer = self._refusal(scope, headers)
        if answer is None and scope.get("client"):
            self.strangers.known(tuple(scope["client"]))
        if scope["type"] == "websocket":
            if answer is None:
                await self.app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 1008, "reason": "not from this page"})
            return
        with_headers = self._sealed(send)
        if answer is not None:
            await answer(scope, receive, with_headers)
            return
        await self.app(scope, receive, with_headers)

    def _refusal(self, scope: Scope, headers: Headers) -> PlainTextResponse | RedirectResponse | None:
        """None: allowed."""
        host = headers.getlist("host")
        if len(host) != 1 or host[0] not in self.hosts:
            return PlainTextResponse("This host is not known here.\n", 403)
        origin = headers.get("origin")
        safe = scope["type"] == "http" and scope["method"] in SAFE_METHODS
        if (origin is not None or not safe) and origin != f"http://{host[0]}":
            return PlainTextResponse("Only this page may ask.\n", 403)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return self._first_visit(scope) or PlainTextResponse("Only this page may ask.\n", 403)
        if self._known(headers):
            return self._first_visit(scope)
        return self._first_visit(scope) or PlainTextResponse(REFUSED, 403)

    def _first_visit(self, scope: Scope) -> RedirectResponse | None:
        """Exchanges the token in the address for a cookie; None for a wrong token."""
        if scope["type"] != "http" or scope["path"] != "/" or scope["method"] not in SAFE_METHODS:
            return None
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])
        if len(given) != 1 or not _same(given[0], self.token):
            return None
        answer = RedirectResponse("/", 303)
        answer.set_cookie(self.cookie, self.session, httponly=True, samesite="strict", path="/")
        return answer

    def _known(self, headers: Headers) -> bool:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return False
        return found is not None and _same(found.value, self.session)

    def _sealed(self, send: Send) -> Send:
        """`send` with security headers."""

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = (
                    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
                    f"connect-src 'self' ws://127.0.0.1:{self.port} ws://localhost:{self.port}; "
                    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
                )
                headers["X-Content-Type-Options"] = "nosniff"
                headers["X-Frame-Options"] = "DENY"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cross-Origin-Opener-Policy"] = "same-origin"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers["Cache-Control"] = "no-store"
            await send(message)

        return sealed


def _same(one: str, other: str) -> bool:
    return secrets.compare_digest(one.encode("utf-8", "replace"), other.encode())
