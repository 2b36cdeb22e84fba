"""The guards that ``tools/mutate_guards.py`` removes: each is still there, and the page names them all."""

import re
from pathlib import Path

import pytest
from tools.guards import ALL, GUARDS, ROOT, remove_guard

PAGE = (Path(ROOT) / "docs/safety.md").read_text()


@pytest.mark.parametrize("guard", GUARDS, ids=lambda guard: guard.name)
def test_a_guard_can_be_removed(guard):
    source = (ROOT / "src/metropilot" / guard.file).read_text()
    without = remove_guard(source, guard)
    assert without != source
    compile(without, guard.file, "exec")


def test_the_page_lists_every_guard_and_none_survived():
    begin, end = PAGE.index("<!-- benchmark: mutate_guards -->"), PAGE.index("<!-- end: mutate_guards -->")
    rows = re.findall(r"^\| (\w+) \| (.+?) \| `.+?` \| `?(.+?)`? \|$", PAGE[begin:end], re.MULTILINE)
    left = re.search(r"^Not run yet: (.+)\.$", PAGE[begin:end], re.MULTILINE)
    missing = left[1].split("; ") if left else []
    wanted = [(guard.hazard, guard.name) for guard in GUARDS if guard.name not in missing]
    assert [(hazard, name) for hazard, name, _ in rows] == wanted
    for _, name, test in rows:
        file = test.split("::")[0]
        assert file in ALL, name
        assert (ROOT / "tests/protection" / file).exists(), name


def test_every_hazard_of_the_page_has_a_guard():
    hazards = set(re.findall(r"^\| (H\d+) \|", PAGE, re.MULTILINE))
    assert hazards == {guard.hazard for guard in GUARDS if guard.hazard != "comfort"}
