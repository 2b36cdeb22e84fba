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
from metropilot.web.words.language import N_

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


OFFERS = {
    ", or a path ending in .toml or .json": "",
    "--set policy=PATH or learned:policy=PATH, a policy file, or a learning run (folder or id)": (
        "the id of a learning run or of an uploaded policy"
    ),
}
"""What the library allows and a request cannot send: no file of the server is named over HTTP."""


def http_detail_of(error: Exception) -> dict[str, Any]:
    """Convert an error to plain values with the names that a request has."""
    told = detail_of(error)
    if told["field"] == "set" or str(told["field"]).startswith("set "):
        told["field"] = told["field"].replace("set", "options", 1).replace(" ", ".", 1)
    for words, other in OFFERS.items():
        if told["allowed"]:
            told["allowed"] = told["allowed"].replace(words, other)
    return told


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
UNREADABLE, METHOD_NOT_ALLOWED = 400, 405
OUT_OF_RANGE = "out of range"
WRONG_KIND = (
    ("int_", N_("not a whole number"), N_("a whole number")),
    ("float_", N_("not a number"), N_("a number")),
    ("finite_", N_("not a number"), N_("a finite number")),
    ("bool_", N_("wrong kind of value"), N_("true or false")),
    ("string_", N_("wrong kind of value"), N_("text")),
    ("list_", N_("wrong kind of value"), N_("a list")),
    ("tuple_", N_("wrong kind of value"), N_("a list")),
    ("dict_", N_("wrong kind of value"), N_("an object")),
    ("model_", N_("wrong kind of value"), N_("an object")),
)
"""Errors of pydantic by the beginnings of their types: message, and what is allowed."""
BOUNDS = {"ge": ">= {}", "gt": "> {}", "le": "<= {}", "lt": "< {}"}
LENGTHS = {"min_length": N_("at least {count}"), "max_length": N_("at most {count}")}


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


def refusal_of(
    errors: Sequence[Mapping[str, Any]], body: object, kind: type[BaseModel] | None = None
) -> InputError:
    """Translate the errors of pydantic about the first field that cannot be used.

    Args:
        errors: Errors, as ``ValidationError.errors()`` has them.
        body: What was validated; None where only the places of the errors are known.
        kind: Type of the request, where it is known: its fields are those allowed for an unknown key.
    """
    field, first = place_of(errors[0], body), errors[0]
    about = [each for each in errors if place_of(each, body) == field]
    for each in about:
        refused = each.get("ctx", {}).get("error")
        if isinstance(refused, InputError):
            return InputError(
                refused.message, field=field, value=refused.value, unit=refused.unit, allowed=refused.allowed
            )
    told = [_translate(each) for each in about]
    # of a field that takes several kinds: the one of which it is, else all
    message = next((words for words, _ in told if words == OUT_OF_RANGE), told[0][0])
    allowed = list(dict.fromkeys(words for _, words in told if words))
    if first["type"] == "extra_forbidden" and kind is not None and len(first["loc"]) == 1:
        allowed = [", ".join(each.alias or name for name, each in kind.model_fields.items())]
    value = None if first["type"] in {"missing", "finite_number"} else plain(first.get("input"))
    return InputError(message, field=field or "body", value=value, allowed=" or ".join(allowed) or None)


def place_of(error: Mapping[str, Any], body: object) -> str:
    """Dotted path of the field that an error is about, without pydantic's names of kinds."""
    parts: list[Any] = []
    known, at = body is not None, body
    for part in error["loc"]:
        if known:
            inside = isinstance(at, Mapping) and part in at
            inside |= isinstance(at, list | tuple) and isinstance(part, int) and part < len(at)
            if not inside and not (error["type"] == "missing" and part == error["loc"][-1]):
                continue
            at = at[part] if inside else None  # pyright: ignore[reportIndexIssue, reportOptionalSubscript]
        parts.append(part)
    return _path(parts)


def _translate(error: Mapping[str, Any]) -> tuple[str, str]:
    """Message of an error of pydantic, and what is allowed."""
    kind, limits = str(error["type"]), error.get("ctx", {})
    bounds = [words.format(limits[name]) for name, words in BOUNDS.items() if name in limits]
    lengths = [words.format(count=limits[name]) for name, words in LENGTHS.items() if name in limits]
    if bounds:
        told = OUT_OF_RANGE, bounds[0]
    elif lengths:
        told = N_("too long") if "max_length" in limits else N_("too short"), lengths[0]
    elif kind == "literal_error":
        told = N_("unknown value"), str(limits["expected"]).replace("'", "")
    elif kind == "string_pattern_mismatch" and limits["pattern"].startswith("^[^"):
        told = N_("not a name"), N_("text without control characters")
    elif kind == "string_pattern_mismatch":
        told = N_("not an id"), N_("letters, digits, - and _")
    elif "UploadFile" in error["msg"]:
        told = N_("wrong kind of value"), N_("a file")
    else:
        other = str(error["msg"]).removeprefix("Value error, ")
        known = {"missing": N_("missing"), "extra_forbidden": N_("unknown key")}
        kinds = (each[1:] for each in WRONG_KIND if kind.startswith(each[0]))
        told = next(kinds, (known.get(kind, other), ""))
    return told


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
        place, found = first["loc"][:1], error.errors()
        if place == ("body",):
            found = [each | {"loc": each["loc"][1:]} for each in found if each["loc"][:1] == place]
            wanted = getattr(request.scope.get("route"), "body_field", None)
            shape = wanted.field_info.annotation if wanted else None
            shape = shape if isinstance(shape, type) and issubclass(shape, BaseModel) else None
            return answer(422, detail_of(refusal_of(found, error.body, shape)))
        found = [each | {"loc": each["loc"][1:]} for each in found]
        return answer(422, detail_of(refusal_of(found, None)))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        told: dict[str, Any] = {"message": str(error.detail)}
        if error.status_code == UNREADABLE:
            told = {"message": "not JSON", "field": "body", "allowed": "a JSON object"}
        if error.status_code == METHOD_NOT_ALLOWED:
            allowed = (error.headers or {}).get("Allow")
            told = {"message": "not allowed here", "field": "method", "value": request.method}
            told["allowed"] = allowed
        response = answer(error.status_code, told)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(MetropilotError)
    async def ours(_: Request, error: MetropilotError) -> JSONResponse:
        return answer(getattr(error, "status", 422), http_detail_of(error))


def _path(parts: Sequence[Any]) -> str:
    """Dotted path of a field."""
    text = ""
    for part in parts:
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
