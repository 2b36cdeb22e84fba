"""Users of a shared server: who they are, what each may, what is theirs, and their limits."""

import asyncio
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
from tests.web.program import Server
from tests.web.test_api import SECTION
from tests.web.test_guard import TOKEN, ask

from metropilot.errors import InputError
from metropilot.web import Settings, projects, read_users
from metropilot.web.errors import Refused
from metropilot.web.schemas.requests import DriveIn, LiveIn
from metropilot.web.security import Guard
from metropilot.web.service import Service
from metropilot.web.store import JobStore
from metropilot.web.users import User, answer_to, present_user

ANNA, VERA = "a" * 20, "v" * 20
USERS = f"# the team\n\nanna = {ANNA}, user\nvera={VERA} ,viewer\nerik = -, user\n"


@pytest.fixture
def users(tmp_path):
    path = tmp_path / "users.txt"
    path.write_text(USERS)
    return read_users(path)


def sign(token):
    return {"Authorization": f"Bearer {token}"}


def test_a_file_names_users_with_roles(users):
    assert [(user.name, user.role, user.token) for user in users] == [
        ("anna", "user", ANNA),
        ("vera", "viewer", VERA),
        ("erik", "user", None),
    ]
    assert ANNA not in repr(users)


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ("anna", "line 1", "not a user"),
        (f"anna = {ANNA}", "line 1", "not a user"),
        (f"\nan/na = {ANNA}, user", "line 2", "not a name"),
        (f"anna = {ANNA}, root", "line 1", "no such role"),
        ("anna = short, user", "line 1", "too short"),
        (f"anna = {ANNA}, user\nanna = {VERA}, user", "line 2", "twice"),
        (f"anna = {ANNA}, user\nvera = {ANNA}, user", "line 2", "twice"),
        ("# nobody\n", None, "names no user"),
    ],
)
def test_a_line_that_names_no_user_is_refused_without_its_token(tmp_path, text, field, words):
    path = tmp_path / "users.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as told:
        read_users(path)
    assert (told.value.file, told.value.field) == (str(path), field)
    assert ANNA not in str(told.value)
    assert "short," not in str(told.value)


def name_of(settings, client=("127.0.0.1", 5), **headers):
    """Name and role that an application behind the guard sees; the status where it is not asked."""
    seen = []

    async def inner(scope, receive, send):
        seen.append((present_user().name, present_user().role))
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def send(message):
        if message["type"] == "http.response.start" and not seen:
            seen.append(message["status"])

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    sent = [(b"host", b"127.0.0.1:8060")]
    sent += [(name.replace("_", "-").lower().encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": "http", "method": "GET", "path": "/api/lines", "query_string": b"", "headers": sent}
    asyncio.run(Guard(inner, settings)(scope | {"client": client}, receive, send))
    return seen[0]


def test_only_a_trusted_proxy_names_a_user(tmp_path, users):
    far = Settings(
        data=tmp_path, host="0.0.0.0", user_header="X-Remote-User", trusted_proxies=("10.1.0.0/16",)
    )
    assert name_of(far, ("10.1.2.3", 5), X_Remote_User="mia") == ("mia", "user")
    assert name_of(far, ("10.2.2.3", 5), X_Remote_User="mia") == 401
    assert name_of(far, None, X_Remote_User="mia") == 401
    assert name_of(far, ("10.1.2.3", 5)) == 401
    assert name_of(far, ("10.1.2.3", 5), X_Remote_User="mia; drop") == 401
    assert name_of(far, ("10.2.2.3", 5), X_Forwarded_For="10.1.2.3", X_Remote_User="mia") == 401
    listed = Settings(data=tmp_path, users=users, user_header="X-Remote-User", trusted_proxies=("127.0.0.1",))
    assert name_of(listed, X_Remote_User="erik") == ("erik", "user")
    assert name_of(listed, X_Remote_User="vera") == ("vera", "viewer")
    assert name_of(listed, X_Remote_User="mia") == ("mia", "viewer"), "others than those listed read only"
    assert name_of(listed, Authorization=f"Bearer {ANNA}") == ("anna", "user")
    assert name_of(listed, ("10.1.2.3", 5), X_Remote_User="erik", Authorization=f"Bearer {VERA}") == (
        "vera",
        "viewer",
    )
    assert name_of(Settings(data=tmp_path), X_Remote_User="mia") == (None, "user"), "nobody asked for it"


def test_a_token_of_each_user_becomes_a_cookie(tmp_path, users):
    shared = Settings(data=tmp_path, users=users, token=TOKEN)
    assert ask(shared).status_code == 401
    for token in (ANNA, VERA, TOKEN):
        assert ask(shared, headers=sign(token)).status_code == 200
        welcome = ask(shared, path=f"/?token={token}")
        assert welcome.status_code == 303
        assert "Secure" not in welcome.headers["set-cookie"]
    assert ask(shared, path="/?token=-").status_code == 401, "who has no token cannot present it"
    behind = Settings(
        data=tmp_path, users=users, public_hosts=("console.example",), trusted_proxies=("127.0.0.1",)
    )
    encrypted = {"X-Forwarded-Proto": "https"}
    welcome = ask(behind, path=f"/?token={ANNA}", base="http://console.example", headers=encrypted)
    assert "Secure" in welcome.headers["set-cookie"]
    assert ask(behind, base="http://evil.example", headers=sign(ANNA)).status_code == 403


def test_a_viewer_reads_and_is_refused_every_change(tmp_path, users):
    settings = Settings(data=tmp_path, users=users)
    assert ask(settings, headers=sign(VERA)).status_code == 200
    assert ask(settings, "POST", "/api/plan", headers=sign(VERA)).status_code == 200
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        refused = ask(settings, method, "/api/projects", headers=sign(VERA))
        assert refused.status_code == 403
        assert refused.json()["error"]["message"] == "vera reads only"
        assert refused.json()["error"]["allowed"] == "the role user"
        assert ask(settings, method, "/api/projects", headers=sign(ANNA)).status_code == 200


def test_the_service_refuses_a_viewer_whatever_the_way(tmp_path):
    async def story():
        service = Service(Settings(data=tmp_path))
        live = await service.go_live(LiveIn.model_validate({**SECTION, "time_s": 101, "pace": 0}))
        with answer_to(User("vera", "viewer")):
            assert [row.id for row in service.live_runs()] == [live.id]
            body = DriveIn.model_validate(SECTION)
            changes = (
                lambda: service.submit(body),
                lambda: service.stop(live.id),
                lambda: service.name_job(live.id, "mine"),
                lambda: service.forget_job(live.id),
                lambda: service.store.new_project("mine"),
                lambda: service.store.set_project(live.id, None),
            )
            for change in changes:
                with pytest.raises(Refused, match="vera reads only") as told:
                    change()
                assert told.value.status == 403
            for change in (live.ask({"kind": "pace", "pace": 1}), live.stop(), service.upload("a.toml", b"")):
                with pytest.raises(Refused, match="vera reads only"):
                    await change
        assert not live.over
        await live.stop()
        await service.close()

    asyncio.run(story())


def test_limits_of_a_user_are_told_in_one_line(tmp_path):
    async def story():
        service = Service(Settings(data=tmp_path, user_jobs=1, user_bytes=30_000))
        body = LiveIn.model_validate({**SECTION, "time_s": 101, "pace": 0})
        with answer_to(User("anna")):
            first = await service.go_live(body)
            with pytest.raises(Refused) as told:
                await service.go_live(body)
            assert told.value.status == 429
            assert "anna has 1 jobs that wait or run; stop one, or wait" in str(told.value)
            assert "at most 1" in str(told.value)
        with answer_to(User("mia")):  # the limit is each one's own
            second = await service.go_live(body)
            assert second.user == "mia"
        with answer_to(User("anna")):
            await first.stop()
            request = service.kept_bytes("anna")
            assert 0 < request < 2_000
            text = service.text("line", "yizhuang").encode()
            upload, _ = await service.upload("mine.toml", text)
            assert service.kept_bytes("anna") == request + len(text) < 30_000 < 20 * len(text)
            while service.kept_bytes("anna") + len(text) <= 30_000:
                await service.upload("more.toml", text)
            words = r"anna keeps 0\.0 MB of runs and uploads, 0\.0 MB more do not fit; delete some"
            with pytest.raises(Refused, match=words):
                await service.upload("more.toml", text)
            for row in service.store.uploads():
                service.forget(row.id)
            assert service.kept_bytes("anna") == request
            assert upload.user == "anna"
        await second.stop()
        await service.close()

    asyncio.run(story())


def test_what_is_begun_carries_the_name(tmp_path):
    path = tmp_path / "users.txt"
    path.write_text(USERS)
    served = Server(tmp_path, "--users", path, "--user-jobs", 3, "--user-mb", 1)
    try:
        served.get("/api/lines", code=401)
        served.client.headers.update(sign(ANNA))
        assert served.get("/api/user") == {
            "name": "anna",
            "role": "user",
            "jobs": 0,
            "jobs_most": 3,
            "bytes_kept": 0,
            "bytes_most": 1_000_000,
        }
        job = served.post("/api/jobs/drive", {**SECTION, "driver": "flat_out"}, code=202)
        live = served.post("/api/live", {**SECTION, "time_s": 101, "pace": 0}, code=201)
        project = served.post("/api/projects", {"name": "P"}, code=201)
        assert {job["user"], live["user"], project["user"]} == {"anna"}
        assert {row["user"] for row in served.get("/api/jobs?text=anna")} == {"anna"}
        served.wait(job["id"])
        assert served.get("/api/user")["jobs"] == 1
        assert 10_000 < served.get("/api/user")["bytes_kept"] < 1_000_000
        served.client.headers.update(sign(VERA))
        assert served.get("/api/user")["role"] == "viewer"
        assert served.get(f"/api/jobs/{job['id']}/drive")["kpis"]["outcome"] == "arrived"
        for path, body in ((f"/api/live/{live['id']}/stop", None), ("/api/jobs/drive", SECTION)):
            assert served.post(path, body, code=403)["error"]["message"] == "vera reads only"
        assert served.get(f"/api/live/{live['id']}")["status"] == "running"
    finally:
        served.close()


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"user_header": "X-Remote-User"}, "trusted_proxy"),
        ({"user_header": "Cookie", "trusted_proxies": ("127.0.0.1",)}, "user_header"),
        ({"user_header": "X-Remote-User", "trusted_proxies": ("proxy",)}, "trusted_proxy"),
    ],
)
def test_a_header_that_anybody_could_send_is_refused(tmp_path, settings, field):
    with pytest.raises(InputError) as told:
        Settings(data=tmp_path, **settings)
    assert told.value.field == field


def at_once(count, user, act):
    """Call a function in threads that begin together; return what each did or was refused with."""
    begin = threading.Barrier(count)

    def one(k):
        with answer_to(user):
            begin.wait()
            try:
                return act(k)
            except Refused as refused:
                return refused

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(one, range(count)))


def test_jobs_at_once_do_not_pass_the_limit_together(tmp_path):
    service = Service(Settings(data=tmp_path, user_jobs=3, queued_jobs=5))
    anna, mia = User("anna"), User("mia")
    found = at_once(12, anna, lambda _: service.store.new_job("drive", {}, service.check_room))
    assert sum(isinstance(each, str) for each in found) == 3
    assert {each.status for each in found if isinstance(each, Refused)} == {429}
    assert service.store.count_of("anna") == 3
    found = at_once(12, mia, lambda _: service.store.new_job("drive", {}, service.check_room))
    assert sum(isinstance(each, str) for each in found) == 2, "five may wait in all"
    for row in service.store.jobs():
        service.store.update(row.id, status="stopped")
    stopped = [row.id for row in service.store.jobs()]
    limit = partial(service.check_limits, jobs=1)
    found = at_once(5, anna, lambda k: service.store.update(stopped[k], limit, status="queued"))
    assert sum(each is True for each in found) == 5 - sum(isinstance(each, Refused) for each in found)
    assert service.store.count_of("anna") <= 3


def test_uploads_at_once_do_not_pass_the_limit_together(tmp_path):
    service = Service(Settings(data=tmp_path, user_bytes=25_000))
    (tmp_path / "uploads").mkdir()

    def upload(k):
        (tmp_path / "uploads" / f"{k}.toml").write_bytes(b"x" * 10_000)
        room = partial(service.check_limits, size=10_000)
        return service.store.add_upload("line", "mine", f"{k}.toml", room)

    found = at_once(8, User("anna"), upload)
    assert sum(not isinstance(each, Refused) for each in found) == 2
    assert service.kept_bytes("anna") == 20_000


JOURNAL = [(0, {"kind": "lever", "share": None, "words": "x" * 100_000})]
"""Of a stopped live run: it is packed to nearly nothing."""


def archive(service):
    """Archive of a project with an own line of two versions and a stopped live run; its size when kept."""

    async def made():
        text = service.text("line", "yizhuang")
        line = (await service.upload("mine.toml", text.encode()))[0].id
        await service.save(line, text.replace("[1090, 80]", "[1090, 60]"), 1)
        return line

    row = service.store.new_project("P")
    service.store.set_project(asyncio.run(made()), row.id)
    request = LiveIn.model_validate({**SECTION, "time_s": 101}).model_dump()
    job = service.store.new_job("live", request)
    service.store.note_all(job, JOURNAL)
    service.store.update(job, status="stopped")
    service.store.set_project(job, row.id)
    return projects.write_archive(service, row.id), service.kept_bytes("otto")


def kept_in(service):
    """Everything that a service keeps: its rows and its files."""
    with sqlite3.connect(service.root / "console.sqlite") as database:
        tables = ("projects", "jobs", "journal", "uploads", "versions")
        rows = [database.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in tables]
    places = [path for path in service.root.rglob("*") if "sqlite" not in path.name]
    return rows, sorted(path.relative_to(service.root).as_posix() for path in places)


@pytest.fixture
def project_archive(tmp_path):
    """An archive, and its size when it is kept."""
    with answer_to(User("otto")):
        return archive(Service(Settings(data=tmp_path / "first")))


def take(service, content):
    return asyncio.run(projects.read_archive(service, content))


def test_an_archive_counts_as_what_it_unpacks_to(tmp_path, project_archive):
    content, size = project_archive
    assert 5 * len(content) < size
    with answer_to(User("anna")):
        exact = Service(Settings(data=tmp_path / "exact", user_bytes=size))
        row = take(exact, content)
        assert row.user == "anna"
        assert exact.kept_bytes("anna") == size
        short = Service(Settings(data=tmp_path / "short", user_bytes=size - 1))
        (tmp_path / "short" / "uploads").mkdir()
        before = kept_in(short)
        with pytest.raises(Refused, match=r"anna keeps 0\.0 MB .*, 0\.1 MB more do not fit; delete") as told:
            take(short, content)
        assert told.value.status == 429
        assert kept_in(short) == before
        with pytest.raises(Refused, match=r"anna keeps 0\.1 MB of runs and uploads, .* delete some"):
            take(exact, content)


def test_imports_at_once_do_not_pass_the_limit_together(tmp_path, project_archive):
    content, size = project_archive
    service = Service(Settings(data=tmp_path / "second", user_bytes=2 * size))
    found = at_once(6, User("anna"), lambda _: take(service, content))
    assert sum(not isinstance(each, Refused) for each in found) == 2
    assert {each.status for each in found if isinstance(each, Refused)} == {429}
    assert service.kept_bytes("anna") == 2 * size
    rows, places = kept_in(service)
    assert rows == [2, 2, 2, 2, 4]
    assert len([place for place in places if place.startswith("uploads/")]) == 4


def test_an_import_that_fails_half_way_leaves_nothing(tmp_path, project_archive, monkeypatch):
    service = Service(Settings(data=tmp_path / "third"))
    (tmp_path / "third" / "uploads").mkdir()
    before = kept_in(service)

    def fail(self, entry, project):
        del self, entry, project
        raise OSError("no space left on device")

    monkeypatch.setattr(JobStore, "set_project", fail)
    with pytest.raises(OSError, match="no space"):
        take(service, project_archive[0])
    assert kept_in(service) == before
