"""Campaigns of lines in operation: file, rows as `metropilot line` computes them, resumption, command."""

import json
from dataclasses import replace
from importlib import resources

import duckdb
import pytest
from tests.operation.lines import short_line

from metropilot.campaign import (
    LineSweep,
    collect_parts,
    read_campaign,
    run_campaign,
    summarise,
    table_of_lines,
)
from metropilot.campaign.line_sweep import RESULTS, FeedingCase, compute_case
from metropilot.campaign.matrix import from_text
from metropilot.campaign.store import CampaignStore
from metropilot.cli import main
from metropilot.errors import InputError
from metropilot.operation import LineOperation, OperationOptions, feed_line, operation_energy
from metropilot.railway import load_feeding, load_line, load_trainset, write_line

FILE = """
kind = "line"
name = "short lines"
seed = 3

[matrix]
lines = ["short.toml"]
loads = ["AW2"]
headways = [150, 40]
feedings = [2, "network.toml 1"]

[operation]
time_window_s = 0
transfer_loss = [0.0, 0.2]
"""


@pytest.fixture
def folder(tmp_path):
    line = short_line(3)
    write_line(line, tmp_path / "short.toml")
    told = resources.files("metropilot.railway") / "catalogue" / "feedings" / "yizhuang.toml"
    rows = told.read_text(encoding="utf-8").splitlines()
    last_m = line.stations[-1].position_m
    far = [row for row in rows if "name =" in row and "position =" in row and _position_m(row) > last_m]
    (tmp_path / "network.toml").write_text("\n".join(row for row in rows if row not in far))
    return tmp_path


def _position_m(row):
    return float(row.partition("position =")[2].strip(" },"))


def read(folder, text=FILE) -> LineSweep:
    (folder / "mine.toml").write_text(text)
    found = read_campaign(str(folder / "mine.toml"))
    assert isinstance(found, LineSweep)
    return found


def command(*words):
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    return stop.value.code or 0


def test_a_file_is_a_matrix_and_a_row_is_its_cell(folder):
    sweep = read(folder)
    assert from_text(sweep.text) == sweep
    assert (sweep.groups, sweep.cells, sweep.rows) == (("150 s", "40 s"), 4, 8)
    cases = [sweep.case(row) for row in range(sweep.rows)]
    assert [case.service for case in cases] == [150] * 4 + [40] * 4
    networks = FeedingCase(2), FeedingCase(1, str(folder / "network.toml"))
    assert [(case.options["transfer_loss"], case.feeding) for case in cases[:4]] == [
        (loss, feeding) for loss in (0.0, 0.2) for feeding in networks
    ]
    more = replace(sweep, services=(200, *sweep.services))
    assert more.digest == sweep.digest != replace(sweep, seed=4).digest


def test_a_network_that_was_changed_is_another_campaign(folder):
    first, path = CampaignStore(folder / "out", read(folder)).campaign.digest, folder / "elsewhere.toml"
    (folder / "network.toml").rename(path)
    moved = FILE.replace("network.toml", "elsewhere.toml")
    assert CampaignStore(folder / "out", read(folder, moved)).campaign.digest == first
    path.write_text(path.read_text().replace("resistance = 10", "resistance = 5"))
    with pytest.raises(InputError, match="the folder holds another campaign"):
        CampaignStore(folder / "out", read(folder, moved))


def test_a_day_that_was_changed_needs_another_folder(folder):
    day, line = folder / "day.toml", load_line(str(folder / "short.toml"))
    day.write_text(
        f'kind = "day"\nid = "d"\nname = "Day"\nline = "{line.id}"\n[periods]\nunits = {{ headway = "s" }}\n'
        'list = [{ name = "all", from = "08:00", to = "09:00", headway = 300 }]\n'
    )
    text = FILE.replace("headways =", 'days = ["day.toml"]\nheadways =')
    CampaignStore(folder / "out", read(folder, text))
    CampaignStore(folder / "out", read(folder, text))
    day.write_text(day.read_text().replace("09:00", "10:00"))
    with pytest.raises(InputError, match=r"a file has changed since the folder was begun: '.*day\.toml'"):
        CampaignStore(folder / "out", read(folder, text))
    # headways alone do not read it
    CampaignStore(folder / "out", read(folder))


def test_a_row_has_the_energies_of_the_line(folder):
    sweep = read(folder)
    options = OperationOptions(headway_s=150, zones=1, time_window_s=0, transfer_loss=0.2)
    line = load_line(str(folder / "short.toml"))
    operation = LineOperation(line, load_trainset("dkz32", "AW2"), options)
    found = operation_energy(operation, seed=3)
    row, timing = compute_case(sweep, 3)
    assert (row["outcome"], row["headway_s"], row["zones"], row["transfer_loss"]) == ("computed", 150, 1, 0.2)
    for name in ("floor_kwh", "energy_kwh", "cruise_kwh", "driving_only_kwh", "timetable_only_kwh"):
        assert row[name] == getattr(found, name)
    fed = feed_line(operation, found.timetable, found.profiles, load_feeding(str(folder / "network.toml")))
    assert row["network_energy_kwh"] == fed.energy_kwh
    assert timing["processor_s"] > 0.0
    zones, _ = compute_case(sweep, 2)
    assert zones["network"] is None is zones["network_energy_kwh"]
    assert zones["zones"] == 2


def test_what_cannot_be_computed_is_a_row_and_no_end(folder):
    row, _ = compute_case(read(folder), 4)
    assert row["outcome"] == "failed"
    assert "trains disturb one another" in row["error"]


class Stopped(Exception):
    """An interruption."""


def test_an_interrupted_sweep_goes_on_and_takes_more_headways(folder):
    few = FILE.replace('2, "network.toml 1"', "1").replace("150, 40", "150")
    sweep = read(folder, few)

    def stop(progress):
        raise Stopped

    with pytest.raises(Stopped):
        run_campaign(sweep, folder / "out", 1, say=stop)
    assert summarise(folder / "out")["done"] == 1
    more = replace(sweep, services=(200, 150))
    progress = run_campaign(more, folder / "out", 2)
    assert (progress.rows, progress.driven) == (4, 3)
    assert run_campaign(more, folder / "out").driven == 0
    run_campaign(more, folder / "whole", 1)
    for name in ("out", "whole"):
        collect_parts(folder / name)
    assert (folder / "out/results.parquet").read_bytes() == (folder / "whole/results.parquet").read_bytes()
    query = f"SELECT row, service FROM '{folder}/out/results.parquet'"
    assert duckdb.sql(query).fetchall() == [(k, "200 s" if k < 2 else "150 s") for k in range(4)]


def test_the_command_reports_every_row(folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "240")  # narrower, the table breaks words
    few = FILE.replace("[0.0, 0.2]", "0.1").replace("150, 40", "150")
    read(folder, few)
    words = ("campaign", folder / "mine.toml", "--out", folder / "out", "--workers", 1)
    assert command(*words, "--write-docs", folder / "page.md", "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["kind"], summary["done"], len(summary["lines"])) == ("line", 2, 2)
    zones, network = summary["lines"]
    assert zones["floor_kwh"] <= zones["energy_kwh"] < zones["driving_only_kwh"] < zones["cruise_kwh"]
    assert network["network_energy_kwh"] < network["network_cruise_kwh"]
    page = (folder / "page.md").read_text()
    assert f"| 150 s | 2 zones | {zones['cruise_kwh']:.1f} |" in page
    assert f"| 150 s | DC network network.toml | {network['network_cruise_kwh']:.1f} |" in page
    report = (folder / "out" / "report.html").read_text()
    assert "<svg" in report
    assert not any(word in report for word in ("src=", "<link", "@import", "<script"))
    assert command(*words) == 0
    assert "2 zones" in capsys.readouterr().out
    read(folder, few.replace("150", "40"))
    assert command("campaign", folder / "mine.toml", "--out", folder / "bad", "--workers", 1) == 1
    assert "disturb" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("150, 40", "5", "matrix.headways: out of range: 5"),
        ("150, 40", "", "matrix.headways: neither a headway nor a day"),
        ("150, 40", "1.5", "matrix.headways.0"),
        ("short.toml", "nowhere", "matrix.lines: "),
        ('"AW2"', '"AW9"', "matrix.loads: unknown load: 'AW9'"),
        (
            "lines =",
            "line =",
            "matrix.line: unknown key, did you mean lines? (allowed: lines, headways, days, ",
        ),
        (
            "[0.0, 0.2]",
            f"{[k / 1000 for k in range(1000)]}\nreserve = {[k / 1000 for k in range(1000)]}",
            "operation: too many rows: 1000000 (allowed: at most 100000)",
        ),
        ("[2,", "[3,", "matrix.feedings: too many feeding zones: 3"),
        ("[2,", "[0,", "matrix.feedings: a line needs a feeding zone: 0 (allowed: 1 to 2"),
        ("network.toml 1", "network.toml one", "matrix.feedings: not a feeding"),
        ("network.toml 1", "yizhuang 1", "matrix.feedings: substation off the line"),
        ("network.toml 1", "nothing", "matrix.feedings: "),
        (
            "time_window_s = 0",
            "time_windw_s = 0",
            "operation.time_windw_s: unknown key, did you mean time_window_s",
        ),
        ("time_window_s = 0", "headway_s = 0", "operation.headway_s: unknown key"),
        ("time_window_s = 0", "time_window_s = 0.5", "operation.time_window_s: wrong kind of value"),
        ("[0.0, 0.2]", "[[0.1]]", "operation.transfer_loss: wrong kind of value"),
        ("[0.0, 0.2]", "[]", "operation.transfer_loss: the list is empty"),
        ("[0.0, 0.2]", "[0.0, 2.0]", "operation.transfer_loss: out of range: 2.0"),
        ("time_window_s = 0", "dwell_s = 5", "operation.dwell_window_s: a dwell window"),
        ("seed = 3", "sharp = true", "a floor is sharpened where each section is a zone"),
        ("seed = 3", 'driver = "nobody"', "driver: unknown driver"),
        ("seed = 3", "scatter = [-1]", "scatter.0"),
        ("seed = 3", "sede = 3", "sede: unknown key"),
        ('kind = "line"', 'kind = "lines"', "kind: unknown kind of campaign, did you mean line"),
        ("headways =", 'days = ["zzz"]\nheadways =', "matrix.days: "),
    ],
)
def test_what_cannot_be_used_is_one_line_with_file_and_field(folder, capsys, old, new, words):
    assert old in FILE
    (folder / "mine.toml").write_text(FILE.replace(old, new))
    assert command("campaign", folder / "mine.toml", "--out", folder / "out") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "mine.toml: " in said
    assert words in said


def test_a_line_is_no_campaign_of_lines(folder, capsys):
    assert command("campaign", folder / "short.toml", "--out", folder / "out") == 2
    said = capsys.readouterr().err
    assert "short.toml: describes a line, not a campaign (allowed: a file of a campaign)" in said


def test_drivers_and_samples_are_of_drives(folder, capsys):
    read(folder)
    for option in (("--drivers", "pid"), ("--sample", 3)):
        assert command("campaign", folder / "mine.toml", *option) == 2
        assert "only for a campaign of drives" in capsys.readouterr().err


def test_what_driving_and_timetable_are_worth_is_that_of_the_energies():
    energies = {"cruise": 800.0, "driving_only": 720.0, "timetable_only": 784.0, "energy": 700.0}
    row = dict.fromkeys(RESULTS) | {f"{name}_kwh": kwh for name, kwh in energies.items()}
    row |= {"service": "180 s", "zones": 4, "floor_kwh": 693.0, "gap_percent": 1.0, "outcome": "computed"}
    row |= {"driver_plain_kwh": 900.0, "driver_energy_kwh": 891.0}
    row["scattered"] = [{"seconds": 3.0, "energy_kwh": 701.0, "deviation_kwh": 0.2}]
    of = LineSweep("one", (180,), ("yizhuang",), (("dkz32", "AW2"),), driver="manual", scatter_s=(3.0,))
    heads, (cells,) = table_of_lines(of, [row])
    assert heads[:2] == ["headway or day", "feeding"]
    assert cells[:7] == ["180 s", "4 zones", "800.0", "720.0", "784.0", "700.0", "693.0"]
    assert cells[7:] == ["10.0", "2.0", "12.5", "1.00", "900.0", "891.0", "1.0", "701.0 ± 0.2"]
    # a network has energies of its own, and no floor
    fed = row | {"network": "yizhuang"} | {f"network_{name}_kwh": 2.0 * kwh for name, kwh in energies.items()}
    _, (_, cells) = table_of_lines(of, [row, fed])
    assert cells[1:8] == ["DC network yizhuang", "1600.0", "1440.0", "1568.0", "1400.0", "–", "10.0"]
    assert cells[10] == "–"
