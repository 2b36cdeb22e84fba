"""The API called as its own description says it may be called, and as it says it may not: never a 500."""

import os

import schemathesis
from hypothesis import HealthCheck, Phase, given, settings

from metropilot.web import Settings
from metropilot.web.server import make_api
from metropilot.web.service import Service

EXAMPLES = int(os.environ.get("METROPILOT_FUZZ", "6"))
"""Cases an operation; METROPILOT_FUZZ=200 looks longer."""
LEFT_OUT = r"/api/live/\{live_id\}/stream|/api/jobs/(learn|study)"
"""A stream does not end by itself, and learning takes minutes."""


def test_never_a_500(server):
    described = schemathesis.openapi.from_url(f"{server.url}/api/openapi.json").exclude(path_regex=LEFT_OUT)
    seen = set()
    for found in described.get_all_operations():
        operation = found.ok()

        @given(case=operation.as_strategy())
        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.explicit, Phase.generate],
        )
        def attack(case):
            answer = case.call(base_url=server.url, timeout=60)
            seen.add(answer.status_code)
            asked = (case.method, case.path, case.path_parameters, case.query, case.body)
            assert answer.status_code < 500, (asked, answer.text)
            if answer.status_code >= 400:
                error = answer.json()["error"]
                assert set(error) == {"message", "file", "field", "value", "unit", "allowed"}, asked
                assert "Traceback" not in str(error), asked
                assert str(server.data) not in str(error), asked

        attack()
    # those that wait first: they would start
    for live in sorted(server.get("/api/live"), key=lambda live: live["status"]):
        if live["status"] in {"queued", "running"}:
            stopped = server.client.post(f"/api/live/{live['id']}/stop")
            assert stopped.status_code in {200, 409}, stopped.text  # it may have ended by itself
    for job in server.get("/api/jobs"):
        server.post(f"/api/jobs/{job['id']}/stop")
    assert {200, 404, 422} <= seen
    assert server.get("/api/health")["version"]


def test_every_route_is_described(tmp_path):
    app = make_api(Service(Settings(data=tmp_path)))
    document = app.openapi()
    assert document["info"]["title"] == "metropilot"
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            ok = [code for code in operation["responses"] if code.startswith("2")]
            assert ok, (path, method)
            content = operation["responses"][ok[0]].get("content", {})
            typed = ok[0] == "204" or any(part.get("schema") for part in content.values())
            assert typed or "files" in path, (path, method)
            assert operation.get("description") or operation.get("summary")
