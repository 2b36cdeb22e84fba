"""A real browser on a real server: `make test-web`. Without a browser the tests say so and are left out."""

import os
import shutil

import pytest
from tests.web.program import Server

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE_MS = 60_000


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    made = Server(tmp_path_factory.mktemp("console"))
    yield made
    made.close()


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium: METROPILOT_BROWSER, or the system's."""
    found = os.environ.get("METROPILOT_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("no browser on this machine: install Debian's chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install 'metropilot[browser]'")
    with playwright.sync_playwright() as driver:
        playwright.expect.set_options(timeout=PATIENCE_MS)
        made = driver.chromium.launch(executable_path=found, args=list(FLAGS))
        yield made
        made.close()


class Elsewhere:
    """Everything a page asked for that is not this server, and everything that went wrong in it."""

    def __init__(self, page, url):
        self.url, self.asked, self.wrong = url, [], []
        page.on("request", self.note)
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda said: said.type == "error" and self.wrong.append(said.text))

    def note(self, request):
        own = request.url.startswith((self.url, self.url.replace("http", "ws"), "data:", "blob:"))
        if not own:
            self.asked.append(request.url)


LEAVING = "Resize must be passed a displayed plot div element"
"""What Plotly says when a picture is resized while its page is being left; nothing is lost by it."""


@pytest.fixture
def visit(browser, server):
    """Open a page in a fresh profile; at the end nothing was asked from elsewhere and nothing went wrong."""
    contexts, watched = [], []

    def open_page(path, *, width=1280, height=900, scheme="light", expected=(), language=None):
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, accept_downloads=True
        )
        contexts.append(context)
        if language is not None:
            context.add_cookies([{"name": "metropilot_language", "value": language, "url": server.url}])
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        watched.append((Elsewhere(page, server.url), expected))
        page.goto(server.url + path)
        return page

    yield open_page
    for context in contexts:
        context.close()
    for elsewhere, named in watched:
        expected = (*named, LEAVING)
        assert elsewhere.asked == []
        assert [text for text in elsewhere.wrong if not any(part in text for part in expected)] == []
