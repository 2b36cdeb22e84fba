"""One error shape for every answer that is not what was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from metropilot.errors import MetropilotError
from metropilot.web.refused import FIELDS, detail_of, plain


class ErrorDetail(BaseModel):
    """What is wrong, where, and what is allowed; the same as the command line prints with ``--json``."""

    message: str
    file: str | None = None
    field: str | None = None
    value: Any = None
    unit: str | None = None
    allowed: str | None = None


class ErrorBody(BaseModel):
    """Every error."""

    error: ErrorDetail


def answer(status: int, detail: dict[str, Any]) -> JSONResponse:
    """An error as an answer."""
    return JSONResponse({"error": {"message": "", **dict.fromkeys(FIELDS), **detail}}, status_code=status)


def install(app: FastAPI) -> None:
    """Let an application answer every error in the one shape."""

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        return answer(422, {"message": first["msg"], "field": _path(first["loc"]), "value": _given(first)})

    @app.exception_handler(HTTPException)
    async def http(_: Request, error: HTTPException) -> JSONResponse:
        response = answer(error.status_code, {"message": str(error.detail)})
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(MetropilotError)
    async def ours(_: Request, error: MetropilotError) -> JSONResponse:
        return answer(getattr(error, "status", 422), detail_of(error))


def _path(parts: Sequence[Any]) -> str:
    """``body.restrictions[0].from_m`` as ``restrictions[0].from_m``."""
    text = ""
    for part in parts[1:] if parts and parts[0] in {"body", "query", "path", "header"} else parts:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _given(found: Any) -> Any:  # noqa: ANN401 (whatever was sent)
    return plain(found.get("input"))


RESPONSES: dict[int | str, dict[str, Any]] = {
    code: {"model": ErrorBody, "description": words}
    for code, words in {
        400: "not readable",
        401: "no token",
        403: "asked from elsewhere",
        404: "not here",
        405: "not this way",
        409: "not now",
        413: "too large",
        415: "not JSON",
        422: "not usable: field, value, unit and what is allowed",
        429: "too much at once",
    }.items()
}
"""For every route."""
