"""Checks that every request passes first: host, origin, token, size."""

import asyncio

import httpx
import pytest

from metropilot.errors import InputError
from metropilot.web.security import Guard
from metropilot.web.settings import Settings

TOKEN = "0123456789abcdef"


async def inner(scope, receive, send):
    body = b""
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        body += message.get("body", b"")
        if not message.get("more_body"):
            break
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": str(len(body)).encode()})


def ask(settings, method="GET", path="/api/lines", **more):
    async def once():
        transport = httpx.ASGITransport(Guard(inner, settings))
        base = more.pop("base", "http://127.0.0.1:8060")
        async with httpx.AsyncClient(transport=transport, base_url=base) as client:
            return await client.request(method, path, **more)

    return asyncio.run(once())


def test_another_host_name_is_refused(tmp_path):
    local = Settings(data=tmp_path)
    assert ask(local).status_code == 200
    assert ask(local, base="http://[::1]:8060").status_code == 200
    assert ask(local, base="http://evil.example").status_code == 403


def test_another_site_cannot_post(tmp_path):
    local = Settings(data=tmp_path)
    foreign = {"Origin": "http://evil.example"}
    assert ask(local, "POST", headers=foreign).status_code == 403
    assert ask(local, "POST", headers={"Origin": "http://127.0.0.1:8060"}).status_code == 200


def test_a_token_is_needed_and_becomes_a_cookie(tmp_path):
    far = Settings(data=tmp_path, host="0.0.0.0", token=TOKEN)
    base = "http://console.example:8060"
    refused = ask(far, base=base)
    assert refused.status_code == 401
    assert refused.json()["error"]["field"] == "Authorization"
    assert ask(far, base=base, headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
    assert ask(far, base=base, headers={"Authorization": "Bearer wrong"}).status_code == 401
    welcome = ask(far, path=f"/?token={TOKEN}&x=1", base=base)
    assert welcome.status_code == 303
    assert welcome.headers["location"] == "/?x=1"
    assert "HttpOnly" in welcome.headers["set-cookie"]
    assert ask(far, base=base, headers={"Cookie": f"metropilot_token={TOKEN}"}).status_code == 200
    astray = ask(far, path=f"{base}//evil.example/?token={TOKEN}")
    assert astray.headers["location"] == "/evil.example/"


def test_a_body_too_large_is_refused_whatever_it_says(tmp_path):
    local = Settings(data=tmp_path)
    assert ask(local, "POST", content=b"x" * 200_000).status_code == 413

    async def endless():
        for _ in range(100):
            yield b"x" * 5000

    with pytest.raises(AssertionError):  # the application never answers: its client was cut off
        ask(local, "POST", content=endless())


@pytest.mark.parametrize("left", [True, False])
def test_an_error_after_its_browser_has_left_is_nobodys(tmp_path, left):
    async def late(scope, receive, send):
        await receive()
        raise RuntimeError("No response returned.")

    async def receive():
        return {"type": "http.disconnect" if left else "http.request", "body": b"", "more_body": False}

    async def send(message):
        raise AssertionError(message)

    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b""}
    scope["headers"] = [(b"host", b"127.0.0.1:8060")]
    answer = Guard(late, Settings(data=tmp_path))(scope, receive, send)
    if left:
        asyncio.run(answer)
    else:
        with pytest.raises(RuntimeError):
            asyncio.run(answer)


def test_a_host_beyond_loopback_needs_a_token(tmp_path):
    with pytest.raises(InputError, match="token"):
        Settings(data=tmp_path, host="0.0.0.0")
    with pytest.raises(InputError, match="too short"):
        Settings(data=tmp_path, token="short")


def test_a_page_loads_nothing_from_elsewhere(tmp_path):
    assert "default-src 'self'" in ask(Settings(data=tmp_path)).headers["content-security-policy"]
