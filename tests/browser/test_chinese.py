"""The console in Chinese: no English is left to read, the choice stays, and Quasar's own texts follow."""

import re

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 90_000
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101}
TEXTS = """() => {
    const seen = (at) => at.checkVisibility({ checkOpacity: false, checkVisibilityCSS: true });
    const own = (at) => at.closest('[lang^="en"]:not(html), script, style, textarea, .q-icon, .notranslate');
    const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walk.nextNode()) {
        const at = walk.currentNode.parentElement;
        if (at && seen(at) && !own(at)) found.push(walk.currentNode.textContent);
    }
    for (const at of document.querySelectorAll('[aria-label], [title], [placeholder]'))
        if (seen(at) && !own(at) && !at.closest('.modebar'))
            found.push(...['aria-label', 'title', 'placeholder'].map((name) => at.getAttribute(name) || ''));
    for (const at of document.querySelectorAll('input')) if (seen(at) && at.readOnly) found.push(at.value);
    return found.concat(document.title);
}"""
UNITS = "permil MN kWh km cm mm kN kW MW Wh min kg MB ms MPa Hz UTC id"
NAMES = """metropilot TOML JSON CSV SVG PNG PDF ZIP DuckDB TTOBench safetensors KPI ATP AW WebAssembly Davis
    Esc PID PPO DDPG DQN SAC NAF EITOE EITOP STON STOD ITOR Huang Lu Cheng Chen Zhou Yin et al Lillicrap
    Haarnoja Gu English all planned policy PATH RUN set Python docs md write campaign robustness
    python jax jaxlib numpy AMD EPYC budget paper as printed reproduce"""
"""Names, and words that are typed as they stand."""
FILES = r"\S+\.(csv|json|svg|png|pdf|toml|zip|parquet|safetensors)\b"
KEPT = re.compile(rf"{FILES}|\b\S*_\S*\b|\w+-\d\S*|\btab-[0-9a-f]{{4}}\b|/api/\S*|\b[0-9a-f]{{9}}\b")
"""Files, ids, addresses and commits."""


def allowed_words(server):
    """Units, names and ids that stay as they are in every language."""
    words = set(f"{UNITS} {NAMES}".split())
    named = [server.get(f"/api/{kind}") for kind in ("lines", "trainsets", "drivers", "recipes", "tasks")]
    for row in (row for rows in named for row in rows):
        texts = [row.get("id", ""), row.get("driver", ""), row.get("name", ""), *row.get("options", {})]
        texts += [*row.get("loads_kg", ()), str(row.get("source", "")).removeprefix("own")]
        words |= set(re.findall(r"[A-Za-z]+", " ".join(texts)))
    for row in named[0]:
        stops = server.get(f"/api/lines/{row['id']}")["stops"]
        words |= set(re.findall(r"[A-Za-z]+", " ".join(f"{stop['code']} {stop['name']}" for stop in stops)))
    return words


def english(texts, allowed):
    """Texts with a word that is neither a unit nor a name."""
    found = []
    for text in dict.fromkeys(texts):
        words = re.findall(r"[A-Za-z]{2,}", KEPT.sub("", text))
        if [word for word in words if word not in allowed]:
            found.append(text)
    return found


@pytest.fixture(scope="module")
def made(server):
    """Jobs whose pages are looked at with their results."""
    drives = {name: {**SECTION, "driver": name} for name in ("manual", "ppo")}
    found = {name: server.post("/api/jobs/drive", body, code=202)["id"] for name, body in drives.items()}
    found["compare"] = server.post("/api/jobs/compare", {**SECTION, "seeds": 2}, code=202)["id"]
    found["journey"] = server.post("/api/jobs/journey", {"line": "yizhuang"}, code=201)["id"]
    found["line"] = server.post("/api/jobs/line", {"line": "yizhuang", "load": "AW0"}, code=202)["id"]
    for job in found.values():
        server.wait(job)
    return found


def open_folds(page):
    for name in ("临时限速", "驾驶策略选项", "扰动"):
        page.get_by_role("button", name=name).first.click()
    page.get_by_role("button", name="添加限速").click()


PAGES = {
    "drive": ("/", "[data-test=depart]", open_folds),
    "driven": ("/?run={ppo}", "[data-test=explanation]", None),
    "compare": ("/compare?job={compare}", "[data-test=picture]", None),
    "journey": ("/journey?job={journey}", "[data-test=sections] tbody tr", None),
    "line": ("/line?job={line}", "[data-test=words]", None),
    "convoy": ("/convoy", "[data-test=depart]", None),
    "learn": ("/learn", "[data-test=learn]", None),
    "study": ("/learn?study=lu2023", "[data-test=verdict]", None),
    "lines": ("/lines", "[data-test=line] svg", None),
    "fit": ("/fit", "[data-test=fit]", None),
    "edit-line": ("/edit?line=yizhuang", ".mp-grid", None),
    "edit-trainset": ("/edit?trainset=dkz32", ".mp-grid", None),
    "runs": ("/runs?run={manual}&with={ppo}", "[data-test=difference] table", None),
    "campaigns": ("/campaigns?campaign=robustness", ".mp-data tbody tr", None),
}
WRITTEN = {
    "study": '[aria-label="发布的数据行"] tbody',
    "lines": "[data-test=line] .mp-card:nth-child(n+3)",
    "edit-line": "[data-field$=source]",
    "edit-trainset": "[data-field$=source]",
}
"""Notes and sources of a file, and rows of a study, which are shown as it has them."""


@pytest.mark.parametrize("name", PAGES)
def test_no_english_is_left(request, visit, server, name):
    path, there, act = PAGES[name]
    made = request.getfixturevalue("made") if "{" in path else {}
    page = visit(path.format(**made), language="zh")
    expect(page.locator(there).first).to_be_visible(timeout=PATIENCE_MS)
    page.wait_for_timeout(1500)
    if act:
        act(page)
        page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.lang") == "zh-CN"
    if name in WRITTEN:
        page.evaluate("(at) => document.querySelectorAll(at).forEach((each) => each.remove())", WRITTEN[name])
    found = page.evaluate(TEXTS)
    assert sum(bool(re.search("[一-鿿]", text)) for text in found) > 20
    assert english(found, allowed_words(server)) == []


def test_a_live_run_speaks_chinese(visit, server):
    page = visit("/", language="zh")
    expect(page.get_by_text("最小 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_role("combobox", name="仿真速率").click()
    page.get_by_role("option", name="10 ×").click()
    page.locator("[data-test=depart]").click()
    live = page.locator("[data-test=live]")
    expect(live.locator("[data-mp=status]")).to_have_text("进行中", timeout=PATIENCE_MS)
    page.locator("[data-test=tell-arrival]").click()
    page.locator("[data-test=restrict]").click()
    expect(live.locator("[data-mp=log] li")).to_have_count(2, timeout=PATIENCE_MS)
    expect(live.locator("[data-mp=log]")).to_contain_text("临时限速")
    found = page.evaluate(TEXTS)
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    expect(live.locator("[data-mp=status]")).to_have_text("已到达终点")
    expect(page.locator("[data-test=result]").get_by_text("✓ 通过").first).to_be_visible()
    assert english([*found, *page.evaluate(TEXTS)], allowed_words(server)) == []


def test_a_running_line_and_a_convoy_speak_chinese(visit, server):
    line = {"line": "yizhuang", "headway_s": 180, "pace": 60, "lasts_s": 900}
    convoy = {**SECTION, "time_s": 115, "trainsets": 3, "pace": 5}
    bodies = (("running-lines", line), ("convoys", convoy))
    jobs = [server.post(f"/api/{kind}", body, code=201)["id"] for kind, body in bodies]
    held = {"station": "RJ", "hold_s": 120}
    for job, path, test in zip(jobs, ("/line", "/convoy"), ("running", "convoy"), strict=True):
        page = visit(f"{path}?run={job}", language="zh")
        root = page.locator(f"[data-test={test}]")
        expect(root.locator("[data-mp=time]")).not_to_have_text("–", timeout=PATIENCE_MS)
        if test == "running":
            server.post(f"/api/live/{job}/hold", held)
            expect(root.locator("[data-mp=log] li").first).to_contain_text("扣停", timeout=PATIENCE_MS)
        found = page.evaluate(TEXTS)
        expect(root).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
        page.wait_for_timeout(500)
        assert english([*found, *page.evaluate(TEXTS)], allowed_words(server)) == []


def test_the_choice_is_kept(visit):
    page = visit("/runs")
    assert page.evaluate("document.documentElement.lang") == "en-US"
    page.locator("[data-test=language]").click()
    expect(page.get_by_role("heading", name="运行", exact=True).first).to_be_attached(timeout=PATIENCE_MS)
    page.get_by_role("navigation", name="页面").get_by_role("link", name="虚拟编组").click()
    expect(page.locator("[data-test=depart]")).to_have_text(re.compile("发车"), timeout=PATIENCE_MS)
    assert page.evaluate("[document.documentElement.lang, document.title]") == [
        "zh-CN",
        "虚拟编组 · metropilot",
    ]
    assert (
        page.evaluate("document.getElementById('app').__vue_app__.config.globalProperties.$q.lang.isoName")
        == "zh-CN"
    )
    page.locator("[data-test=language]").click()
    expect(page.locator("[data-test=depart]")).to_have_text(re.compile("Depart"), timeout=PATIENCE_MS)


def test_a_browser_in_chinese_needs_no_choice(browser, server):
    context = browser.new_context(locale="zh-CN")
    page = context.new_page()
    page.goto(f"{server.url}/fit")
    expect(page.locator("[data-test=fit]")).to_have_text("参数辨识", timeout=PATIENCE_MS)
    context.close()


@pytest.mark.parametrize("path", ["/", "/line", "/edit?line=yizhuang", "/learn", "/campaigns"])
def test_nothing_sticks_out_in_chinese(visit, path):
    page = visit(path, width=360, height=800, language="zh")
    expect(page.locator("#main")).to_be_visible()
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert page.locator("nav a").count() == 9
    for box in (link.bounding_box() for link in page.locator("nav a").all()):
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 360
