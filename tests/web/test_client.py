"""The typed client in examples/ is that of the API."""

import runpy

from metropilot.web import Settings
from metropilot.web.server import make_api
from metropilot.web.service import Service


def test_the_client_is_that_of_the_api(tmp_path):
    made = runpy.run_path("tools/http_client.py")
    text = made["CLIENT"].read_text(encoding="utf-8")
    document = make_api(Service(Settings(data=tmp_path))).openapi()
    assert text == made["client_text"](document), "python tools/http_client.py writes it anew"
    document["components"]["schemas"]["PlanOut"]["properties"]["colour"] = {"type": "string"}
    assert text != made["client_text"](document)
    for methods in document["paths"].values():
        for operation in methods.values():
            assert f"def {operation['operationId'].split('_api_')[0]}(" in text
