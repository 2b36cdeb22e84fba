"""ASGI middleware that checks host, origin, token and size of every request."""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from metropilot.web.errors import answer
from metropilot.web.settings import LOOPBACK, Settings

COOKIE = "metropilot_token"
SAFE = ("GET", "HEAD", "OPTIONS")
OVERHEAD = 10_000
"""Bytes that a multipart upload adds to its file."""
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval';"
    " style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:;"
    " connect-src 'self' ws: wss:;"
    " frame-ancestors 'none'; base-uri 'self'; form-action 'self'; object-src 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
"""Headers of every response; they forbid a browser to load anything from another host."""


class Guard:
    """Middleware around an application.

    Args:
        app: The application.
        settings: Host, token and bounds.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in {"http", "websocket"}:
            await self.app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is None:
            await self._through(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refusal(scope, receive, send)

    async def _through(self, scope: Scope, receive: Receive, send: Send) -> None:
        bounded = Bounded(receive, self._largest_body_bytes(scope))
        try:
            await self.app(scope, bounded, _with_headers(send))
        except RuntimeError:
            # Starlette's "No response returned": the client closed the connection before there was an answer.
            if not bounded.left:
                raise

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self.settings.is_local and _name(host) not in LOOPBACK:
            return answer(403, {"message": "request for another host", "field": "Host", "value": host[:80]})
        origin = headers.get("origin")
        unsafe = scope["type"] == "websocket" or scope["method"] not in SAFE
        if origin is not None and unsafe and urlsplit(origin).netloc != host:
            return answer(
                403, {"message": "request from another site", "field": "Origin", "value": origin[:80]}
            )
        if self.settings.token is not None and not self._presents(scope, headers):
            return self._welcome(scope)
        length = headers.get("content-length", "0")
        largest = self._largest_body_bytes(scope)
        if scope["type"] == "http" and (not length.isdigit() or int(length) > largest):
            limit = f"at most {largest} bytes"
            return answer(413, {"message": "too large", "value": length[:20], "allowed": limit})
        return None

    def _largest_body_bytes(self, scope: Scope) -> int:
        if scope["path"].startswith(("/api/projects/archive", "/_nicegui/client/")):
            return self.settings.archive_bytes + OVERHEAD
        if scope["path"].startswith("/api/uploads"):
            return max(self.settings.upload_bytes, self.settings.log_bytes) + OVERHEAD
        return self.settings.request_bytes

    def _presents(self, scope: Scope, headers: Headers) -> bool:
        bearer = headers.get("authorization", "")
        given = bearer.removeprefix("Bearer ") if bearer.startswith("Bearer ") else ""
        if not given:
            try:
                given = SimpleCookie(headers.get("cookie", "")).get(COOKIE, None)
                given = given.value if given else ""
            except CookieError:
                given = ""
        del scope
        return hmac.compare_digest(given.encode(), (self.settings.token or "").encode())

    def _welcome(self, scope: Scope) -> Response:
        """Turn ``?token=`` of a browser into a cookie by a redirect; refuse other requests."""
        if scope["type"] == "http" and scope["method"] == "GET":
            request = Request(scope)
            query = dict(parse_qsl(request.url.query))
            given = query.pop("token", "")
            if hmac.compare_digest(given.encode(), (self.settings.token or "").encode()):
                path = "/" + request.url.path.lstrip("/\\")
                response = RedirectResponse(path + (f"?{urlencode(query)}" if query else ""), 303)
                response.set_cookie(COOKIE, given, httponly=True, samesite="strict", max_age=30 * 86_400)
                return response
        if scope["path"].startswith("/api"):
            return answer(
                401, {"message": "a token is needed", "field": "Authorization", "allowed": "Bearer TOKEN"}
            )
        return PlainTextResponse("metropilot: open the address with ?token=... once\n", 401)


class Bounded:
    """Receiver that ends the body of a request where it grows too large, whatever its declared length."""

    def __init__(self, receive: Receive, bound: int) -> None:
        self.receive = receive
        self.bound = bound
        self.seen = 0
        self.left = False

    async def __call__(self) -> Message:
        """The next message."""
        message = await self.receive()
        self.left = self.left or message["type"] == "http.disconnect"
        if message["type"] == "http.request":
            self.seen += len(message.get("body", b""))
            if self.seen > self.bound:
                return {"type": "http.disconnect"}
        return message


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return send_with_headers


def _name(host: str) -> str:
    """Host without port and brackets: ``[::1]:8060`` becomes ``::1``."""
    name, _, port = host.rpartition(":")
    name = name if name and port.isdigit() else host
    return name.strip("[]").lower()
