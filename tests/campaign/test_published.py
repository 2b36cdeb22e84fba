"""Published rows are those of their pages, and a row is the run that it was."""

import json
from pathlib import Path

import duckdb
import pytest

from metropilot._published import published_file
from metropilot.campaign import (
    PUBLISHED,
    CampaignRows,
    campaign_from_values,
    publish_rows,
    published_rows,
    read_campaign,
    restore_rows,
    run_campaign,
)
from metropilot.campaign.declared import seed_of
from metropilot.campaign.leaderboard import _table, disturbance_words, find_results
from metropilot.campaign.rows import request_of_row
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.railway import document_text
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


@pytest.mark.parametrize("name", ["leaderboard", "robustness", "trainsets"])
def test_findings_and_disturbances_of_a_page_are_those_of_its_rows(name):
    found = published_rows(name)
    with found.open() as database:
        cells = found.campaign.statistics(database)["cells"]
    page = published_file(f"{name}.md").read_text()
    findings = find_results(found.campaign, cells)
    assert len(findings) == 3
    assert page.index("\n".join(findings)) < page.index("## Nominal")
    for told in found.campaign.disturbances:
        words = disturbance_words(told)
        assert f"\n\n{words}.\n\n" in page or not words


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


def test_a_campaign_goes_on_from_the_rows_of_another_folder(tmp_path):
    """With its line elsewhere: same digest, same seeds, the same bytes in every shard."""
    text = document_text("line", "yizhuang")
    campaigns = []
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.toml").write_text(text)
        values = {"drivers": ["flat_out"], "sections": [f"{tmp_path / name / 'mine.toml'} RJ WYJ"]}
        values |= {"loads": ["AW2"], "times": [1.3], "seeds": 3}
        noisy = [{"name": "heavy", "mass_factor": [1.0, 1.2]}]
        told = {"name": "moved", "matrix": values, "disturbance": noisy}
        campaigns.append(campaign_from_values(tmp_path / "moved.toml", told))
    here, there = campaigns
    assert here.digest == there.digest
    assert [seed_of(c, c.case(2)) for c in campaigns] == [seed_of(here, here.case(2))] * 2
    run_campaign(here, tmp_path / "a", workers=1)
    shown, path = CampaignRows(tmp_path / "a", here), tmp_path / "rows.parquet"
    shown.write(path, {str(tmp_path / "here"): "upload-1"})
    names = {"upload-1": str(tmp_path / "there")}
    assert restore_rows(there, tmp_path / "b", path, names) == 3
    assert run_campaign(there, tmp_path / "b", workers=1).driven == 0
    rows = [CampaignRows(tmp_path / folder, c).find()[1] for folder, c in (("a", here), ("b", there))]
    assert [row["line"] for row in rows[1]] == [str(tmp_path / "there" / "mine.toml")] * 3
    assert [row | {"line": ""} for row in rows[0]] == [row | {"line": ""} for row in rows[1]]
    # a shard that is not whole is left out, and computed again
    with duckdb.connect() as database:
        database.execute(f"COPY (SELECT * FROM '{path}' WHERE row < 2) TO '{tmp_path / 'two.parquet'}'")
        database.execute(f"COPY (SELECT 1 AS row) TO '{tmp_path / 'other.parquet'}'")
    assert restore_rows(there, tmp_path / "c", tmp_path / "two.parquet", names) == 2
    assert run_campaign(there, tmp_path / "c", workers=1).driven == 1
    again = CampaignRows(tmp_path / "c", there).find()[1][2]
    assert again["energy_wheel_kwh"] == rows[0][2]["energy_wheel_kwh"]
    with pytest.raises(InputError, match="not the rows of a campaign"):
        restore_rows(there, tmp_path / "d", tmp_path / "other.parquet", names)
    (tmp_path / "there" / "mine.toml").write_text(text + "# changed\n")
    assert here.digest != there.digest
