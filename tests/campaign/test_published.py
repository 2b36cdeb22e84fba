"""Published rows are those of their pages, and a row is the run that it was."""

import json
from pathlib import Path

import pytest

from metropilot.campaign import PUBLISHED, publish_rows, published_rows, read_campaign, run_campaign
from metropilot.campaign.leaderboard import _table
from metropilot.campaign.rows import request_of_row
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.sim import drive
from metropilot.units import J_PER_KWH

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_tables_of_a_page_are_those_of_its_rows(name):
    found, page = published_rows(name), (DOCS / f"{name}.md").read_text()
    assert found.written in page
    cells = found.statistics()["cells"]
    for disturbance in found.campaign.disturbances:
        rows = [row for row in cells if row["disturbance"] == disturbance.name]
        assert rows
        assert "\n".join(_table(rows)) in page


def test_rows_are_found_and_sorted():
    found = published_rows("robustness")
    count, rows = found.find(
        {"driver": "mpc", "success": "true"}, sort="optimality_gap_percent", ascending=False, limit=7
    )
    gaps = [row["optimality_gap_percent"] for row in rows]
    assert count > len(gaps) == 7
    assert gaps == sorted(gaps, reverse=True)
    assert {row["driver"] for row in rows} == {"mpc"}
    assert found.find({"driver": "mpc"}, offset=count, limit=7)[0] >= count
    for bad in ({"sort": "row; DROP TABLE runs"}, {"wanted": {'"': "x"}}):
        with pytest.raises(InputError, match=r"column: no such column"):
            found.find(**bad)


def test_a_row_that_was_not_driven_is_refused():
    campaign = published_rows("leaderboard").campaign
    with pytest.raises(InputError, match="row: has no scheduled time"):
        request_of_row(campaign, {"row": 0, "scheduled_time_s": None})


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("robustness", "a restriction on the way"), ("leaderboard", "trainset with dead time")],
)
def test_a_row_is_driven_again_to_the_same_bits(name, wanted):
    found = published_rows(name)
    _, (row, *_) = found.find(
        {"driver": "ston" if name == "leaderboard" else "ppo", "disturbance": wanted}, limit=1
    )
    request = found.request(row["row"])
    driven = drive(request.run(), request.make_driver())
    assert driven.trajectory.energy_wheel_j[-1] / J_PER_KWH == pytest.approx(
        row["energy_wheel_kwh"], rel=1e-9
    )
    assert driven.running_time_s == pytest.approx(row["running_time_s"], rel=1e-9)


def test_a_row_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="row: no such row: 1560"):
        published_rows("robustness").request(1560)
    with pytest.raises(InputError, match="no such rows"):
        published_rows("../leaderboard")


def test_rows_are_published_with_their_campaign(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("metropilot.campaign.published.PUBLISHED", ("tiny",))
    monkeypatch.setattr("metropilot.campaign.published.published_file", lambda name: tmp_path / name)
    (tmp_path / "tiny.toml").write_text(
        'name = "it\'s tiny"\n[matrix]\ndrivers = ["flat_out"]\n'
        'sections = ["yizhuang RJ WYJ"]\nloads = ["AW2"]\n'
    )
    campaign = read_campaign(str(tmp_path / "tiny.toml"))
    run_campaign(campaign, tmp_path / "run", workers=1)
    publish_rows(tmp_path / "run", tmp_path / "tiny.parquet", "Written by 'me'.")
    found = published_rows("tiny")
    assert found.campaign == campaign
    assert found.written == "Written by 'me'."
    count, (row,) = found.find()
    assert (count, row["driver"], row["outcome"]) == (1, "flat_out", "arrived")
    assert row["decision_us_median"] > 0
    with pytest.raises(InputError, match=r"write-rows: not a file of rows"):
        publish_rows(tmp_path / "run", tmp_path / "tiny.csv", "")
    with pytest.raises(SystemExit) as refused:
        main(["campaign", "example", "--write-rows", "rows.csv", "--json"])
    assert refused.value.code == 2
    assert json.loads(capsys.readouterr().out)["error"]["field"] == "write-rows"
