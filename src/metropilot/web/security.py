"""ASGI middleware that checks host, origin, user, role and size of every request."""

from __future__ import annotations

from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from metropilot.web.errors import answer
from metropilot.web.settings import LOOPBACK, Settings
from metropilot.web.users import NAME, VIEWER, User, answer_to, find_token
from metropilot.web.words.language import answer_in, language_of

COOKIE = "metropilot_token"
SAFE = ("GET", "HEAD", "OPTIONS")
READING = ("/api/section", "/api/plan", "/api/front", "/api/journey", "/_nicegui_ws/")
"""Beginnings of paths that change nothing, whatever the method: what is computed and answered at once, and
the channel of the pages, whose buttons the service refuses to a viewer."""
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
        user = self._user_of(scope)
        refusal = self._refusal(scope, user)
        if refusal is None:
            with answer_to(user or User()), answer_in(language_of(Headers(scope=scope))):
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

    def _user_of(self, scope: Scope) -> User | None:
        """User who sends a request; None: one of this server is needed and it is nobody's."""
        settings, headers = self.settings, Headers(scope=scope)
        if settings.user_header is not None and settings.trusts(_peer(scope)):
            name = headers.get(settings.user_header)
            if name is not None:
                return self._find_named(name)
        if not (settings.token or settings.names_users):
            return User()
        return self._of_token(_given_token(headers))

    def _find_named(self, name: str) -> User | None:
        """User whom a proxy names; where a file lists the users, others read only."""
        if not NAME.fullmatch(name):
            return None
        listed = {user.name: user for user in self.settings.users}
        return listed.get(name) or (User(name, VIEWER) if listed else User(name))

    def _of_token(self, given: str) -> User | None:
        shared = (User(token=self.settings.token),) if self.settings.token else ()
        return find_token((*self.settings.users, *shared), given)

    def _refusal(self, scope: Scope, user: User | None) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self.settings.is_local and _name(host) not in (*LOOPBACK, *self.settings.public_hosts):
            return answer(403, {"message": "request for another host", "field": "Host", "value": host[:80]})
        origin = headers.get("origin")
        unsafe = scope["type"] == "websocket" or scope["method"] not in SAFE
        if origin is not None and unsafe and urlsplit(origin).netloc != host:
            return answer(
                403, {"message": "request from another site", "field": "Origin", "value": origin[:80]}
            )
        if user is None:
            return self._welcome(scope)
        if not user.may_change and unsafe and not scope["path"].startswith(READING):
            return answer(403, user.refusal)
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

    def _welcome(self, scope: Scope) -> Response:
        """Turn ``?token=`` of a browser into a cookie by a redirect; refuse other requests."""
        if scope["type"] == "http" and scope["method"] == "GET":
            request = Request(scope)
            query = dict(parse_qsl(request.url.query))
            given = query.pop("token", "")
            if self._of_token(given) is not None:
                path = "/" + request.url.path.lstrip("/\\")
                response = RedirectResponse(path + (f"?{urlencode(query)}" if query else ""), 303)
                # behind a proxy with TLS the cookie is sent over TLS only
                secure = self.settings.trusts(_peer(scope)) and (
                    request.headers.get("x-forwarded-proto") == "https"
                )
                told = {"httponly": True, "samesite": "strict", "max_age": 30 * 86_400, "secure": secure}
                response.set_cookie(COOKIE, given, **told)
                return response
        if scope["path"].startswith("/api"):
            if self.settings.token or any(user.token for user in self.settings.users):
                told = {"message": "a token is needed", "field": "Authorization", "allowed": "Bearer TOKEN"}
            else:
                told = {"message": "no user is named", "field": self.settings.user_header}
                told["allowed"] = "a name, set by the trusted proxy"
            return answer(401, told)
        return PlainTextResponse(
            "metropilot: sign in at the proxy, or open the address with ?token=... once\n", 401
        )


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


def _peer(scope: Scope) -> str | None:
    """Address of the machine at the other end of the connection."""
    client = scope.get("client")
    return client[0] if client else None


def _given_token(headers: Headers) -> str:
    """Token of a request, from its header or cookie; empty if there is none."""
    bearer = headers.get("authorization", "")
    if bearer.startswith("Bearer "):
        return bearer.removeprefix("Bearer ")
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return found.value if found else ""


def _name(host: str) -> str:
    """Host without port and brackets: ``[::1]:8060`` becomes ``::1``."""
    name, _, port = host.rpartition(":")
    name = name if name and port.isdigit() else host
    return name.strip("[]").lower()
