"""Campaigns: the matrix, its file, shards that are neither lost nor doubled, summary, report, command."""

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import duckdb
import numpy as np
import pytest
from scipy.stats import binom

from metropilot._io import encode_parquet
from metropilot.campaign import (
    Campaign,
    DisturbanceCase,
    collect_parts,
    read_campaign,
    run_campaign,
    shipped_campaigns,
    summarise,
    write_campaign_page,
)
from metropilot.campaign.declared import case_request, draw_disturbance, seed_of
from metropilot.campaign.matrix import Shard, from_text
from metropilot.campaign.page import (
    WORST_NUMBERS,
    WORST_WORDS,
    Again,
    median_ranks,
    share_interval,
    worst_table,
)
from metropilot.campaign.rows import RESULTS, TIMINGS
from metropilot.campaign.store import CampaignStore
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.evaluate import run_from_toml
from metropilot.sim import drive

SECTIONS = (("yizhuang", "WHY", "YZQ"), ("yizhuang", "XC", "XHM"))
SMALL = Campaign("small", ("flat_out",), SECTIONS[:1], (("dkz32", "AW2"), ("dkz32", "AW0")), (1.2,))
WIDE = Campaign(
    "wide",
    ("flat_out", "optimal", "mpc"),
    SECTIONS,
    (("dkz32", "AW0"), ("dkz32", "AW3")),
    ("planned", 1.2),
    (
        DisturbanceCase("nominal"),
        DisturbanceCase("heavy", ranges={"mass_factor": (1.0, 1.2), "lag_s": (0.1, 0.1)}),
    ),
    seeds=40,
)
FILE = """
name = "mine"
[matrix]
drivers = ["flat_out", "optimal:reserve_s=1"]
sections = ["yizhuang RJ WYJ"]
loads = ["AW2"]
times = ["planned", 1.2]
[[disturbance]]
name = "heavy"
mass_factor = [1.0, 1.2]
restriction = { from = 0.4, to = 0.6, kmh = 40, announced = 0.3 }
arrival = { factor = 1.1, announced = 0.2 }
"""


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return str(path)


def command(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code or 0


def test_every_cell_is_one_row_and_every_row_in_one_shard():
    cells = {
        WIDE.case(row)._replace(row=0, disturbance=WIDE.case(row).disturbance.name)
        for row in range(WIDE.rows)
    }
    assert len(cells) == WIDE.rows == 3 * 2 * 2 * 2 * 2 * 40
    assert [row for piece in WIDE.pieces() for row in WIDE.shard(piece)] == list(range(WIDE.rows))


def test_more_drivers_leave_the_shards_of_the_others_as_they_are():
    more = replace(WIDE, drivers=("eitoe", *WIDE.drivers))
    assert more.digest == WIDE.digest
    assert set(WIDE.pieces()) < set(more.pieces())
    for piece in WIDE.pieces():
        cells = [[c.case(row)._replace(row=0) for row in c.shard(piece)] for c in (WIDE, more)]
        assert cells[0] == cells[1]


def test_seeds_and_draws_belong_to_the_cell_and_not_to_the_driver_or_the_matrix():
    cases = [WIDE.case(row) for row in range(WIDE.rows)]
    seeds = [seed_of(WIDE, case) for case in cases]
    assert len(set(seeds)) == WIDE.rows // 3
    assert seeds[0] == seeds[WIDE.cells] == seeds[2 * WIDE.cells]
    wider = replace(WIDE, drivers=("manual", *WIDE.drivers), seeds=50)
    assert set(seeds) < {seed_of(wider, wider.case(row)) for row in range(wider.rows)}
    heavy = next(case for case in cases if case.disturbance.name == "heavy")
    request = case_request(WIDE, heavy, 100.0, 1000.0)
    assert 1.0 <= request.disturbance.mass_factor <= 1.2
    assert request.disturbance.lag_s == 0.1
    assert request.disturbance.resistance_factor == 1.0
    more = replace(heavy.disturbance, ranges={**heavy.disturbance.ranges, "delay_s": (0.0, 1.0)})
    assert draw_disturbance(more, request.seed)["mass_factor"] == request.disturbance.mass_factor


def test_a_campaign_travels_as_text():
    assert from_text(WIDE.text) == WIDE
    assert from_text(WIDE.text).digest == WIDE.digest != replace(WIDE, seeds=41).digest


def test_a_file_is_read(tmp_path):
    campaign = read_campaign(written(tmp_path, FILE))
    assert campaign.rows == 4
    request = case_request(campaign, campaign.case(3), 120.0, 1000.0)
    assert (request.driver, dict(request.options)) == ("optimal", {"reserve_s": 1})
    assert request.values()["restrictions"] == ["400-600@40@36"]
    assert request.values()["arrivals"] == ["132@24"]
    assert read_campaign(written(tmp_path, FILE), "manual,mpc").drivers == ("manual", "mpc")


@pytest.mark.parametrize("name", shipped_campaigns())
def test_campaigns_that_ship_can_be_read(name):
    campaign = read_campaign(name)
    assert campaign.rows >= 9
    assert all(campaign.case(row).row == row for row in (0, campaign.rows - 1))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"optimal:reserve_s=1"', '"optimul"', "matrix.drivers: unknown driver, did you mean optimal"),
        ('"optimal:reserve_s=1"', '"optimal:reserv_s=1"', "matrix.drivers: unknown option"),
        ("RJ WYJ", "RJ ABC", "matrix.sections: "),
        ("RJ WYJ", "RJ", "matrix.sections: not a section"),
        ('"AW2"', '"AW7"', "matrix.loads: unknown load: 'AW7' (allowed: AW0, AW2, AW3)"),
        ('name = "mine"', "", "mine.toml: name: missing (allowed: text)"),
        ("kmh = 40, ", "", "disturbance.0.restriction.kmh: missing (allowed: a number)"),
        ("kmh = 40", "km = 40", "km: unknown key, did you mean kmh? (allowed: from, to, kmh, announced)"),
        (
            "[matrix]",
            "[matrix]\ntrainsets = [{ drawn = 2, sed = 1 }]",
            "sed: unknown key, did you mean seed?",
        ),
        ("[matrix]", "[matrix]\nseeds = 1000000000", "matrix: too many rows: "),
        ("1.2]\n[[", "0.5]\n[[", "matrix.times.1"),
        ("1.2]\n[[", "0.9]\n[[", "should be 'planned' or greater than or equal to 1: '0.9'"),
        ("1.2]\n[[", "50]\n[[", "should be 'planned' or less than or equal to 10: '50'"),
        (
            "[1.0, 1.2]",
            '"1.1"',
            "0.mass_factor: input should be a number or a list of two: '1.1'",
        ),
        ("[1.0, 1.2]", "[1.0, 1.1, 1.2]", "mass_factor: input should be a number or a list of two: "),
        ("mass_factor", "ideal", "disturbance.0.ideal: input should be true or false: "),
        ("[1.0, 1.2]", "1.0\nideal = 1", "disturbance.0.ideal: input should be true or false: '1'"),
        ("[matrix]", "dt_s = true\n[matrix]", "dt_s: input should be a number: 'True'"),
        ("[matrix]", '[matrix]\nseeds = "3"', "matrix.seeds: input should be a whole number: '3'"),
        ("[matrix]", "[matrix]\nseeds = true", "matrix.seeds: input should be a whole number: 'True'"),
        ("[matrix]", "[matrix]\ntrainsets = [{ drawn = 0 }]", "matrix.trainsets.0.drawn: input should be g"),
        ("[matrix]", "[matrix]\ntrainsets = [3]", "trainsets.0: input should be text or a table: '3'"),
        ("[1.0, 1.2]", "[1.0, 3.0]", "disturbance heavy.mass_factor: out of range: 3.0"),
        ("[1.0, 1.2]", "[1.2, 1.0]", "ends before it begins"),
        ("mass_factor", "mas_factor", "disturbance.0.mas_factor: unknown key"),
        ("kmh = 40", "kmh = -1", "disturbance.0.restriction.kmh"),
        ("from = 0.4", "from = 0.7", "ends before it begins"),
        ("[matrix]", "[matrices]", "matrices: unknown key"),
        ('name = "mine"', "name = ", "not TOML"),
    ],
)
def test_what_cannot_be_used_is_one_line_with_file_and_field(tmp_path, capsys, old, new, words):
    assert old in FILE
    assert command("campaign", written(tmp_path, FILE.replace(old, new)), "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "mine.toml: " in said
    assert words in said


def test_a_sample_of_a_matrix_that_would_never_end_is_read(tmp_path):
    path = written(tmp_path, FILE.replace("[matrix]", "[matrix]\nseeds = 1000000000"))
    assert read_campaign(path, sample=3).rows == 6
    with pytest.raises(
        InputError, match=r"matrix: too many rows: 4000000000 \(allowed: at most 5000000; set"
    ):
        read_campaign(path)


def test_axes_with_one_value_are_no_words():
    assert SMALL.matrix_words == "2 trainsets and loads"
    assert replace(SMALL, trainsets=SMALL.trainsets[:1]).matrix_words == "one case"
    assert WIDE.matrix_words.startswith("3 drivers × 2 sections × 2 trainsets and loads × 2 times × 2 dist")


def test_a_policy_that_was_changed_needs_another_folder(tmp_path):
    policy = tmp_path / "policy.bin"
    policy.write_bytes(b"one")
    campaign = replace(SMALL, drivers=("flat_out", f"learned:policy={policy}"))
    CampaignStore(tmp_path / "out", campaign)
    CampaignStore(tmp_path / "out", campaign)
    policy.write_bytes(b"two")
    with pytest.raises(
        InputError, match=r"a file has changed since the folder was begun: 'learned:policy=.*bin'"
    ):
        CampaignStore(tmp_path / "out", campaign)
    CampaignStore(tmp_path / "out", replace(campaign, drivers=("flat_out",)))


def test_a_matrix_is_a_table(tmp_path):
    with pytest.raises(InputError, match=r"matrix: input should be a table: '3'$"):
        read_campaign(written(tmp_path, 'name = "mine"\nmatrix = 3\n'))


def test_a_whole_number_is_a_number_too(tmp_path):
    text = FILE.replace("1.2]\n[[", "2]\n[[").replace("[1.0, 1.2]", "1")
    campaign = read_campaign(written(tmp_path, text))
    assert campaign.times == ("planned", 2.0)
    assert campaign.disturbances[0].ranges == {"mass_factor": (1.0, 1.0)}


def shard_of(campaign, piece, outcome="arrived"):
    rows = [
        {"cell": row % campaign.cells, "driver": piece.group, "outcome": outcome}
        for row in campaign.shard(piece)
    ]
    return Shard(piece, len(rows), encode_parquet(RESULTS, rows), encode_parquet(TIMINGS, rows), "0")


def test_a_shard_counts_once_its_line_is_whole(tmp_path):
    store, pieces = CampaignStore(tmp_path, WIDE), WIDE.pieces()
    for number in (3, 1):
        store.keep(shard_of(WIDE, pieces[number]))
    assert set(store.finished_shards()) == {pieces[1], pieces[3]}
    with (tmp_path / "done.txt").open("a") as file:
        file.write("flat_out 2 20 60")  # torn by a kill
    assert set(store.finished_shards()) == {pieces[1], pieces[3]}
    store.keep(shard_of(WIDE, pieces[0]))
    assert set(CampaignStore(tmp_path, WIDE).finished_shards()) == {pieces[0], pieces[1], pieces[3]}
    store.part(pieces[3]).write_bytes(b"cut short")
    assert set(store.finished_shards()) == {pieces[0], pieces[1]}


def test_a_folder_is_gone_on_with_by_more_drivers(tmp_path):
    few = replace(WIDE, drivers=("optimal",))
    store = CampaignStore(tmp_path, few)
    store.keep(shard_of(few, few.pieces()[1]))
    more = replace(WIDE, drivers=("mpc", "optimal", "optimal:reserve_s=1"))
    store = CampaignStore(tmp_path, more)
    assert [piece.group for piece in store.finished_shards()] == ["optimal"]
    store.keep(shard_of(more, more.pieces()[-1]))
    collect_parts(tmp_path)
    rows = duckdb.sql(f"SELECT row, driver, cell FROM '{tmp_path}/results.parquet'").fetchall()
    held = [row for piece in (more.pieces()[k] for k in (21, -1)) for row in more.shard(piece)]
    assert [row for row, _, _ in rows] == held
    assert all(row % more.cells == cell for row, _, cell in rows)


def test_the_folder_of_another_campaign_is_refused(tmp_path):
    CampaignStore(tmp_path, WIDE)
    with pytest.raises(InputError, match="holds another campaign"):
        CampaignStore(tmp_path, SMALL)


KILLED = """
import sys, time
from pathlib import Path
import metropilot.campaign.rows as rows
from metropilot.campaign.declared import seed_of
from metropilot.campaign.matrix import from_text
from metropilot.campaign.run import run_campaign

def drive_row(campaign, case):
    time.sleep(0.0005)
    cell = {"cell": case.row % campaign.cells, "driver": case.driver}
    return {**cell, "seed": seed_of(campaign, case), "outcome": "arrived"}, cell

rows.drive_row = drive_row
run_campaign(from_text(Path(sys.argv[1]).read_text()), Path(sys.argv[2]), workers=1)
"""


def test_kill_9_at_random_moments_loses_and_doubles_no_row(tmp_path):
    (tmp_path / "campaign.json").write_text(WIDE.text)
    (tmp_path / "program.py").write_text(KILLED)
    chance, folder, kills = random.Random(7), tmp_path / "killed", 0
    program = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "campaign.json")]
    for _ in range(5):  # tools/kills.py does it for longer
        process = subprocess.Popen([*program, str(folder)])
        parts = folder / "parts"
        before = len(list(parts.glob("*/*.parquet")))
        while process.poll() is None and len(list(parts.glob("*/*.parquet"))) < before + chance.randint(
            8, 30
        ):
            time.sleep(0.001)
        time.sleep(chance.random() * 0.01)
        if process.poll() is not None:
            break
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        kills += 1
    subprocess.run([*program, str(folder)], check=True)
    subprocess.run([*program, str(tmp_path / "whole")], check=True)
    assert kills >= 3
    for path in (folder, tmp_path / "whole"):
        collect_parts(path)
        rows = duckdb.sql(f"SELECT row, seed FROM '{path}/results.parquet'").fetchall()
        assert [row for row, _ in rows] == list(range(WIDE.rows))
    same = [(path / "results.parquet").read_bytes() for path in (folder, tmp_path / "whole")]
    assert same[0] == same[1]
    assert CampaignStore(folder, WIDE).checksum() == CampaignStore(tmp_path / "whole", WIDE).checksum()


def test_any_number_of_workers_gives_the_same_bits(tmp_path):
    for workers in (1, 2):
        progress = run_campaign(SMALL, tmp_path / str(workers), workers)
        assert (progress.rows, progress.driven) == (2, 2)
        collect_parts(tmp_path / str(workers))
    one, two = ((tmp_path / name / "results.parquet").read_bytes() for name in "12")
    assert one == two
    assert run_campaign(SMALL, tmp_path / "2").driven == 0


def test_the_command_drives_reports_and_says_how_to_drive_the_worst_again(tmp_path, capsys):
    text = FILE.replace(', "optimal:reserve_s=1"', "").replace("RJ WYJ", "WHY YZQ").replace('"planned", ', "")
    out, board = tmp_path / "out", tmp_path / "board.md"
    more = ("--workers", 1, "--write-docs", board, "--json")
    assert command("campaign", written(tmp_path, text), "--out", out, *more) == 0
    assert "| `flat_out` | 1 | 1 of 1 | 1 of 1 |" in board.read_text()
    assert "| WHY-YZQ |" in board.read_text()
    assert "*Gap*: energy at the\nwheel above the certified optimum" in board.read_text()
    said = capsys.readouterr()
    assert said.err.endswith(f"writing the report to {out}\n")
    summary = json.loads(said.out)
    assert (summary["rows"], summary["done"], summary["sitting"]["driven"]) == (1, 1, 1)
    assert summary["drivers"][0]["arrived"] == 1
    (worst,) = summary["worst"]
    request = run_from_toml(out / "worst" / "01" / "run.toml")
    done = drive(request.run(), request.make_driver())
    assert float(done.trajectory.energy_wheel_j[-1]) / 3.6e6 == worst["energy_wheel_kwh"]
    assert done.running_time_s == worst["running_time_s"]
    page = (out / "report.html").read_text()
    assert "<svg" in page
    assert "worst/01/run.toml" in page
    assert not any(word in page for word in ("src=", "<link", "@import", "<script"))


def test_a_driver_that_breaks_down_is_a_failure_and_no_end(tmp_path, monkeypatch):
    from metropilot.drivers import FlatOut

    def broken(self, memory, observation):
        raise ZeroDivisionError("nobody home")

    monkeypatch.setattr(FlatOut, "act", broken)
    run_campaign(SMALL, tmp_path, workers=1)
    (row,) = summarise(tmp_path)["drivers"]
    assert (row["runs"], row["failed"], row["successes"], row["gap_median"]) == (2, 2, 0, None)
    assert "ZeroDivisionError: nobody home" in summarise(tmp_path)["worst"][0]["error"]
    write_campaign_page(tmp_path / "board.md", tmp_path, summarise(tmp_path), 1.0, "made")
    assert "`flat_out` on WHY-YZQ AW2, nominal: ZeroDivisionError" in (tmp_path / "board.md").read_text()


def test_the_caption_of_a_failed_run_that_can_be_driven_has_dashes():
    """A run that failed in a batch and is driven again for its picture has no time error and no place."""
    row = dict.fromkeys([*WORST_WORDS.values(), *WORST_NUMBERS.values(), "origin", "destination", "load"])
    row |= {"driver": "ppo", "outcome": "failed", "error": "ZeroDivisionError"}
    table = worst_table([row], [Again("worst/01", "<svg/>")])
    assert "failed, – s, – m" in table


def test_a_time_nobody_can_keep_is_counted_apart(tmp_path):
    campaign = replace(
        SMALL, times=(1.0,), trainsets=SMALL.trainsets[:1], sections=(("yizhuang", "RJ", "CQ"),)
    )
    run_campaign(replace(campaign, times=("planned",)), tmp_path, workers=1)
    (row,) = summarise(tmp_path)["drivers"]
    assert (row["impossible"], row["possible"], row["success_low"]) == (1, 0, None)


def test_the_page_says_where_energy_is_counted(tmp_path):
    run_campaign(replace(SMALL, trainsets=SMALL.trainsets[:1], objective="line"), tmp_path, workers=1)
    collect_parts(tmp_path)
    write_campaign_page(tmp_path / "page.md", tmp_path, summarise(tmp_path), 1.0, "made")
    assert "*Gap*: energy at the\nline above the certified optimum" in (tmp_path / "page.md").read_text()


def test_intervals():
    assert share_interval(10, 10) == pytest.approx((0.7225, 1.0), abs=1e-3)


@pytest.mark.parametrize("count", [1, 5, 6, 7, 10, 12, 20, 49, 50, 98, 99, 100, 101, 1000])
def test_the_median_lies_between_the_closest_ranks_of_95_percent(count):
    ends = ", ".join(map(str, median_ranks(count)))
    select = f"SELECT quantile_disc(x, [{ends}]) FROM range(1, {count + 1}) t(x)"
    ((low, high),) = duckdb.sql(select).fetchall()[0]
    below = binom.cdf(np.arange(count + 1), count, 0.5)  # of that many values below the median
    assert low + high == count + 1
    assert low == 1 or below[low - 1] <= 0.025
    assert below[low] > 0.025


def test_the_ranks_of_a_hundred():
    # of 100 values at most 39 lie below the median with 1.8 %, at most 40 with 2.8 %
    low, high = median_ranks(100)
    assert (math.ceil(100 * low), math.ceil(100 * high)) == (40, 61)


def test_a_cluster_without_ray_is_bad_input(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"metropilot\[ray\]"):
        run_campaign(SMALL, tmp_path, cluster="local")


def descendants(pid):
    """Processes below this one, with their command lines."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            fields = (path / "stat").read_text().rpartition(")")[2].split()
            parents[int(path.name)] = int(fields[1])
        except OSError:
            continue
    found, last = set(), {pid}
    while last:
        last = {child for child, parent in parents.items() if parent in last} - found
        found |= last
    return found


def test_a_ray_worker_killed_midway_changes_nothing(tmp_path):
    """Opt-in: needs the extra ``ray`` and Linux's /proc."""
    pytest.importorskip("ray", reason="the extra ray is not installed")
    campaign = replace(
        SMALL, sections=SECTIONS, trainsets=(("dkz32", "AW0"), ("dkz32", "AW2"), ("dkz32", "AW3"))
    )
    killed = []

    def say(progress):
        for pid in descendants(os.getpid()):
            command_line = Path(f"/proc/{pid}/cmdline")
            if (
                not killed
                and command_line.exists()
                and command_line.read_bytes().startswith(b"ray::compute_shard")
            ):
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    run_campaign(campaign, tmp_path / "ray", workers=2, cluster="local", say=say)
    run_campaign(campaign, tmp_path / "here", workers=1)
    assert killed
    for name in ("ray", "here"):
        collect_parts(tmp_path / name)
    assert (tmp_path / "ray/results.parquet").read_bytes() == (tmp_path / "here/results.parquet").read_bytes()
