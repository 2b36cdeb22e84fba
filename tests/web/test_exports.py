"""A learned driver as C, by a job; what cannot be exported is refused at once."""

import io
import zipfile

import pytest
from tests.web.test_api import SECTION, refusal_of


def test_a_driver_is_written_as_c(server):
    job = server.post("/api/jobs/export", {**SECTION, "driver": "ppo", "number": "float"}, code=202)["id"]
    row = server.wait(job)
    content = server.client.get(f"/api/jobs/{job}/files/run.zip").content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name.rpartition("/")[2]: archive.read(name).decode() for name in archive.namelist()}
    assert row["summary"]["outcome"] == f"{len(files)} files"
    assert {"ppo.c", "ppo.h", "Makefile", "vectors.csv"} <= set(files)
    assert files["vectors.csv"].startswith("section,time_s,position_m,speed_mps")
    assert files["vectors.csv"].count("\n") > 100
    assert "float" in files["ppo.h"]
    assert str(server.data) not in "".join(files.values())


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"driver": "pid"}, "driver"),
        ({"driver": "../ppo"}, "driver"),
        ({"driver": "learned:policy=nobody"}, "options.policy"),
        ({"line": "nowhere"}, "line"),
        ({"trainset": "/etc/passwd"}, "trainset"),
        ({"origin": "RJ", "destination": "nowhere"}, "station"),
        ({"number": "int"}, "number"),
        ({"to": "exe"}, "to"),
    ],
)
def test_what_cannot_be_exported_is_refused_at_once(server, body, field):
    refusal_of(server.post("/api/jobs/export", body, code=422), field)
