"""Who may ask: nobody but the page of this studio, in a browser on this computer that was given the token.

Every request must name this very host (a name on the internet that leads here is refused: DNS rebinding), show the
cookie that the token was exchanged for, and, where it changes something or opens a socket, come from this page
(`Origin`). Bodies are bounded before they are read.
"""

from __future__ import annotations

import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST_BODY = 256 * 1024  # bytes: the longest thing sent is a recording.toml
SAFE_METHODS = ("GET", "HEAD")
REFUSED = "Open the address that `onebend studio` shows in the terminal: it holds the key to this page.\n"


class Guard:
    """An ASGI application that lets through only what it may."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app, self.token, self.port = app, token, port
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self.cookie = f"onebend-studio-{port}"  # cookies do not tell ports apart
        self.session = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        answer = self._refusal(scope, headers)
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
        await self._bounded(scope, receive, with_headers)

    def _refusal(self, scope: Scope, headers: Headers) -> PlainTextResponse | RedirectResponse | None:
        """What is answered instead; None where the request may go on."""
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
        """The token in the address, exchanged for a cookie; None where there is no token, or another."""
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
        """`send`, with the headers that bind the page to itself."""

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

    async def _bounded(self, scope: Scope, receive: Receive, send: Send) -> None:
        """The application, with a body no longer than `LARGEST_BODY`, whatever length it says to have."""
        said = Headers(scope=scope).get("content-length", "0")
        too_large = PlainTextResponse(f"At most {LARGEST_BODY} bytes are taken here.\n", 413)
        if not said.isdecimal() or int(said) > LARGEST_BODY:
            await too_large(scope, receive, send)
            return
        count, begun, cut = 0, False, False

        async def counted() -> Message:
            nonlocal count, cut
            message = await receive()
            count += len(message.get("body", b""))
            cut = cut or count > LARGEST_BODY
            return {"type": "http.disconnect"} if cut else message

        async def noticed(message: Message) -> None:
            nonlocal begun
            if begun or not cut:
                begun = True
                await send(message)

        try:
            await self.app(scope, counted, noticed)
        except Exception:
            if not cut:
                raise
        if cut and not begun:
            await too_large(scope, receive, send)


def _same(one: str, other: str) -> bool:
    """Compared in a time that does not tell where they differ."""
    return secrets.compare_digest(one.encode("utf-8", "replace"), other.encode())
