"""Names over HTTP are ids: whatever a field holds, no file of the server is opened for it."""

import asyncio
import shutil
import sqlite3

import httpx
import pytest

from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.evaluate import option_defaults
from metropilot.policy import shipped_policy
from metropilot.railway import load_line, load_trainset, write_line, write_trainset
from metropilot.web import Settings
from metropilot.web.schemas.requests import DriveIn
from metropilot.web.server import make_api
from metropilot.web.service import Service
from metropilot.web.store import JobStore

RUN = "ppo-20260101-120000-ab12"
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}


@pytest.fixture
def service(tmp_path, monkeypatch):
    """A server's work in a folder that has files of every kind, under names of every kind."""
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "data"
    made = Service(Settings(data=data))
    run = data / "runs" / RUN
    run.mkdir(parents=True)
    shutil.copyfile(shipped_policy("ppo"), run / "policy.safetensors")
    for name in ("plain", "secret.safetensors"):
        shutil.copyfile(shipped_policy("ppo"), tmp_path / name)
    write_line(load_line("yizhuang"), tmp_path / "mine.toml")
    write_trainset(load_trainset("dkz32"), tmp_path / "mine_trainset.toml")
    (tmp_path / "linked").symlink_to(tmp_path / "plain")
    (tmp_path / "run").mkdir()
    shutil.copyfile(shipped_policy("ppo"), tmp_path / "run" / "policy.safetensors")
    (data / "runs" / "away").symlink_to(tmp_path / "run")
    return made


def names(service):
    """Every way to name a file that is there and not to be opened."""
    root = service.root.parent
    return (
        *("plain", "linked", "run", "away", "mine.toml", "mine_trainset.toml", "secret.safetensors", "."),
        *(
            str(root / "plain"),
            str(root / "mine.toml"),
            str(root / "run"),
            f"../runs/{RUN}",
            f"./{RUN}",
            "..",
        ),
        *(f"~/{RUN}", f"{RUN}/policy.safetensors", f"{RUN}%00", "file:///etc/passwd", "C:\\boot.ini", ""),
    )


def bodies(name):
    """A name in every field that may be one."""
    drive = {f: {**SECTION, f: name} for f in ("line", "origin", "destination", "trainset", "load", "driver")}
    for driver in map(DRIVERS.get, DRIVERS.ids()):
        texts = [key for key, value in option_defaults(driver).items() if value == ""]
        for key in texts:
            drive[f"{driver.id} {key}"] = {**SECTION, "driver": driver.id, "options": {key: name}}
    drive["driver:policy"] = {**SECTION, "driver": f"learned:policy={name}"}
    yield from (("/api/jobs/drive", body) for body in drive.values())
    yield from (("/api/live", drive[key]) for key in ("line", "trainset", "driver", "learned policy"))
    yield from (("/api/convoys", drive[key]) for key in ("line", "trainset", "driver", "driver:policy"))
    yield "/api/convoys", {**SECTION, "follower": name}
    yield "/api/jobs/compare", {**SECTION, "drivers": [name]}
    yield "/api/jobs/compare", {**SECTION, "drivers": [f"learned:policy={name}"]}
    yield "/api/jobs/learn", {"driver": name}
    yield "/api/jobs/learn", {"task": name}
    yield "/api/jobs/learn", {"line": name}
    yield "/api/jobs/learn", {"trainset": name}
    yield "/api/jobs/study", {"study": name}


def test_no_name_opens_a_file_of_the_server(service):
    asked = [pair for name in names(service) for pair in bodies(name)]

    async def ask():
        transport = httpx.ASGITransport(make_api(service))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return [await client.post(route, json=body) for route, body in asked]

    for (route, body), answer in zip(asked, asyncio.run(ask()), strict=True):
        assert answer.status_code == 422, (route, body, answer.text)
        error = answer.json()["error"]
        assert error["message"]
        assert "\n" not in error["message"]
        assert str(service.root) not in answer.text
    assert service.store.jobs() == []


@pytest.mark.parametrize("route", ["jobs/drive", "jobs/compare", "live", "convoys"])
@pytest.mark.parametrize("driver", ["ddpg_pid", "eitop", "itor", "pid_lu2023", "dqn"])
def test_a_policy_that_is_none_of_the_drivers_is_refused_at_once(service, driver, route):
    run = service.root / "runs" / "of-another-kind"
    run.mkdir()
    shutil.copyfile(shipped_policy("ddpg_pid"), run / "policy.safetensors")
    key = RUN if driver in {"ddpg_pid", "eitop", "itor"} else run.name
    named = f"{driver}:policy={key}"
    body = {**SECTION, "drivers": [named]} if route.endswith("compare") else {**SECTION, "driver": named}

    async def ask():
        transport = httpx.ASGITransport(make_api(service))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return await client.post(f"/api/{route}", json=body)

    answer = asyncio.run(ask())
    assert answer.status_code == 422, answer.text
    error = answer.json()["error"]
    assert (error["field"], error["file"]) == ("options.policy", None)
    assert "\n" not in error["message"]
    assert str(service.root) not in answer.text
    assert service.store.jobs() == []


def test_a_learning_run_and_an_upload_drive_by_their_ids(service):
    body = DriveIn(**SECTION, driver="learned", options={"policy": RUN})
    request = service.run_spec(body)
    assert request.options == {"policy": str(service.root / "runs" / RUN / "policy.safetensors")}
    assert service.run_spec(DriveIn(**SECTION, driver=f"learned:policy={RUN}")) == request
    assert request.make_driver().loaded_policy.about
    (service.root / "uploads").mkdir()
    shutil.copyfile(shipped_policy("ppo"), service.root / "uploads" / "x.safetensors")
    row = service.store.add_upload("policy", "mine.safetensors", "x.safetensors")
    driver = service.run_spec(DriveIn(**SECTION, driver=f"learned:policy={row.id}")).make_driver()
    assert driver.loaded_policy.about
    with pytest.raises(InputError, match="no such policy"):
        service.run_spec(DriveIn(**SECTION, driver="learned:policy=another"))


def test_a_folder_of_before_the_fields_had_the_names_of_a_run_file_is_read(tmp_path):
    store = JobStore(tmp_path)
    job = store.new_job("drive", {"arrivals": [{"at_s": 30.0}]})
    with sqlite3.connect(tmp_path / "console.sqlite") as database:
        database.execute("ALTER TABLE jobs RENAME COLUMN request TO asked")
        database.execute("""UPDATE jobs SET asked = replace(asked, '"at_s"', '"told_s"')""")
    assert JobStore(tmp_path).job(job).request == {"arrivals": [{"at_s": 30.0}]}
