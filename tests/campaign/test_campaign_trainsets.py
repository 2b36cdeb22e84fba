"""Campaigns over trainsets: declared dead time, random trainsets, control periods, samples, the page."""

from collections import Counter
from dataclasses import replace

import duckdb
import pytest

from metropilot.campaign import (
    Campaign,
    DisturbanceCase,
    collect_parts,
    read_campaign,
    run_campaign,
    summarise,
    write_campaign_page,
)
from metropilot.campaign.declared import case_request, seed_of
from metropilot.campaign.matrix import Shard, from_text
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.railway import parse_trainset
from metropilot.sim import Outcome, drive

FILE = """
name = "mine"
[matrix]
drivers = ["flat_out"]
sections = ["lu2023", "yizhuang RJ WYJ"]
trainsets = ["dkz32", { drawn = 3, seed = 5 }]
loads = ["least", "most"]
times = [1.3]
actuation = ["own", [0.0, 0.0], [0.6, 0.4]]
periods = [0.2, 0.5]
[[disturbance]]
name = "nominal"
"""


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return str(path)


@pytest.fixture
def campaign(tmp_path):
    return read_campaign(written(tmp_path, FILE))


def test_the_matrix_has_an_axis_for_each(campaign):
    assert campaign.rows == 3 * 8 * 2 * 3
    cases = [campaign.case(row) for row in range(campaign.rows)]
    assert len({(*case[1:8], case.period_s) for case in cases}) == campaign.rows
    keys = Counter(parse_trainset(case.trainset).actuation for case in cases)
    assert keys == {None: 48, (0.0, 0.0): 48, (0.6, 0.4): 48}
    assert {case.load for case in cases} == {"AW0", "AW3", "least", "most"}
    assert {case.trainset for case in cases} >= {"dkz32", "dkz32@0.6,0.4", "drawn-5-3@0,0"}
    assert from_text(campaign.text) == campaign
    assert from_text(campaign.text).digest != replace(campaign, actuations=(None,)).digest


def test_the_request_has_the_declared_dead_time_and_the_period(campaign):
    cases = [campaign.case(row) for row in range(campaign.rows)]
    late = next(c for c in cases if c.trainset == "dkz32@0.6,0.4" and c.period_s == 0.5)
    request = case_request(campaign, late, 120.0, 1000.0)
    actuation = request.loaded_trainset().actuation
    assert (actuation.delay_s, actuation.lag_s, request.dt_s) == (0.6, 0.4, 0.5)
    assert request.disturbance.delay_s == 0.0


def test_the_seed_knows_neither_actuation_nor_period(campaign):
    cases = [campaign.case(row) for row in range(campaign.rows)]
    assert len({seed_of(campaign, case) for case in cases}) == campaign.rows // (3 * 2)


def test_a_sample_takes_every_value_equally_often_and_crosses_drivers_and_actuations():
    campaign = read_campaign("trainsets")
    assert campaign.rows == 11 * 50 * 4
    cells = [campaign.case(row) for row in range(campaign.cells)]
    assert len({str(case) for case in cells}) == campaign.cells
    lines = Counter(case.line for case in cells)
    assert max(lines.values()) - min(lines.values()) <= 4
    assert Counter(case.period_s for case in cells)[0.5] in {48, 52}
    groups = Counter((c[2:5], parse_trainset(c.trainset).id, c.load, c.time, c.period_s) for c in cells)
    assert set(groups.values()) == {4}
    again = [campaign.case(row + campaign.cells)[2:] for row in range(campaign.cells)]
    assert again == [case[2:] for case in cells]
    whole = read_campaign("trainsets", sample=0)
    assert whole.rows == 11 * 60 * 72 * 2 * 4 * 4
    assert {case[1:5] for case in cells} <= {("optimal", *section) for section in whole.sections}
    assert read_campaign("trainsets", sample=3).rows == 11 * 3 * 4


@pytest.mark.parametrize("name", ["robustness", "leaderboard"])
def test_a_row_with_dead_time_ships(name):
    campaign = read_campaign(name)
    (told,) = (item for item in campaign.disturbances if item.name == "trainset with dead time")
    assert told.actuation == (0.6, 0.4)
    assert told.plant_is_nominal
    case = next(c for c in map(campaign.case, range(campaign.rows)) if c.disturbance == told)
    assert parse_trainset(case.trainset).actuation == (0.6, 0.4)
    assert ("dkz32@0.6,0.4", case.load) in campaign.trainset_keys


def test_a_batch_is_never_late_and_has_one_period():
    batch = Campaign("batch", ("ppo",), (("lu2023", "WHY", "WYJ"),), (("dkz32", "AW2"),), engine="compiled")
    nominal = DisturbanceCase("nominal")
    assert batch.is_compiled("ppo", nominal, ("dkz32", "AW2"))
    assert not batch.is_compiled("ppo", nominal, ("dkz32@0.6,0.4", "AW2"))
    assert not replace(batch, periods=(0.2, 0.5)).is_compiled("ppo", nominal, ("dkz32", "AW2"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("drawn = 3", "drawn = 0", "drawn"),
        ("seed = 5", "sed = 5", "matrix.trainsets"),
        ('"dkz32", {', '"dkz23", {', "matrix.trainsets: unknown trainset, did you mean 'dkz32'"),
        ('"most"]', '"crush"]', "matrix.loads: unknown load"),
        ("[0.6, 0.4]", "[9.0, 0.4]", "matrix.actuation"),
        ("[0.6, 0.4]", "[0.6]", "matrix.actuation"),
        ('"own"', '"none"', "matrix.actuation"),
        ("[0.2, 0.5]", "[0.2, 50]", "matrix.periods: out of range: 50"),
        ("[0.2, 0.5]", "[]", "matrix.periods"),
        ('name = "mine"', 'name = "mine"\ndt_s = 0.2', "dt_s: excludes matrix.periods"),
        ("times = [1.3]", "times = [1.3]\nsample = 0", "matrix.sample"),
        ('"nominal"', '"nominal"\nideal = true\nactuation = [1, 0]', "nominal.actuation: excludes ideal"),
        ('"nominal"', '"nominal"\nactuation = [-1, 0]', "disturbance.0.actuation"),
    ],
)
def test_what_cannot_be_used_is_one_line(tmp_path, capsys, old, new, words):
    assert old in FILE
    with pytest.raises(InputError, match=words):
        read_campaign(written(tmp_path, FILE.replace(old, new)))
    with pytest.raises(SystemExit) as stop:
        main(["campaign", written(tmp_path, FILE.replace(old, new)), "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_negative_sample_is_refused():
    with pytest.raises(InputError, match="sample: out of range"):
        read_campaign("trainsets", sample=-1)


def test_it_is_driven_and_the_page_says_what_failed(tmp_path, monkeypatch, campaign):
    from metropilot.drivers import FlatOut

    small = replace(
        campaign,
        sections=campaign.sections[:1],
        trainsets=campaign.trainsets[1:3],
        actuations=((0.0, 0.0), (0.6, 0.4)),
    )
    run_campaign(small, tmp_path / "out", workers=1)
    collect_parts(tmp_path / "out")
    with duckdb.connect() as database:
        rows = database.execute(
            "SELECT trainset, actuation, period_s, trainset_delay_s, trainset_lag_s, delay_s, count(*) "
            f"FROM '{tmp_path}/out/results.parquet' GROUP BY ALL"
        ).fetchall()
    assert ("dkz32", "0.6 s, 0.4 s", 0.5, 0.6, 0.4, 0.0, 1) in rows
    assert ("drawn-5-1", "0 s, 0 s", 0.2, 0.0, 0.0, 0.0, 1) in rows
    write_campaign_page(tmp_path / "page.md", tmp_path / "out", summarise(tmp_path / "out"), 1.0, "made")
    page = (tmp_path / "page.md").read_text()
    assert "| `flat_out` | 8 | 8 of 8 | 0 of 8 | 0 |" in page  # early: it keeps no time
    assert "## By declared dead time and lag" in page
    assert "| drawn-5-1 | 0 of 4 |" in page
    early = "Not on time because they came too early, and not listed: `flat_out` 8."
    assert f"## Runs that failed\n\nNone.\n\n{early}\n" in page

    def broken(self, memory, observation):
        raise ZeroDivisionError("nobody home")

    monkeypatch.setattr(FlatOut, "act", broken)
    one = replace(small, name="broken", trainsets=small.trainsets[:1], actuations=((0.6, 0.4),))
    run_campaign(replace(one, periods=()), tmp_path / "broken", workers=1)
    summary = summarise(tmp_path / "broken")
    write_campaign_page(tmp_path / "page.md", tmp_path / "broken", summary, 1.0, "made")
    (line,) = [row for row in (tmp_path / "page.md").read_text().splitlines() if "metropilot drive" in row]
    assert line.startswith("metropilot drive lu2023 WHY WYJ --time ")
    assert "--trainset dkz32@0.6,0.4 --load AW3 --driver flat_out --dt 0.2  # " in line
    assert line.endswith("# failed: ZeroDivisionError: nobody home")


def test_a_listed_failure_is_the_same_run_again(tmp_path, campaign):
    case = next(c for c in map(campaign.case, range(campaign.rows)) if c.trainset == "drawn-5-2@0.6,0.4")
    request = case_request(campaign, case, 150.0, 1538.0)
    assert drive(request.run(), request.make_driver()).outcome in set(Outcome)
    assert request.resolve().values()["trainset"] == "drawn-5-2@0.6,0.4"


def test_parts_of_an_earlier_version_are_reported_too(tmp_path, campaign):
    from metropilot._io import encode_parquet
    from metropilot.campaign import RESULTS, CampaignStore
    from metropilot.campaign.rows import PLANT, TIMINGS

    old = {name: kind for name, kind in RESULTS.items() if name not in {"actuation", *PLANT}}
    store = CampaignStore(tmp_path, campaign)
    for piece in campaign.pieces():
        row: dict[str, object] = {"driver": "flat_out", "outcome": "infeasible", "processor_s": 1.0}
        cells = [row | {"cell": number} for number in campaign.shard(piece)]
        store.keep(Shard(piece, len(cells), encode_parquet(old, cells), encode_parquet(TIMINGS, cells), "0"))
    collect_parts(tmp_path)
    write_campaign_page(tmp_path / "page.md", tmp_path, summarise(tmp_path), 1.0, "made")
    assert f"| `flat_out` | {campaign.rows} | 0 of 0 |" in (tmp_path / "page.md").read_text()
    with duckdb.connect() as database:
        names = [row[0] for row in database.execute(f"DESCRIBE '{tmp_path}/results.parquet'").fetchall()]
    assert names == ["row", *RESULTS]
