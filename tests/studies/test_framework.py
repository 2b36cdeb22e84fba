"""The frame of every study: rows, pages, learning runs that are kept and resumed, the command."""

import json
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.learn.problems import DoubleIntegrator

from metropilot import studies
from metropilot._registry import RegistryRow
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.learn import PPOConfig
from metropilot.studies import STUDIES, Figure, LearnJob, Order, ReportRow, Study, StudyReport, learn_seeds

SMALL = PPOConfig(steps=4096, environments=16, rollout=32, epochs=2, minibatches=4, evaluations=2)


def drawing():
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(2, 1))
    figure.subplots().plot([0, 1], [1, 0])
    return figure


def some_report(order):
    row = ReportRow("Table 5", "120 s", "dqn", "energy", "kWh", published=17.05, optimum=12.4)
    rows = [
        row.with_values([13.0, 12.9, 13.4]),
        ReportRow("Table 5", "120 s", "dqn", "switches", "", ours=4.0),
    ]
    figure = Figure("reward", "Reward over episodes (its fig. 6).", drawing)
    return StudyReport(3, rows, [figure], ["A sentence."], ["Another."])


SOME = Study("some2020", "Some paper", "Some, A., 2020.", some_report, {"reference": ("s_curve", "optimal")})


@pytest.fixture
def only_some_study(monkeypatch):
    monkeypatch.setattr(STUDIES, "_rows", {"some2020": RegistryRow(SOME, "A study of the tests")})


def test_a_row_is_the_median_and_range_of_its_seeds():
    row = ReportRow("t", "c", "d", "k", "u").with_values([3.0, 1.0, 10.0])
    assert (row.ours, row.low, row.high) == (3.0, 1.0, 10.0)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_a_row_that_was_not_measured_is_refused(values):
    with pytest.raises(InputError, match="not measured"):
        ReportRow("t", "c", "d", "k", "u").with_values(values)


def test_reproduce_writes_report_page_and_figures(only_some_study, tmp_path, capsys):
    out, docs = tmp_path / "out", tmp_path / "docs"
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "some2020", "--out", str(out), "--write-docs", str(docs), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "report.json").read_text())
    assert set(printed) >= {"study", "budget", "seeds", "seconds", "rows"}
    assert printed["rows"][0] == {
        "table": "Table 5",
        "case": "120 s",
        "driver": "dqn",
        "kpi": "energy",
        "unit": "kWh",
        "published": 17.05,
        "ours": 13.0,
        "low": 12.9,
        "high": 13.4,
        "optimum": 12.4,
        "values": [13.0, 12.9, 13.4],
    }
    page = (docs / "some2020.md").read_text()
    assert "| 120 s | `dqn` | energy | kWh | 17.05 | 13.00 | 12.90 … 13.40 | 12.40 |" in page
    assert "|  |  | switches |  | – | 4.00 | – | – |" in page
    assert "1. A sentence." in page
    assert {p.name for p in (docs / "some2020").iterdir()} == {"reward.png", "rows.csv"}
    assert {p.name for p in (out / "some2020").iterdir()} == {"reward.png", "reward.svg", "rows.csv"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["other"], "study"),
        (["some2020", "--budget", "large"], "quick, paper"),
        (["some2020", "--reference", "square"], "s_curve, optimal"),
        (["some2020", "--set", "colour=red"], "reference"),
        (["some2020", "--set", "colour"], "NAME=VALUE"),
        (["some2020", "--seeds", "0"], "--seeds: out of range"),
    ],
)
def test_what_cannot_be_done_is_one_line(only_some_study, tmp_path, capsys, arguments, said):
    with pytest.raises(SystemExit, match="2"):
        main(["reproduce", *arguments, "--out", str(tmp_path)])
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


@pytest.mark.parametrize("study_id", list(STUDIES))
def test_every_study_loads_and_names_itself(study_id):
    assert studies.STUDIES.get(study_id).id == study_id


def test_learning_runs_are_kept_and_not_done_twice(tmp_path: Path):
    jobs = [LearnJob("small", SMALL, partial(DoubleIntegrator), seed) for seed in (0, 1)]
    said: list[str] = []
    first = learn_seeds(jobs, tmp_path, processes=2, say=said.append)
    assert len(said) == 3
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.safetensors")}
    assert len(before) == 2, "no checkpoint is left behind"
    again = learn_seeds(jobs, tmp_path, say=said.append)
    assert len(said) == 3
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.safetensors")} == before
    for one, other in zip(first, again, strict=True):
        assert one.score == other.score
        assert all(np.array_equal(one.policy.params[k], other.policy.params[k]) for k in one.policy.params)
    assert not np.array_equal(
        first[0].policy.params["policy.0.weight"], first[1].policy.params["policy.0.weight"]
    )
    changed = LearnJob("small", SMALL, DoubleIntegrator, 0, about={"task": "another"})
    assert not studies.learning.is_done(changed, tmp_path)


def _noting_task(file: Path) -> DoubleIntegrator:
    """Make the task, and note in which process."""
    file.write_text(str(os.getpid()))
    return DoubleIntegrator()


def test_a_single_learning_run_has_a_process_of_its_own(tmp_path: Path):
    """XLA crashes a process in which Ctrl-C ends a learning run."""
    noted = tmp_path / "process.txt"
    jobs = [LearnJob("small", SMALL, partial(_noting_task, noted), 0)]
    learn_seeds(jobs, tmp_path, processes=1)
    assert int(noted.read_text()) != os.getpid()


def test_two_runs_of_one_name_and_seed_are_refused(tmp_path):
    with pytest.raises(InputError, match="share name and seed"):
        learn_seeds([LearnJob("a", SMALL, DoubleIntegrator, 0)] * 2, tmp_path)


def test_an_order_knows_its_seeds():
    order = Order(Path())
    assert order.choose_seeds(quick=1, paper=5) == range(1)
    assert Order(Path(), "paper").choose_seeds(quick=1, paper=5) == range(5)
    assert Order(Path(), "paper", seeds=2).choose_seeds(quick=1, paper=5) == range(2)
