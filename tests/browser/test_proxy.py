"""The console behind nginx with TLS, as docs/howto/console.md has it; left out where there is no nginx."""

import os
import re
import shutil
import socket
import subprocess
import time
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import expect
from tests.web.program import Server

PATIENCE_MS = 60_000
HOST = "console.localhost"
"""A name that browsers resolve to this machine."""
PAGE = Path("docs/howto/console.md")
PASSWORDS = {"anna": "violet", "vera": "indigo"}
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101, "pace": 0}


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def proxy(tmp_path_factory):
    """Address of nginx with the configuration of the page, and the console behind it."""
    nginx, openssl = shutil.which("nginx") or shutil.which("/usr/sbin/nginx"), shutil.which("openssl")
    if nginx is None or openssl is None:
        pytest.skip("no nginx or no openssl on this machine")
    folder = tmp_path_factory.mktemp("proxy")
    (folder / "users").write_text("anna = -, user\nvera = -, viewer\n")
    options = ["--user-header", "X-Remote-User", "--trusted-proxy", "127.0.0.1", "--public-host", HOST]
    console = Server(folder, *options, "--users", folder / "users")
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", f"/CN={HOST}"]
    files = ["-keyout", folder / "console.key", "-out", folder / "console.crt"]
    subprocess.run([*command, *files], check=True, capture_output=True)
    hashes = {
        name: subprocess.run(
            [openssl, "passwd", "-apr1", word], check=True, capture_output=True, text=True
        ).stdout.strip()
        for name, word in PASSWORDS.items()
    }
    (folder / "console.htpasswd").write_text("".join(f"{name}:{word}\n" for name, word in hashes.items()))
    port = free_port()
    text = re.search(r"```nginx\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    for before, after in (
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("console.example", HOST),
        ("/etc/nginx/", f"{folder}/"),
        ("http://127.0.0.1:8060", console.url),
    ):
        assert before in text
        text = text.replace(before, after)
    places = "".join(
        f"{kind}_temp_path {folder}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    whole = "user root;\n" if os.getuid() == 0 else ""  # whose folder of tests nobody else may read
    whole += f"daemon off;\npid {folder}/pid;\nerror_log {folder}/error.log;\nevents {{}}\n"
    whole += f"http {{\naccess_log {folder}/access.log;\n{places}{text}}}\n"
    (folder / "nginx.conf").write_text(whole)
    process = subprocess.Popen([nginx, "-p", folder, "-c", folder / "nginx.conf"])
    url = f"https://{HOST}:{port}"
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        assert process.poll() is None, (folder / "error.log").read_text()
        time.sleep(0.05)
    yield url, port, console, folder
    process.terminate()
    process.wait(10)
    console.close()


def ask(proxy, method, path, name=None, **more):
    """A request through nginx."""
    url, port, *_ = proxy
    auth = None if name is None else (name, PASSWORDS[name])
    headers = {"Host": url.removeprefix("https://"), **more.pop("headers", {})}
    with httpx.Client(verify=False, auth=auth, timeout=60) as client:
        return client.request(method, f"https://127.0.0.1:{port}{path}", headers=headers, **more)


def test_nginx_names_the_user_and_nobody_else_does(proxy):
    assert ask(proxy, "GET", "/api/user").status_code == 401
    assert ask(proxy, "GET", "/api/user", "anna").json()["name"] == "anna"
    lie = {"X-Remote-User": "anna"}
    assert ask(proxy, "GET", "/api/user", "vera", headers=lie).json()["name"] == "vera"
    refused = ask(proxy, "POST", "/api/live", "vera", json=SECTION)
    assert (refused.status_code, refused.json()["error"]["message"]) == (403, "vera reads only")
    assert ask(proxy, "GET", "/api/user", "anna", headers={"Host": "evil.example"}).status_code == 403
    foreign = {"Origin": "https://evil.example"}
    assert ask(proxy, "POST", "/api/projects", "anna", json={"name": "P"}, headers=foreign).status_code == 403


@pytest.mark.parametrize("width", [1440, 390])
def test_a_live_run_through_nginx(browser, proxy, width):
    url, _, _, folder = proxy
    who = {"username": "anna", "password": PASSWORDS["anna"]}
    context = browser.new_context(
        viewport={"width": width, "height": 900}, ignore_https_errors=True, http_credentials=who
    )
    page = context.new_page()
    sockets, wrong = [], []
    page.on("websocket", lambda socket: sockets.append(socket.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(url)
    expect(page.locator('[data-test="user"]')).to_have_text("anna", timeout=PATIENCE_MS)
    page.locator('[data-test="depart"]').click()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    page.wait_for_function("+document.querySelector('[data-test=live]').dataset.position > 5")
    assert sockets
    assert all(address.startswith(url.replace("https", "wss")) for address in sockets)
    run = re.search(r"run=(live-[\w-]+)", page.url)[1]
    page.locator('[data-test="stop"]').click()
    expect(live).to_have_attribute("data-status", "stopped", timeout=PATIENCE_MS)
    assert ask(proxy, "GET", f"/api/jobs/{run}", "vera").json()["user"] == "anna"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert wrong == []
    context.close()
    for _ in range(100):  # nginx writes the line when the websocket has closed
        if " 101 " in (folder / "access.log").read_text():
            return
        time.sleep(0.05)
    raise AssertionError("the pages had no websocket")
