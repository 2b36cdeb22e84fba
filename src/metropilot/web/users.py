"""Users of a shared server: their names, roles and tokens, and whose request is being answered."""

from __future__ import annotations

import hmac
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from metropilot._io import read_text
from metropilot.errors import InputError
from metropilot.web.errors import Refused

USER, VIEWER = "user", "viewer"
ROLES = (USER, VIEWER)
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
TOKEN_LENGTH = 16
"""Shortest token."""
NO_TOKEN = "-"
FORM = "NAME = TOKEN, ROLE"


@dataclass(frozen=True)
class User:
    """A user of a server.

    Attributes:
        name: Name; None on a server that names no users.
        role: ``user``, or ``viewer``, who reads everything and changes nothing.
        token: Secret that a browser or program presents; None where only a proxy can name the user.
    """

    name: str | None = None
    role: str = USER
    token: str | None = field(default=None, repr=False)

    @property
    def may_change(self) -> bool:
        """False for a viewer."""
        return self.role != VIEWER

    @property
    def refusal(self) -> dict[str, Any]:
        """Reason for which a viewer is refused, as in an error response."""
        told = {"message": f"{self.name} reads only", "field": "role", "value": self.role}
        return told | {"allowed": f"the role {USER}"}


NOBODY = User()
_PRESENT: ContextVar[User] = ContextVar("user")


def present_user() -> User:
    """User whose request, page or event is being answered; nameless outside of one."""
    return _PRESENT.get(NOBODY)


@contextmanager
def answer_to(user: User) -> Iterator[None]:
    """Answer a user in the body of the context, and in every task that begins there."""
    before = _PRESENT.set(user)
    try:
        yield
    finally:
        _PRESENT.reset(before)


def check_may_change() -> None:
    """Refuse a change by a viewer.

    Raises:
        Refused: The present user reads only (403).
    """
    user = present_user()
    if not user.may_change:
        told = user.refusal
        raise Refused(told["message"], 403, **{name: told[name] for name in ("field", "value", "allowed")})


def find_token(users: Sequence[User], given: str) -> User | None:
    """User of a token; None if it is nobody's. Takes the same time for every wrong one."""
    found = None
    for user in users:
        if user.token is not None and hmac.compare_digest(given.encode(), user.token.encode()):
            found = user
    return found


def read_users(path: Path) -> tuple[User, ...]:
    """Read the users of a server from a file with a line ``NAME = TOKEN, ROLE`` for each.

    The token ``-`` is none: only a proxy can name this user. Empty lines and those that begin with ``#`` are
    left out.

    Args:
        path: The file.

    Raises:
        InputError: It cannot be read, or a line is not allowed; no token is shown.
    """
    users: list[User] = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        where = {"file": path, "field": f"line {number}"}
        name, equals, rest = (part.strip() for part in text.partition("="))
        token, comma, role = (part.strip() for part in rest.rpartition(","))
        if not (equals and comma):
            raise InputError("not a user", **where, allowed=FORM)
        if not NAME.fullmatch(name):
            raise InputError("not a name", **where, value=name[:64], allowed="letters, digits, . _ @ -")
        if role not in ROLES:
            raise InputError("no such role", **where, value=role, allowed=", ".join(ROLES))
        if token != NO_TOKEN and len(token) < TOKEN_LENGTH:
            allowed = f"at least {TOKEN_LENGTH} characters, or {NO_TOKEN} for none"
            raise InputError("token is too short", **where, value=name, allowed=allowed)
        user = User(name, role, None if token == NO_TOKEN else token)
        if any(name == other.name or user.token == other.token is not None for other in users):
            raise InputError("name or token is there twice", **where, value=name)
        users.append(user)
    if not users:
        raise InputError("names no user", file=path, allowed=FORM)
    return tuple(users)
