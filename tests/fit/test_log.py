"""Logs are read with their units, or refused in one line."""

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.fit import read_log

SPEEDS = [0.0, *np.linspace(1.0, 15.0, 30)]


def write(path, header, rows, delimiter=","):
    lines = [delimiter.join(header), *(delimiter.join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def rows(scale=1.0, command=0.5):
    return [(0.2 * k, scale * v, command) for k, v in enumerate(SPEEDS)]


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        (("time [s]", "speed [m/s]", "command"), 1.0),
        (("time_s", "speed_kmh", "command"), 3.6),
        (("t (s)", "Speed (km/h)", "u [-]"), 3.6),
        (("Time_s", "velocity_mps", "command [1]"), 1.0),
    ],
)
def test_units_are_read_from_the_header(tmp_path, header, scale):
    log = read_log(write(tmp_path / "log.csv", header, rows(scale)))
    assert log.speed_mps == pytest.approx(SPEEDS)
    assert log.command == pytest.approx(0.5)


def test_semicolons_with_decimal_commas_and_percent(tmp_path):
    table = [[str(x).replace(".", ",") for x in row] for row in rows(command=50.0)]
    log = read_log(write(tmp_path / "a.csv", ("time [s]", "speed [m/s]", "command [%]"), table, ";"))
    assert log.time_s[1] == pytest.approx(0.2)
    assert log.command == pytest.approx(0.5)


def test_a_trajectory_is_a_log(trajectory, trajectory_file):
    log = read_log(trajectory_file)
    assert (log.speed_mps == trajectory.speed_mps).all()
    assert log.gradient_permil == pytest.approx(trajectory.gradient_permil)
    wheel = trajectory.traction_n - trajectory.electric_brake_n - trajectory.friction_brake_n
    assert log.effort_n == pytest.approx(wheel)


def test_power_at_the_wheel_is_an_effort_at_speed(tmp_path):
    table = [(t, v, 200.0 * v) for t, v, _ in rows()]
    log = read_log(write(tmp_path / "a.csv", ("time [s]", "speed [m/s]", "power [kW]"), table))
    moving = log.speed_mps > 1.0
    assert log.effort_n[moving] == pytest.approx(200e3)
    assert np.isnan(log.effort_n[~moving]).all()


def test_a_row_without_a_speed_is_a_gap(tmp_path):
    table = [list(row) for row in rows()]
    table[5][1] = ""
    log = read_log(write(tmp_path / "a.csv", ("time [s]", "speed [m/s]", "command"), table))
    assert log.time_s.size == len(table) - 1


@pytest.mark.parametrize(
    ("header", "change", "said"),
    [
        (("time", "speed [m/s]", "command"), {}, "column 'time': missing unit"),
        (("time [s]", "speed [mph]", "command"), {}, "unknown unit"),
        (("clock [s]", "speed [m/s]", "command"), {}, "time: column missing"),
        (("time [s]", "rpm", "command"), {}, "speed: column missing"),
        (("time [s]", "speed [m/s]", "command"), {(7, 0): 0.4}, "line 9: time does not increase"),
        (
            ("time [s]", "speed [m/s]", "command"),
            {(7, 1): "fast"},
            "line 9, column 'speed [m/s]': not a number",
        ),
        (
            ("time [s]", "speed [m/s]", "command"),
            {(7, 1): "nan"},
            "a finite number, or an empty cell for a gap",
        ),
        (("time [s]", "speed [m/s]", "command"), {(7, 1): 300}, "speed out of range"),
        (("time [s]", "speed [m/s]", "command"), {(7, 2): 50}, "command out of range"),
        (("speed [m/s]", "speed [km/h]", "time [s]"), {}, "two columns of one quantity"),
    ],
)
def test_a_bad_log_is_refused_in_one_line(tmp_path, header, change, said):
    table = [list(row) for row in rows()]
    for (row, column), value in change.items():
        table[row][column] = value
    with pytest.raises(InputError) as found:
        read_log(write(tmp_path / "bad.csv", header, table))
    assert said in found.value.line()
    assert "bad.csv" in found.value.line()


@pytest.mark.parametrize(
    ("row", "decimal", "said"),
    [("1.4,4.3,0.5,,7", ".", "line 9: too many cells: 5"), ("1.4,4.3,0.5", ",", "line 2: too many cells: 6")],
)
def test_more_cells_than_the_header_are_refused(tmp_path, row, decimal, said):
    path = write(tmp_path / "a.csv", ("time [s]", "speed [m/s]", "command"), rows())
    lines = path.read_text().splitlines()
    lines[8] = row
    path.write_text("\n".join(line.replace(".", decimal) for line in lines) + "\n")
    with pytest.raises(InputError) as found:
        read_log(path)
    assert f"{said} (allowed: at most 3, as in the header; with decimal commas, semi" in found.value.line()


def test_empty_cells_beyond_the_header_are_none(tmp_path):
    path = write(tmp_path / "a.csv", ("time [s]", "speed [m/s]", "command"), rows())
    path.write_text("\n".join(line + "," * (k > 0) for k, line in enumerate(path.read_text().splitlines())))
    assert read_log(path).command == pytest.approx(0.5)


def test_a_short_log_is_refused(tmp_path):
    with pytest.raises(InputError, match="too short"):
        read_log(write(tmp_path / "a.csv", ("time [s]", "speed [m/s]"), rows()[:5]))
