"""Reference page of the API, made from its OpenAPI document without external scripts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from itertools import groupby
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse

from metropilot.web.errors import plain

STYLE = """
:root { color-scheme: light dark; --line: #8885; --soft: #5a6673; --link: #005f99; }
:root { background: #fff; color: #1c2530; }
@media (prefers-color-scheme: dark) {
  :root { --soft: #a3afbc; --link: #6cc1f2; background: #12171d; color: #e7ecf1; }
}
a { color: var(--link); }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; text-transform: capitalize; }
details { border: 1px solid var(--line); border-radius: 6px; padding: .5rem .8rem; margin: .4rem 0; }
summary { cursor: pointer; overflow-wrap: anywhere; }
code { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .9em; }
table { border-collapse: collapse; width: 100%; font-size: .9em; display: block; overflow-x: auto; }
th, td { text-align: left; vertical-align: top; padding: .25rem .6rem .25rem 0; }
td { border-top: 1px solid var(--line); }
pre { background: #8881; border-radius: 6px; padding: .5rem .7rem; white-space: pre-wrap; }
pre { overflow-wrap: anywhere; }
.m { font-weight: 700; display: inline-block; min-width: 4.2rem; } .s { color: var(--soft); }
"""
PARTS = {
    "line_id": "yizhuang",
    "trainset_id": "dkz32",
    "upload_id": "$UPLOAD",
    "job_id": "$JOB",
    "other_id": "$OTHER",
    "campaign_id": "leaderboard",
    "row": "12",
    "figure": "plans.png",
    "project_id": "$PROJECT",
    "live_id": "$LIVE",
    "run_id": "$RUN",
    "study_id": "lu2023",
    "name": "run.zip",
}
"""Parts of a path in the examples; those with $ were answered before."""
BOUNDS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
    "minLength": "at least {} characters",
    "maxLength": "at most {} characters",
    "maxItems": "at most {}",
    "minItems": "at least {}",
    "pattern": "like {}",
}
Schema = dict[str, Any]


def routes(app: FastAPI) -> APIRouter:
    """Make the route of the reference page."""
    router = APIRouter()

    @router.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        """Reference of the API."""
        return HTMLResponse(page(app.openapi()))

    return router


def page(document: Schema) -> str:
    """Make the page of an OpenAPI document.

    Args:
        document: As at ``/api/openapi.json``.
    """
    info, schemas = document["info"], document["components"]["schemas"]
    found = [
        (operation.get("tags", ["server"])[0], method, path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    found.sort(key=lambda row: row[0])
    title = f"{info['title']} {info['version']}: the HTTP API"
    parts = [
        f"<h1>{escape(title)}</h1><p>{escape(info['description'])}</p>",
        '<p>For programs: <a href="/api/openapi.json">/api/openapi.json</a>.</p>',
    ]
    for tag, rows in groupby(found, key=lambda row: row[0]):
        parts.append(f"<h2>{escape(tag)}</h2>")
        parts += [_operation(method, path, operation, schemas) for _, method, path, operation in rows]
    parts.append("<h2>what is sent and answered</h2>")
    parts += [_model(name, schema) for name, schema in sorted(schemas.items())]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}'
    head += f"</title><style>{STYLE}</style>"
    body = "".join(parts)
    return f'<!doctype html><html lang="en"><head>{head}</head><body><main>{body}</main></body></html>'


def command(method: str, path: str, operation: Schema, schemas: Schema) -> str:
    """Example of a call with curl, the server at ``$URL``.

    Args:
        method: Of the operation.
        path: Its path.
        operation: Its description.
        schemas: Bodies by name, with their examples.
    """
    words = ["curl -s"] + ([f"-X {method.upper()}"] if method not in {"get", "post"} else [])
    words.append("$URL" + path.format(**PARTS))
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        if kind != "application/json":
            words.append(f"-F file=@{'project.zip' if 'archive' in path else 'line.toml'}")
            continue
        body = schemas[content["schema"]["$ref"].rpartition("/")[2]]["examples"][0]
        words.append(f"--json '{json.dumps(body)}'")
    if method == "post" and "requestBody" not in operation:
        words.insert(1, "-X POST")
    return " ".join(words)


def _operation(method: str, path: str, operation: Schema, schemas: Schema) -> str:
    words = operation.get("description") or operation.get("summary", "")
    first, _, _ = words.partition("\n")
    rows = [
        (p["name"], p["schema"], f"in the {p['in']}", p.get("required", False))
        for p in operation.get("parameters", [])
    ]
    body = "".join(
        f"<p>Body ({escape(kind)}): {_kind(content['schema'])}</p>"
        for kind, content in operation.get("requestBody", {}).get("content", {}).items()
    )
    answers = "".join(_answer(code, answer) for code, answer in operation["responses"].items())
    return (
        f'<details><summary><span class="m">{method.upper()}</span><code>{escape(path)}</code> '
        f'<span class="s">{escape(first)}</span></summary><p>{escape(words)}</p>'
        f"<pre><code>{escape(command(method, path, operation, schemas))}</code></pre>"
        f"{_table(rows)}{body}<table tabindex=0>{answers}</table></details>"
    )


def _answer(code: str, answer: Schema) -> str:
    kinds = [_kind(c["schema"]) for c in answer.get("content", {}).values() if c.get("schema")]
    words = escape(answer.get("description", ""))
    return f"<tr><td><b>{escape(code)}</b></td><td>{words}</td><td>{', '.join(kinds)}</td></tr>"


def _model(name: str, schema: Schema) -> str:
    needed = schema.get("required", [])
    rows = [(key, value, "", key in needed) for key, value in schema.get("properties", {}).items()]
    words = escape(schema.get("description", ""))
    return (
        f'<details id="{escape(name)}"><summary><code>{escape(name)}</code></summary>'
        f"<p>{words}</p>{_table(rows)}</details>"
    )


def _table(rows: list[tuple[str, Schema, str, bool]]) -> str:
    """Table of fields: name, type, allowed values and default."""
    cells = [
        f"<tr><td><code>{escape(name)}</code></td><td>{_kind(schema)}</td>"
        f"<td>{escape(', '.join([*([where] if where else []), *_bounds(schema)]))}</td>"
        f"<td>{'needed' if needed else _default(schema)}</td></tr>"
        for name, schema, where, needed in rows
    ]
    return f"<table tabindex=0>{''.join(cells)}</table>" if cells else ""


def _default(schema: Schema) -> str:
    return f"else {escape(str(plain(schema['default'])))}" if schema.get("default") is not None else ""


def _kind(schema: Schema) -> str:
    """Type of a schema, with a link where it has a name."""
    if "$ref" in schema:
        name = escape(schema["$ref"].rpartition("/")[2])
        return f'<a href="#{name}">{name}</a>'
    if options := schema.get("anyOf") or schema.get("oneOf"):
        return " or ".join(_kind(option) for option in options)
    if "enum" in schema or "const" in schema:
        return escape(", ".join(str(x) for x in schema.get("enum", [schema.get("const")])))
    if schema.get("type") == "array":
        return f"list of {_kind(schema.get('items', {}))}"
    return escape(str(schema.get("type", "anything")))


def _bounds(schema: Schema) -> Iterator[str]:
    for part in (schema, *schema.get("anyOf", ())):
        yield from (words.format(part[key]) for key, words in BOUNDS.items() if key in part)
        if "description" in part and "$ref" not in part:
            yield part["description"]
