"""The catalogue of the console's texts: whole, compiled, with the same placeholders in both languages."""

import ast
import importlib.util
import json
import re
import string
from pathlib import Path

import pytest
from starlette.datastructures import Headers

from metropilot.studies import STUDIES, published_study
from metropilot.web.words.browser import SCRIPTS, words_script
from metropilot.web.words.language import ENGLISH, LANGUAGES, answer_in, gettext, language_of, ngettext
from metropilot.web.words.said import SENTENCES, WORDS, retell

ROOT = Path(__file__).parents[2]
STATIC = ROOT / "src" / "metropilot" / "web" / "static"
OTHERS = [language for language in LANGUAGES if language != ENGLISH]


@pytest.fixture(scope="module")
def tool():
    """tools/words.py."""
    spec = importlib.util.spec_from_file_location("words_tool", ROOT / "tools" / "words.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def placeholders(text):
    return sorted(name for _, name, _, _ in string.Formatter().parse(text) if name is not None)


@pytest.mark.parametrize("language", OTHERS)
def test_the_catalogue_holds_what_the_sources_say(tool, language):
    """Nothing is missing and nothing is left over: `make words` would write the same files."""
    known, gathered = tool.read(language), tool.gather(language)
    assert {message.id for message in known} == {message.id for message in gathered}, "run `make words`"
    assert tool.path_of(language, ".po").read_bytes() == tool.po_bytes(tool.update(language)), (
        "run `make words`"
    )
    assert tool.path_of(language, ".mo").read_bytes() == tool.mo_bytes(known), "run `make words`"


@pytest.mark.parametrize("language", OTHERS)
def test_every_text_is_translated_with_its_placeholders(tool, language):
    for message in tool.read(language):
        if not message.id:
            continue
        one = message.id if isinstance(message.id, str) else message.id[-1]
        told = [message.string] if isinstance(message.string, str) else list(message.string)
        assert all(told), one
        assert not message.fuzzy, one
        for text in told:
            assert placeholders(text) == placeholders(one), one


def test_scripts_say_only_what_they_are_given():
    texts = "\n".join(path.read_text(encoding="utf-8") for path in STATIC.glob("*.js"))
    calls = re.findall(r"""metropilotSay\(((?:"[^"]*"|[^",()])*)""", texts)
    said = {each for call in calls for each in re.findall('"([^"]+)"', call)} | set(
        re.findall(r"""\bsay\('([^']+)'""", texts)
    )
    assert said == set(SCRIPTS)
    assert set(re.findall(r'metropilotRetell\("([^"]+)"\)', texts)) <= set(WORDS)


def test_the_words_of_the_scripts_are_handed_over():
    with answer_in(ENGLISH):
        assert words_script() == ""
    with answer_in("zh"):
        found = re.fullmatch(r"<script>window\.metropilotWords = (.*)</script>", words_script())
    told = json.loads(found[1])
    assert {*SCRIPTS, *WORDS, *SENTENCES} <= set(told["words"])
    assert told["words"]["under way"] == "进行中"


@pytest.mark.parametrize(
    ("headers", "language"),
    [
        ({}, "en"),
        ({"accept-language": "zh-CN,zh;q=0.9,en;q=0.8"}, "zh"),
        ({"accept-language": "en-GB,en;q=0.9,zh;q=0.8"}, "en"),
        ({"accept-language": "de,zh-TW;q=0.5,en;q=0.3"}, "zh"),
        ({"accept-language": "zh;q=0"}, "en"),
        ({"accept-language": "fr, *;q=0.1"}, "en"),
        ({"accept-language": "zh;q=much,,;;"}, "en"),
        ({"accept-language": "zh-CN", "cookie": "metropilot_language=en"}, "en"),
        ({"cookie": "a=b; metropilot_language=zh"}, "zh"),
        ({"accept-language": "zh", "cookie": "metropilot_language=../../etc"}, "zh"),
    ],
)
def test_the_language_is_that_of_the_cookie_or_the_browser(headers, language):
    assert language_of(Headers(headers)) == language


def test_what_the_library_says_is_told_in_the_language():
    assert retell("arrived on time, but 2 interventions") == "arrived on time, but 2 interventions"
    with answer_in("zh"):
        assert gettext("Depart") == "发车"
        assert gettext("") == ""
        assert ngettext("{count} run", "{count} runs", 3) == "3 次运行"
        assert retell("place 3 in the queue") == "排在第 3 位"
        assert retell("arrived on time, but 2 interventions") == "准点到达，但防护介入 2 次"
        assert retell("stopped; it can be resumed") == "已停止；可继续"
        assert retell("restriction announced: 40 km/h from 700 to 900 m") == "临时限速：700 至 900 m，40 km/h"
        assert retell("train 3 waits at Rongjing East Street for train 2") == (
            "列车 3 在 Rongjing East Street 等待列车 2"
        )
        assert retell("Sand and Sons") == "Sand and Sons"
        assert retell("my own name (v2)") == "my own name (v2)"
    assert gettext("Depart") == "Depart"


@pytest.mark.parametrize("study", STUDIES.ids())
def test_claims_and_captions_of_studies_are_told_in_the_language(study):
    found = published_study(study)
    texts = [found.title, found.summary, *(row["claim"] for row in found.verdicts)]
    with answer_in("zh"):
        for text in (*texts, *(figure.caption for figure in found.figures)):
            assert not re.search("[a-z]{3,} [a-z]{2,}", retell(text)), f"add it to words/studies.py: {text}"


def test_pages_are_answered_in_the_language(server):
    answers = {
        language: server.client.get("/convoy", headers={"cookie": f"metropilot_language={language}"}).text
        for language in ("en", "zh", "xx")
    }
    assert '<html lang="en-US">' in answers["en"]
    assert '<html lang="zh-CN">' in answers["zh"]
    assert "虚拟编组 · metropilot" in answers["zh"]
    assert "zh-CN.umd.prod.js" in answers["zh"]
    assert '<html lang="en-US">' in answers["xx"]
    assert not re.search("[一-鿿]", answers["en"].replace("中文", ""))


REFUSALS = {"InputError", "Infeasible", "Refused"}


def texts_of(node, names):
    """Texts that an expression can have, a digit for each value in them; none of what only a run knows."""
    if isinstance(node, ast.Constant):
        return [node.value]
    if isinstance(node, ast.JoinedStr):
        return ["".join(part.value if isinstance(part, ast.Constant) else "7" for part in node.values)]
    if isinstance(node, ast.IfExp):
        return [*texts_of(node.body, names), *texts_of(node.orelse, names)]
    return names.get(node.id, []) if isinstance(node, ast.Name) else []


def collect_texts(function):
    """Texts of the names that a function assigns, alone or in pairs."""
    names = {}
    for node in ast.walk(function):
        if not isinstance(node, ast.Assign):
            continue
        target, pairs = node.targets[0], [(node.targets[0], node.value)]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            pairs = zip(target.elts, node.value.elts, strict=True)
        for name, value in pairs:
            if isinstance(name, ast.Name):
                names.setdefault(name.id, []).extend(texts_of(value, {}))
    return names


def refusals_of(path):
    """Texts of the refusals that a file raises, where they stand in the call or are assigned before it."""
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        names = collect_texts(function)
        for node in ast.walk(function):
            if isinstance(node, ast.Call) and node.args and getattr(node.func, "id", None) in REFUSALS:
                yield from texts_of(node.args[0], names)


@pytest.mark.parametrize("language", OTHERS)
def test_every_refusal_that_a_page_can_show_is_translated(tool, language):
    source = ROOT / "src" / "metropilot"
    found = [
        (path.relative_to(source).as_posix(), message)
        for path in sorted(source.rglob("*.py"))
        if not path.relative_to(source).as_posix().startswith(tool.ELSEWHERE)
        for message in refusals_of(path)
    ]
    assert len(found) > 400
    with answer_in(language):
        assert [(path, message) for path, message in found if retell(message) == message] == []


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("unknown trainset, did you mean dkz32?", "未知的列车，是否指 dkz32？"),
        ("positions of a profile must increase", "纵断面的位置必须递增"),
        ("cannot be read (no such file)", "无法读取（没有这样的文件）"),
        ("a job that is running cannot be deleted; stop it first", "运行中的任务不能删除；请先停止"),
        ("dead time and lag cannot be told apart", "纯延时与惯性 无法区分"),
        ("235 m or further", "235 m 或更远"),
        ("1 to 3, one for each section", "1 至 3，每个区间一个"),
        (">= 0.15 m/s^2 left on the fall", "下坡时剩余制动 >= 0.15 m/s^2"),
        ("a whole number or true or false", "整数 或 true 或 false"),
    ],
)
def test_a_refusal_with_a_name_in_it_is_retold(text, wanted):
    with answer_in("zh"):
        assert retell(text) == wanted
