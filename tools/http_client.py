"""Write examples/client/metropilot_client.py: a typed Python client of the console's HTTP API.

Made from the OpenAPI description: a `TypedDict` for each body, a method for each route, grouped by subject;
the standard library alone. A test fails when the client and the API differ.

    python tools/http_client.py
"""

from __future__ import annotations

import json
import keyword
import re
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import Any

from metropilot.web import Service, Settings, make_api

ROOT = Path(__file__).resolve().parent.parent
CLIENT = ROOT / "examples" / "client" / "metropilot_client.py"
LEFT_OUT = ("ErrorBody", "ErrorDetail", "HTTPValidationError", "ValidationError")
WIDTH = 106
Schema = dict[str, Any]
SIMPLE = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}
SIMPLE["binary"] = "bytes"
HEAD = '''"""Typed client of metropilot's console over HTTP; the standard library alone.

Written by `python tools/http_client.py` from the API's OpenAPI description; do not edit.

    client = Client("http://127.0.0.1:8060")
    plan = client.planning.plan({"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0})
"""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple, NotRequired, TypedDict
from urllib.parse import quote, urlencode
from uuid import uuid4

OVER = ("done", "failed", "stopped", "interrupted")


class ApiError(Exception):
    """Refusal of the server, or failure of a job: one line that says what, where, and what is allowed.

    Attributes:
        status: HTTP status; 0 of a job that failed.
        detail: Message, file, field, value, unit and allowed values.
    """

    def __init__(self, status: int, detail: Mapping[str, Any]) -> None:
        self.status, self.detail = status, dict(detail)
        where = ": ".join(str(detail[key]) for key in ("file", "field") if detail.get(key))
        allowed = f" (allowed: {detail['allowed']})" if detail.get("allowed") else ""
        super().__init__((f"{where}: " if where else "") + str(detail.get("message", "")) + allowed)


class StreamEvent(NamedTuple):
    """An event of a live run.

    Attributes:
        id: Its number, by which a stream goes on.
        kind: ``scene``, ``rows``, ``event``, ``result``, ``error`` or ``end``.
        data: Its values.
    """

    id: int
    kind: str
    data: Any


class Connection:
    """Requests to one server.

    Args:
        url: Address of the server.
        token: Its token; None: it has none.
        timeout_s: Longest wait for an answer.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = 120.0) -> None:
        self.url, self.timeout_s = url.rstrip("/"), timeout_s
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}

    def open(
        self, method: str, path: str, query: Mapping[str, Any], data: bytes | None, kind: str, **more: str
    ) -> Any:
        """Send a request; return the open answer.

        Raises:
            ApiError: The server refused it.
        """
        told = {name: value for name, value in query.items() if value is not None}
        told = {name: str(v).lower() if isinstance(v, bool) else v for name, v in told.items()}
        url = self.url + path + (f"?{urlencode(told)}" if told else "")
        headers = self.headers | more | ({"Content-Type": kind} if data is not None else {})
        try:
            return urllib.request.urlopen(
                urllib.request.Request(url, data, headers, method=method), timeout=self.timeout_s
            )
        except urllib.error.HTTPError as error:
            with error:
                text = error.read().decode("utf-8", "replace")
            try:
                detail = json.loads(text)["error"]
            except (KeyError, TypeError, ValueError):
                detail = {"message": text[:200]}
            raise ApiError(error.code, detail) from None

    def send(self, method: str, path: str, query: Mapping[str, Any], body: Any = None) -> bytes:
        """Send a request with a JSON body, or none; return the answer."""
        data = None if body is None else json.dumps(body).encode()
        with self.open(method, path, query, data, "application/json") as answer:
            return answer.read()

    def send_file(self, method: str, path: str, name: str, content: bytes) -> bytes:
        """Send a file; return the answer."""
        mark = uuid4().hex
        shown = name.replace('"', "_").replace("\\r", "_").replace("\\n", "_")
        head = f'--{mark}\\r\\nContent-Disposition: form-data; name="file"; filename="{shown}"\\r\\n\\r\\n'
        data = head.encode() + content + f"\\r\\n--{mark}--\\r\\n".encode()
        with self.open(method, path, {}, data, f"multipart/form-data; boundary={mark}") as answer:
            return answer.read()

    def listen(self, path: str, last_event_id: int | None) -> Iterator[StreamEvent]:
        """Read events until the stream ends."""
        more = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
        with self.open("GET", path, {}, None, "", **more) as answer:
            number, kind = 0, "message"
            for line in answer:
                name, _, value = line.decode().rstrip("\\r\\n").partition(": ")
                if name == "id":
                    number = int(value)
                elif name == "event":
                    kind = value
                elif name == "data":
                    yield StreamEvent(number, kind, json.loads(value))
'''
TAIL = '''

class Client:
    """Every route of a server.

    Args:
        url: Address of the server.
        token: Its token; None: it has none.
        timeout_s: Longest wait for an answer.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = 120.0) -> None:
        connection = Connection(url, token, timeout_s)
{groups}

    def wait(self, job_id: str, every_s: float = 0.2, longest_s: float = 3600.0) -> JobOut:
        """Wait until a job is done; return it.

        Raises:
            ApiError: It failed, was stopped or interrupted.
            TimeoutError: It is not over yet.
        """
        end = time.monotonic() + longest_s
        while (job := self.jobs.job(job_id))["status"] not in OVER:
            if time.monotonic() > end:
                raise TimeoutError(f"{{job_id}} is {{job['status']}} after {{longest_s:g}} s")
            time.sleep(every_s)
        if job["status"] != "done":
            raise ApiError(0, job["error"] or {{"message": f"{{job_id}}: {{job['status']}}"}})
        return job
'''


def type_of(schema: Schema) -> str:
    """Type hint of a schema."""
    if "$ref" in schema:
        return schema["$ref"].rpartition("/")[2]
    if values := schema.get("enum", [schema["const"]] if "const" in schema else []):
        return f"Literal[{', '.join(json.dumps(value) for value in values)}]"
    if options := schema.get("anyOf", schema.get("oneOf", schema.get("allOf"))):
        return " | ".join(dict.fromkeys(map(type_of, options)))
    kind = "binary" if schema.get("format") == "binary" else schema.get("type")
    if kind == "array":
        kinds = dict.fromkeys(map(type_of, schema.get("prefixItems", [schema.get("items", {})])))
        return f"list[{' | '.join(kinds)}]"
    if kind == "object":
        inside = next(iter(schema.get("patternProperties", {}).values()), schema.get("additionalProperties"))
        return f"dict[str, {type_of(inside) if isinstance(inside, dict) else 'Any'}]"
    return SIMPLE.get(str(kind), "Any")


def docstring(text: str, indent: str) -> str:
    """Docstring of a description."""
    text = text.strip().replace("\\", "\\\\")
    first, _, rest = text.partition("\n\n")
    first = " ".join(first.split())
    parts = textwrap.wrap(first, WIDTH - len(indent) - 6) or [""]
    rest = "\n".join(
        textwrap.fill(" ".join(each.split()), WIDTH - len(indent)) for each in rest.split("\n\n") if each
    )
    lines = parts + (["", *rest.splitlines()] if rest else [])
    if len(lines) == 1:
        return f'{indent}"""{lines[0]}"""\n'
    body = "\n".join(f"{indent}{line}".rstrip() for line in lines[1:])
    return f'{indent}"""{lines[0]}\n{body}\n{indent}"""\n'


def typed_dict(name: str, schema: Schema) -> str:
    """TypedDict of an object's schema."""
    needed, fields = set(schema.get("required", ())), schema.get("properties", {})
    words = schema.get("description") or f"Values of {name}."
    hints = {
        key: type_of(each) if key in needed else f"NotRequired[{type_of(each)}]"
        for key, each in fields.items()
    }
    if all(key.isidentifier() and not keyword.iskeyword(key) for key in hints):
        rows = "".join(f"    {key}: {hint}\n" for key, hint in hints.items())
        return f"\n\nclass {name}(TypedDict):\n{docstring(words, '    ')}\n{rows}"
    rows = "".join(f'    "{key}": "{hint}",\n' for key, hint in hints.items())
    return f'\n\n{name} = TypedDict("{name}", {{\n{rows}}})\n{docstring(words, "")}'


def method(verb: str, path: str, operation: Schema) -> str:
    """Method of a route."""
    name = operation["operationId"].split("_api_")[0]
    places = re.findall(r"{(\w+)}", path)
    kinds = {each["name"]: type_of(each["schema"]) for each in operation.get("parameters", ())}
    given = [f"{place}: {kinds[place]}" for place in places]
    bodies = operation.get("requestBody", {}).get("content", {})
    if "application/json" in bodies:
        given.append(f"body: {type_of(bodies['application/json']['schema'])}")
    elif bodies:
        given += ["name: str", "content: bytes"]
    queries = [each for each in operation.get("parameters", ()) if each["in"] == "query"]
    codes = [code for code in operation["responses"] if code.startswith("2")]
    contents = operation["responses"][codes[0]].get("content", {})
    streams = "text/event-stream" in contents
    keywords = [
        f"{each['name']}: {type_of(each['schema'])}"
        + ("" if "None" in type_of(each["schema"]) else " | None")
        + " = None"
        for each in queries
    ]
    keywords += ["last_event_id: int | None = None"] if streams else []
    arguments = ", ".join(["self", *given, *(["*", *keywords] if keywords else [])])
    target = re.sub(r"{(\w+)}", r"{quote(str(\1), safe='')}", path)
    place = f'f"{target}"' if places else f'"{path}"'
    asked = ", ".join(f'"{each["name"]}": {each["name"]}' for each in queries)
    sent = f'"{verb.upper()}", {place}, {{{asked}}}' + (", body" if "application/json" in bodies else "")
    call = f"self.connection.send({sent})"
    if bodies and "application/json" not in bodies:
        call = f'self.connection.send_file("{verb.upper()}", {place}, name, content)'
    if streams:
        answer, act = "Iterator[StreamEvent]", f"return self.connection.listen({place}, last_event_id)"
    elif codes[0] == "204":
        answer, act = "None", call
    elif "application/json" in contents:
        answer, act = type_of(contents["application/json"]["schema"]), f"return json.loads({call})"
    elif "text/plain" in contents:
        answer, act = "str", f"return {call}.decode()"
    else:
        answer, act = "bytes", f"return {call}"
    words = operation.get("description") or operation.get("summary", name)
    return f"\n    def {name}({arguments}) -> {answer}:\n{docstring(words, ' ' * 8)}        {act}\n"


def client_text(document: Schema) -> str:
    """Source text of the client.

    Args:
        document: OpenAPI description.
    """
    schemas = document["components"]["schemas"]
    groups: dict[str, list[str]] = {}
    for path, methods in document["paths"].items():
        for verb, operation in methods.items():
            tag = operation.get("tags", ["server"])[-1]
            groups.setdefault(tag, []).append(method(verb, path, operation))
    parts = [HEAD]
    for name, schema in sorted(schemas.items()):
        if name in LEFT_OUT or name.startswith("Body_"):
            continue
        parts.append(typed_dict(name, schema) if "properties" in schema else alias(name, schema))
    for tag, methods in groups.items():
        names = [re.findall(r"def (\w+)", text)[0] for text in methods]
        assert len(set(names)) == len(names), (tag, names)
        head = f'    """Routes of {tag}."""\n\n    def __init__(self, connection: Connection) -> None:\n'
        parts.append(
            f"\n\nclass {tag.capitalize()}:\n{head}        self.connection = connection\n" + "".join(methods)
        )
    made = "\n".join(f"        self.{tag} = {tag.capitalize()}(connection)" for tag in groups)
    return format_source("".join([*parts, TAIL.format(groups=made)]))


def alias(name: str, schema: Schema) -> str:
    """Alias of a schema that is no object with fields."""
    return f"\n\n{name} = {type_of(schema)}\n{docstring(schema.get('description', name), '')}"


def format_source(text: str) -> str:
    """Format Python source as ruff does."""
    command = [Path(sys.executable).with_name("ruff"), "format", "--stdin-filename", CLIENT, "-"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout


def describe_api() -> Schema:
    """OpenAPI description of a server."""
    with tempfile.TemporaryDirectory() as folder:
        return make_api(Service(Settings(data=Path(folder)))).openapi()


def main() -> None:
    """Write the client."""
    CLIENT.write_text(client_text(describe_api()), encoding="utf-8")


if __name__ == "__main__":
    main()
