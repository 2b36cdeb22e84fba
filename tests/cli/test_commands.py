"""Every command: what it prints, its JSON, its files, its exit code.

What drives runs as a program: this process checks types at run time, which makes a drive ten times slower.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module

import pytest

from metropilot.cli.app import COMMANDS
from metropilot.cli.convoy import name_trainsets
from metropilot.convoy import FOLLOWERS, ConvoyRequest
from metropilot.drivers import DRIVERS
from metropilot.evaluate import RunSpec
from metropilot.sim import COLUMNS

RUN = ("yizhuang", "RJ", "WYJ", "--time", "101")
EXAMPLES = {
    line: name for name, (module, _) in COMMANDS.items() for line in import_module(module).EXAMPLES[name]
}


def answer(said, code=0):
    assert said.code == code, said
    assert said.err == ""
    return json.loads(said.out)


def test_drive_prints_kpis(program):
    said = program("drive", *RUN, "--driver", "flat_out")
    assert said.code == 1
    assert "arrived 13." in said.out
    assert "FAILED" in said.out


def test_drive_json_and_folder_agree(typed, tmp_path):
    kpis = answer(typed("drive", *RUN, "--driver", "flat_out", "--out", "out", "--json"), 1)
    assert kpis == json.loads((tmp_path / "out" / "kpis.json").read_text())
    assert kpis["outcome"] == "arrived"
    header = (tmp_path / "out" / "trajectory.csv").read_text().splitlines()[0]
    assert header.split(",") == list(COLUMNS)
    told = typed("drive", *RUN, "--driver", "flat_out", "--out", "out").out.partition("Written to out: ")[2]
    assert set(told.split()) == {path.name for path in (tmp_path / "out").iterdir()}
    again = answer(typed("drive", "--from", "out/run.toml", "--json"), 1)
    del kpis["decision_time_us_median"], again["decision_time_us_median"]
    assert again == kpis


def test_drive_on_time_is_zero(typed):
    fast = answer(typed("drive", *RUN, "--driver", "flat_out", "--json"), 1)
    on_time = str(round(fast["running_time_s"]))
    said = typed("drive", *RUN[:3], "--time", on_time, "--driver", "flat_out")
    assert said.code == 0
    assert "arrived safely and on time" in said.out


def test_a_requirement_shown_as_failed_is_in_headline_json_and_exit_code(typed):
    words = ("drive", *RUN, "--driver", "manual")
    said = typed(*words)
    assert said.code == 1
    assert "arrived on time, but jerk 1.57 m/s³" in said.out.splitlines()[0]
    kpis = answer(typed(*words, "--json"), 1)
    assert (kpis["success"], kpis["failed"]) == (False, ["jerk"])


def test_a_convoy_ends_as_its_worst_trainset(typed):
    words = ("convoy", *RUN[:3], "--time", "115", "--driver", "follow_pid")
    said = typed(*words)
    assert said.code == 1
    assert ": trainset 2 " in said.out.splitlines()[0]
    kpis = answer(typed(*words, "--json"), 1)
    assert not kpis["success"]
    assert "jerk" in kpis["failed"]
    assert [row["success"] for row in kpis["trainsets"]] == [True, False]
    assert typed(*words[:-2]).code == 0


def test_compare(typed, tmp_path):
    table = answer(typed("compare", *RUN, "--drivers", "flat_out,manual", "--out", "out", "--json"))
    assert [d["driver"] for d in table["drivers"]] == ["flat_out", "manual"]
    assert table["run"]["time_s"] == 101.0
    assert (tmp_path / "out" / "comparison.png").stat().st_size > 10_000
    said = typed("compare", *RUN, "--drivers", "flat_out,manual", "--seeds", "2")
    assert said.code == 0
    assert "early" in said.out
    assert "95 % interval" in said.out


WORDS = {
    "compare": (*RUN, "--drivers", "flat_out,manual", "--seeds", "2", "--speed-noise", "0.05"),
    "convoy": ("yizhuang", "YZQ", "WHY", "--trainset", "cheng2023", "--time", "110"),
}


def whole(text, words, width):
    """True if the words all stand in the text, none broken, and no line is wider than the output."""
    return max(map(len, text.splitlines())) <= width and set(words) <= set(text.replace("*", " ").split())


@pytest.mark.parametrize("width", [60, 80, 120, 200])
@pytest.mark.parametrize("name", WORDS)
def test_a_table_breaks_between_words_only(typed, name, width):
    said = typed(name, *WORDS[name], columns=width)
    ids = {
        "compare": ("flat_out", "manual", "outcome"),
        "convoy": ("follow_plan", "trainset", "interventions"),
    }
    assert whole(said.out, ids[name], width), said.out
    assert ("left out at this width" in said.out) == (width < 120)
    if width == 200:
        assert max(map(len, said.out.splitlines())) > 100


@pytest.mark.parametrize("width", [60, 80])
@pytest.mark.parametrize(("name", "words"), [("lines", "Songjiazhuang"), ("trainsets", "CN_Beijing_Subway")])
def test_the_catalogue_breaks_between_words_only(metropilot, monkeypatch, name, words, width):
    monkeypatch.setenv("COLUMNS", str(width))
    said = metropilot(name).out
    assert whole(said, [words], width), said


def summary_row(name):
    shares = {"runs": 1014, "successes": 1001, "possible": 1014, "intervened": 12, "failed": 0}
    gaps = {"gap_median": 12.34, "gap_95": 23.4, "gap_worst": 145.6}
    return {
        "driver": name,
        **shares,
        **gaps,
        "late_worst_s": 12.34,
        "stop_worst_m": 0.123,
        "decision_us_median": 1234.0,
    }


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_a_campaigns_table_breaks_between_words_only(capsys, monkeypatch, tmp_path, width):
    from metropilot.cli.campaign import report

    monkeypatch.setenv("COLUMNS", str(width))
    rows = [summary_row("generalist"), summary_row("improved_dqn")]
    report({"drivers": rows, "campaign": "c", "done": 1, "rows": 1, "sitting": {"driven": 0}})
    said = capsys.readouterr().out
    assert whole(said, ("generalist", "improved_dqn", "median", "12.34", "1014"), width), said


@pytest.mark.parametrize(
    ("behind", "words"),
    [
        ((), "4 x dkz32 AW0"),
        (("cheng2023",), "4 trainsets (dkz32 AW0, cheng2023, cheng2023, cheng2023)"),
        (("cheng2023", "dkz32:AW3"), "4 trainsets (dkz32 AW0, cheng2023, dkz32:AW3, dkz32:AW3)"),
    ],
)
def test_a_mixed_convoy_is_named_by_each_trainset(behind, words):
    """`3 x dkz32 AW0, cheng2023, dkz32` read as five trainsets."""
    head = RunSpec("yizhuang", "RJ", "WYJ", time_s=115.0, trainset="dkz32", dt_s=0.1)
    assert name_trainsets(ConvoyRequest(head, count=4, behind=behind)) == words


def test_a_convoy_leaves_a_trajectory_of_every_trainset(typed, tmp_path):
    asked = ("--time", "115", "--trainsets", "3", "--out", "out", "--json")
    kpis = answer(typed("convoy", *RUN[:3], *asked))
    assert kpis == json.loads((tmp_path / "out" / "kpis.json").read_text())
    for number in (1, 2, 3):
        lines = (tmp_path / "out" / f"trajectory-{number}.csv").read_text().splitlines()
        assert lines[0].split(",")[0] == COLUMNS[0]
        assert len(lines) > 1000
    assert not (tmp_path / "out" / "trajectory-4.csv").exists()


def test_a_convoy_is_driven_again(typed, tmp_path):
    """Every value of a request is in its file: masses, a link that loses, options, a restriction."""
    words = ("--trainset", "cheng2023", "--time", "125", "--mass-factors", "1,1.1", "--link-delay", "0.3")
    words += (
        "--link-loss",
        "0.1",
        "--driver",
        "follow_gap",
        "--set",
        "time_gap_s=0.5",
        "--restriction",
        "400-600@50@20",
    )
    words += ("--seed", "3", "--speed-noise", "0.02")
    asked = ("convoy", "yizhuang", "YZQ", "WHY", *words, "--out", "out", "--json")
    code = typed(*asked).code
    kpis = json.loads((tmp_path / "out" / "kpis.json").read_text())
    again = answer(typed("convoy", "--from", "out/run.json", "--out", "again", "--json"), code)
    for told in (kpis, again):
        for member in told["trainsets"]:
            del member["decision_time_us_median"]
    assert again == kpis
    runs = [json.loads((tmp_path / name / "run.json").read_text())["run"] for name in ("out", "again")]
    assert runs[0] == runs[1]


def test_plan_of_a_run(metropilot, tmp_path):
    plan = answer(metropilot("plan", *RUN, "--out", tmp_path, "--json"))
    assert plan["running_time_s"] == pytest.approx(101, abs=0.01)
    assert abs(plan["certificate_gap_percent"]) < 0.1
    assert plan["bound_kwh"] <= plan["energy_kwh"] * (1 + 1e-6)
    assert len({len(plan["profile"][k]) for k in ("position_m", "time_s", "speed_mps")}) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plan.csv", "plan.json", "plan.png", "plan.svg"]


def test_plan_of_a_run_on_the_screen(metropilot):
    assert "lower bound" in metropilot("plan", *RUN).out


def test_front_falls(metropilot):
    table = answer(metropilot("plan", *RUN[:3], "--front", "--json"))
    energy = [point["energy_kwh"] for point in table["front"]]
    assert energy == sorted(energy, reverse=True)


def test_journey_keeps_the_timetable_or_spreads_the_total(metropilot):
    kept = answer(metropilot("plan", "yizhuang", "WHY", "RC", "--stopping", "--json"))
    assert [c["name"] for c in kept["calls"]] == ["WHY", "WYJ", "RJ", "RC"]
    total = kept["calls"][-1]["arrival_s"]
    assert kept["running_time_s"] == total
    spread = answer(metropilot("plan", "yizhuang", "WHY", "RC", "--stopping", "--time", total, "--json"))
    assert spread["running_time_s"] == pytest.approx(total, abs=0.1)
    assert spread["energy_kwh"] < kept["energy_kwh"]


def test_journey_file(metropilot, tmp_path):
    from metropilot.railway import load_line, planned_journey, write_journey

    write_journey(planned_journey(load_line("yizhuang")), tmp_path / "journey.toml")
    table = answer(metropilot("plan", "yizhuang", "--journey", tmp_path / "journey.toml", "--json"))
    assert len(table["calls"]) == 14


def test_a_journey_of_another_line_is_refused(metropilot, tmp_path):
    from metropilot.railway import load_line, planned_journey, write_journey

    write_journey(planned_journey(load_line("yizhuang")), tmp_path / "journey.toml")
    said = metropilot("plan", "yizhuang-ttobench", "--journey", tmp_path / "journey.toml")
    assert (said.code, said.out) == (2, "")
    assert "line: a journey of another line: 'yizhuang' (allowed: yizhuang-ttobench)" in said.err
    text = (tmp_path / "journey.toml").read_text().replace('line = "yizhuang"\n', "")
    (tmp_path / "any.toml").write_text(text)
    assert metropilot("plan", "yizhuang-ttobench", "--journey", tmp_path / "any.toml").code == 0


STEEP = """
kind = "line"
id = "steep"
name = "Steep"
stations.unit = "m"
stations.list = [
  { code = "A", name = "Alpha", position = 0 },
  { code = "B", name = "Beta", position = 1200 },
  { code = "C", name = "Gamma", position = 3200 },
]
speed_limits = { units = { from = "m", speed = "km/h" }, values = [[-200, 60]] }
gradients = { units = { from = "m", gradient = "permil" }, values = [[-200, 0], [1300, 140], [2800, 0]] }
"""


@pytest.mark.parametrize(
    "words",
    [
        ("plan", "--time", "400"),
        ("plan", "B", "C", "--front"),
        ("capacity",),
        ("plan", "A", "C", "--stopping"),
    ],
)
def test_a_stall_names_the_section(metropilot, tmp_path, words):
    (tmp_path / "steep.toml").write_text(STEEP)
    command, *rest = words
    more = ("--time", "400") if "--stopping" in words else ()
    said = metropilot(command, tmp_path / "steep.toml", *rest, *more)
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert re.search(r"section: the trainset stalls at \d+ m, .*: 'B-C'$", said.err.strip())


def test_a_timing_point_of_a_file_that_nobody_keeps_is_one_line(metropilot, tmp_path):
    points = "[{ position = 0 }, { position = 30, slowest = 50 }, { position = 2631, latest = 230 }]"
    head = 'kind = "journey"\nid = "j"\nline = "yizhuang"\n[timing_points]\n'
    units = 'units = { position = "m", time = "s", speed = "km/h" }\n'
    (tmp_path / "j.toml").write_text(f"{head}{units}list = {points}\n")
    said = metropilot("plan", "yizhuang", "--journey", tmp_path / "j.toml")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "j.toml: slowest: 30 m cannot be passed faster than " in said.err


@pytest.mark.parametrize("name", ["lines", "trainsets", "drivers", "drivers --followers"])
def test_catalogue(metropilot, name):
    rows = answer(metropilot(*name.split(), "--json"))
    text = metropilot(*name.split()).out
    assert rows
    for row in rows:
        assert row["id"] in text


def test_drivers_are_the_registry(metropilot):
    assert [d["id"] for d in answer(metropilot("drivers", "--json"))] == list(DRIVERS.ids())
    followers = answer(metropilot("drivers", "--followers", "--json"))
    assert [d["id"] for d in followers] == list(FOLLOWERS.ids())


@pytest.mark.parametrize(
    ("what", "kind", "words"),
    [
        ("yizhuang", "line", "Songjiazhuang"),
        ("yizhuang-ttobench", "line", "9247"),
        ("dkz32:AW2", "trainset", "electric brake kN"),
        ("flat_out", "driver", "source: own"),
        *((key, "driver", "source: ") for key in DRIVERS.ids() if key != "flat_out"),
        *((key, "follower", "source: ") for key in FOLLOWERS.ids()),
    ],
)
def test_show(metropilot, what, kind, words):
    assert answer(metropilot("show", what, "--json"))["kind"] == kind
    assert words in metropilot("show", what).out


def test_show_a_run_and_a_file(metropilot, typed, tmp_path):
    from metropilot.railway import load_trainset, write_trainset

    typed("drive", *RUN, "--driver", "flat_out", "--out", "run")
    assert answer(metropilot("show", tmp_path / "run", "--json"))["result"]["outcome"] == "arrived"
    assert "running_time_s" in metropilot("show", tmp_path / "run").out
    write_trainset(load_trainset("dkz32"), tmp_path / "mine.toml")
    assert answer(metropilot("show", tmp_path / "mine.toml", "--json"))["id"] == "dkz32"


def test_import_writes_toml_that_drives(metropilot, tmp_path):
    from metropilot.railway import export_ttobench, load_line

    source = tmp_path / "track.json"
    export_ttobench(load_line("yizhuang-ttobench"), source)
    table = answer(metropilot("import", source, "--out", tmp_path / "mine.toml", "--json"))
    assert table["kind"] == "line"
    assert any("stations" in words for words in table["used"])
    said = metropilot("import", source, "--out", tmp_path / "mine.toml")
    assert said.code == 2
    assert "exists" in said.err
    assert metropilot("import", source, "--out", tmp_path / "mine.toml", "--force").code == 0
    assert metropilot("show", tmp_path / "mine.toml").code == 0


def test_help_lists_what_the_commands_say(metropilot):
    text = " ".join(metropilot("--help").out.replace("│", " ").split())
    for name, (module, summary) in COMMANDS.items():
        body = getattr(import_module(module), f"{name}_command")
        assert body.__doc__.splitlines()[0] == summary
        assert summary in text
        own = metropilot(name, "--help").out
        assert "--json" in own
        assert "Examples" in own


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("dri", ["drive", "drivers"]),
        ("drive yi", ["yizhuang", "yizhuang-ttobench"]),
        ("drive yizhuang R", ["RJ", "RC"]),
        ("drive nowhere R", []),
        ("drive yizhuang RJ WYJ --trainset dkz", ["dkz32", "dkz32-contest"]),
        ("drive yizhuang RJ WYJ --driver ppo", ["ppo", "ppo_scaled"]),
        ("drive yizhuang RJ WYJ --ti", ["--time"]),
        ("compare yizhuang RJ WYJ --drivers pid,opt", ["pid,optimal"]),
        ("convoy yizhuang RJ WYJ --driver follow_m", ["follow_mpc"]),
        ("plan yizhuang RJ WY", ["WYJ"]),
        ("show follow_g", ["follow_gap"]),
        ("reproduce lu", ["lu2023"]),
    ],
)
def test_a_shell_completes(program, line, words):
    asked = {"COMP_WORDS": f"metropilot {line}", "COMP_CWORD": str(len(line.split()))}
    said = program(env={**os.environ, **asked, "_METROPILOT_COMPLETE": "complete_bash"})
    assert (said.code, said.out.split()) == (0, words), said.err


def test_the_script_that_makes_a_shell_complete(metropilot, monkeypatch):
    monkeypatch.setenv("SHELL", "/bin/bash")
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    said = metropilot("--show-completion", "bash")
    assert said.code == 0
    assert "complete_bash" in said.out


def test_version(metropilot):
    import metropilot as package

    assert metropilot("--version").out.split() == ["metropilot", package.__version__]


def test_as_a_module(metropilot):
    command = [sys.executable, "-m", "metropilot", "--version"]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    assert said.stdout == metropilot("--version").out


def test_nothing_asked_shows_the_help(metropilot):
    said = metropilot()
    assert said.code == 2
    assert "Commands" in said.out


ELSEWHERE = (
    "--from",
    "import",
    ".toml",
    "metropilot capacity yizhuang --",
    *(f"metropilot {c}" for c in ("campaign", "reproduce", "learn", "export", "fit", "serve")),
)
"""Examples that need a file, or learn for minutes: the tests of their own packages run those."""


@pytest.mark.parametrize("line", [e for e in EXAMPLES if not any(part in e for part in ELSEWHERE)])
def test_examples_in_the_help_run(typed, line):
    if line == "metropilot show drive":
        typed("drive", *RUN, "--driver", "flat_out", "--out", "drive")
    said = typed(*shlex.split(line)[1:])
    assert said.code in (0, 1), said.err
    assert said.err == ""
