"""One JSON shape for every error response."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from metropilot.errors import InputError, MetropilotError

FIELDS = ("file", "field", "value", "unit", "allowed")


class Refused(InputError):
    """Refusal of a valid request that cannot be met now, with its HTTP status."""

    def __init__(
        self,
        message: str,
        status: int,
        *,
        field: str | None = None,
        value: object = None,
        allowed: str | None = None,
    ) -> None:
        super().__init__(message, field=field, value=value, allowed=allowed)
        self.status = status

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the status."""
        return Refused, (self.message, self.status), self.__dict__


def detail_of(error: Exception) -> dict[str, Any]:
    """Convert an error to plain values."""
    message = error.message if isinstance(error, InputError) else str(error)
    return {"message": message, **{name: plain(getattr(error, name, None)) for name in FIELDS}}


def error_of(told: Mapping[str, Any]) -> InputError:
    """Convert plain values of :func:`detail_of` back to an error."""
    return InputError(told["message"], **{name: told.get(name) for name in FIELDS})


def plain(value: Any) -> Any:  # noqa: ANN401 (whatever was sent)
    """Convert a value for JSON; a long one is cut."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else str(value)  # noqa: PLR0124
    if not isinstance(value, str):
        try:
            value = json.dumps(value, default=str)
        except (TypeError, ValueError):
            value = str(value)
    return value.encode("utf-8", "replace").decode()[:200]


JSON = "application/json"
METHOD_NOT_ALLOWED = 405


class ErrorDetail(BaseModel):
    """Message, place, value and allowed range of an error, as with ``--json`` on the command line."""

    message: str
    file: str | None = None
    field: str | None = None
    value: Any = None
    unit: str | None = None
    allowed: str | None = None


class ErrorBody(BaseModel):
    """Body of every error response."""

    error: ErrorDetail


def answer(status: int, detail: dict[str, Any]) -> JSONResponse:
    """Make an error response."""
    return JSONResponse({"error": {"message": "", **dict.fromkeys(FIELDS), **detail}}, status_code=status)


def install(app: FastAPI) -> None:
    """Install the exception handlers of an application."""

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        kind = request.headers.get("content-type", "")
        if first["loc"] == ("body",) and isinstance(first.get("input"), bytes):
            value = kind[:80] or None
            told = {"message": "not JSON", "field": "Content-Type", "value": value, "allowed": JSON}
            return answer(415, told)
        if first["type"] == "json_invalid":
            why = str(first.get("ctx", {}).get("error", "")).lower()
            return answer(422, {"message": f"not JSON: {why}", "field": "body", "allowed": "a JSON object"})
        field = _path(first["loc"]) or "body"
        refused = first.get("ctx", {}).get("error")
        if isinstance(refused, InputError):
            return answer(422, detail_of(refused) | {"field": field})
        return answer(422, {"message": first["msg"], "field": field, "value": plain(first.get("input"))})

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        told: dict[str, Any] = {"message": str(error.detail)}
        if error.status_code == METHOD_NOT_ALLOWED:
            allowed = (error.headers or {}).get("Allow")
            told = {"message": "not allowed here", "field": "method", "value": request.method}
            told["allowed"] = allowed
        response = answer(error.status_code, told)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(MetropilotError)
    async def ours(_: Request, error: MetropilotError) -> JSONResponse:
        return answer(getattr(error, "status", 422), detail_of(error))


def _path(parts: Sequence[Any]) -> str:
    """Dotted path of a field without its first part: ``body.line`` becomes ``line``."""
    text = ""
    for part in parts[1:] if parts and parts[0] in {"body", "query", "path", "header"} else parts:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


RESPONSES: dict[int | str, dict[str, Any]] = {
    code: {"model": ErrorBody, "description": words}
    for code, words in {
        400: "not readable",
        401: "no token",
        403: "request from another site, or a change by a viewer",
        404: "not here",
        405: "not this way",
        409: "not now",
        413: "too large",
        415: "not JSON",
        422: "not usable: field, value, unit and what is allowed",
        429: "too much at once, or at the limit of the user",
    }.items()
}
"""Error responses of every route, by status."""
