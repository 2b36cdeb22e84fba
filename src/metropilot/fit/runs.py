"""Runs cut from logs: between standstills and gaps, on one time grid, with what is known of the track."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from metropilot.errors import InputError
from metropilot.fit.log import Log
from metropilot.physics import Track, Vehicle, mean_slopes

MAX_STEP_S = 0.25
"""Longest step of the simulation; logs with fewer samples are simulated between them."""
GAP_S = 2.0
"""Longest time between two samples within one run; over a shorter one the command is interpolated."""
MAX_RUN_S = 240.0
"""Longest run: a longer one is cut, so that what the model leaves out cannot add up."""
LEAD_S = 3.0
"""Time before a run over which the command fills dead time and lag."""
MOVING_MPS = 0.3
"""Measured speed above which a sample counts; below it odometry says nothing."""
STANDING_S = 5.0
"""Time before the first moving sample from which a run that begins at standstill is simulated."""
STOPPING_S = 1.5
"""Time after which a trainset that was slower than that stands."""
OUTSIDE_M = 50.0
"""Distance beyond the ends of a section to which a logged position is taken for one in it."""
CHANGE = 0.03
"""Change of the input over missing samples, as a share of its largest, at which a run is cut."""
LEAST_RUN_S = 5.0
"""Shortest run that is used."""


class Runs(NamedTuple):
    """Runs of all logs on one time grid, padded to the longest; the columns of every array are the runs.

    Attributes:
        step_s: Step of the grid, s.
        time_s: Time of each grid point since the run's first, s. Shape (steps + 1,).
        starts: Step at which the motion is simulated from; before it the speed is held. Shape (runs,).
        rolling: True where the run begins at speed, which is then estimated. Shape (runs,).
        speed_mps: Measured speed at the start. Shape (runs,).
        knot_s: Times of the changes of the input, since the run's first grid point. Each of shape (knots,).
        integral: Integral of the input (command, or effort in N) over time at the knots. Each (knots,).
        gradient: Mean slope over the trainset at each step. Shape (steps, runs).
        curve_n_per_kg: Curve resistance. Shape (steps, runs).
        tunnel_n_per_mps2: Tunnel coefficient. Shape (steps, runs).
        row_run: Run of each sample. Shape (samples,).
        row_step: Step in which it lies. Shape (samples,).
        row_part: Part of the step that has passed. Shape (samples,).
        row_mps: Its measured speed. Shape (samples,).
        row_s: Its time since the run's first grid point. Shape (samples,).
        row_input: Input in force at the sample. Shape (samples,).
    """

    step_s: float
    time_s: Float[ndarray, " points"]
    starts: Int[ndarray, " runs"]
    rolling: Bool[ndarray, " runs"]
    speed_mps: Float[ndarray, " runs"]
    knot_s: list[Float[ndarray, " knots"]]
    integral: list[Float[ndarray, " knots"]]
    gradient: Float[ndarray, "steps runs"]
    curve_n_per_kg: Float[ndarray, "steps runs"]
    tunnel_n_per_mps2: Float[ndarray, "steps runs"]
    row_run: Int[ndarray, " samples"]
    row_step: Int[ndarray, " samples"]
    row_part: Float[ndarray, " samples"]
    row_mps: Float[ndarray, " samples"]
    row_s: Float[ndarray, " samples"]
    row_input: Float[ndarray, " samples"]

    def input_over(self, delay_s: float) -> Float[ndarray, "steps runs"]:
        """Input of each step after a dead time: the mean over the step of what was given before it."""
        edges = self.time_s - delay_s
        columns = [
            np.diff(np.interp(edges, knots, values))
            for knots, values in zip(self.knot_s, self.integral, strict=True)
        ]
        return np.stack(columns, axis=1) / self.step_s


class _Piece(NamedTuple):
    """One run of one log, before it is put on the grid: rows ``first`` to ``last``, both included.

    The input is known without a change that was missed from row ``known`` on, and at all from row ``chunk``.
    """

    log: Log
    input: Float[ndarray, " rows"]
    track: Float[ndarray, "rows 3"]
    chunk: int
    known: int
    first: int
    last: int
    rolling: bool


def cut_runs(logs: Sequence[Log], source: str, vehicle: Vehicle, tracks: Sequence[Track | None]) -> Runs:
    """Cut logs into runs and put them on one grid.

    Args:
        logs: The logs.
        source: Input of the model, ``command`` or ``effort``.
        vehicle: Trainset, for the length over which gradients act.
        tracks: Section of each log, positions from its origin; None: the gradient column, and level track
            without one.

    Raises:
        InputError: No log holds a run, or one has positions outside its section.
    """
    spacing = float(np.median(np.concatenate([np.diff(log.time_s) for log in logs])))
    spacing = round(spacing, 6)
    step = float(spacing / np.ceil(spacing / MAX_STEP_S - 1e-9))
    pieces = [
        piece
        for log, track in zip(logs, tracks, strict=True)
        for piece in _pieces(log, source, vehicle, track, spacing)
    ]
    if not pieces:
        raise InputError(
            "no run found",
            file=logs[0].name if len(logs) == 1 else None,
            field="logs",
            allowed=f"samples above {MOVING_MPS:g} m/s for {LEAST_RUN_S:g} s without a gap of {GAP_S:g} s",
        )
    return _on_grid(pieces, step, spacing)


def _pieces(log: Log, source: str, vehicle: Vehicle, track: Track | None, spacing: float) -> list[_Piece]:
    """Runs of one log: cut at standstills, at gaps, and where they get too long."""
    given = log.command if source == "command" else log.effort_n
    if given is None:
        raise InputError("column missing", file=log.name, field=source)
    slopes = _track_at(log, vehicle, track)
    usable = np.isfinite(given)
    gap = max(GAP_S, 5.0 * spacing)
    found = []
    edges = np.flatnonzero((np.diff(log.time_s) > gap) | (np.diff(usable.astype(int)) != 0)) + 1
    for rows in np.split(np.arange(log.time_s.size), edges):
        if not usable[rows[0]]:
            continue
        missed = _missed_changes(log, given, rows, spacing)
        moving = log.speed_mps[rows] > MOVING_MPS
        edges_of_motion = np.flatnonzero(np.diff(moving.astype(int)) != 0) + 1
        for part in np.split(rows, edges_of_motion):
            if log.speed_mps[part[0]] > MOVING_MPS:
                found += _cut_motion(log, given, slopes, int(rows[0]), part, missed)
    return found


def _missed_changes(log: Log, given: ndarray, rows: ndarray, spacing: float) -> ndarray:
    """Rows before which samples are missing while the input changed: its course between them is unknown."""
    change = np.abs(np.diff(given[rows]))
    most = CHANGE * max(float(np.nanmax(np.abs(given))), 1e-9)
    return rows[1:][(np.diff(log.time_s[rows]) > 1.5 * spacing) & (change > most)]


def _cut_motion(
    log: Log, given: ndarray, slopes: ndarray, chunk: int, part: ndarray, missed: ndarray
) -> list[_Piece]:
    """Pieces of one motion: cut where a change was missed, and where they get too long."""
    found = []
    first = _standing_row(log, chunk, int(part[0]))
    known = chunk
    if first is not None and (hidden := missed[(missed > first) & (missed <= part[0])]).size:
        first, known = None, int(hidden[-1])
    for between in np.split(part, np.flatnonzero(np.isin(part[1:], missed)) + 1):
        if between[0] in missed:
            known, first = int(between[0]), None
        time = log.time_s[between]
        count = int(np.ceil((time[-1] - time[0]) / MAX_RUN_S)) or 1
        for rows in np.array_split(between, count):
            begin = int(rows[0]) if first is None else first
            lead = (
                0.0 if first is not None else max(LEAD_S - float(log.time_s[begin] - log.time_s[known]), 0.0)
            )
            if log.time_s[rows[-1]] - log.time_s[rows[0]] >= LEAST_RUN_S + lead:
                found.append(_Piece(log, given, slopes, chunk, known, begin, int(rows[-1]), first is None))
            first = None
    return found


def _standing_row(log: Log, chunk: int, moving: int) -> int | None:
    """A row at standstill before the first that moves; None where the log does not show it.

    Noise hides how a trainset starts, so that the simulation begins well before and starts by itself; but not
    before the stop of the run before has ended.
    """
    slow = moving
    while slow > chunk and log.speed_mps[slow - 1] <= MOVING_MPS:
        slow -= 1
    if slow == moving:
        return None
    time = log.time_s
    earliest = max(
        float(time[moving]) - STANDING_S, float(time[slow]) + (STOPPING_S if slow > chunk else 0.0)
    )
    row = min(int(np.searchsorted(time, earliest)), moving - 1)
    return row if log.speed_mps[row] < 0.5 * MOVING_MPS else None


def _track_at(log: Log, vehicle: Vehicle, track: Track | None) -> Float[ndarray, "rows 3"]:
    """Gradient, curve resistance and tunnel coefficient at each sample."""
    rows = log.time_s.size
    if track is None:
        gradient = np.zeros(rows) if log.gradient_permil is None else log.gradient_permil / 1000.0
        known = np.isfinite(gradient)
        if not known.all():
            gradient = (
                np.interp(log.time_s, log.time_s[known], gradient[known]) if known.any() else np.zeros(rows)
            )
        return np.stack([gradient, np.zeros(rows), np.zeros(rows)], axis=1)
    position = log.position_m
    if position is None:
        mean = 0.5 * (log.speed_mps[1:] + log.speed_mps[:-1])
        position = np.concatenate([[0.0], np.cumsum(mean * np.diff(log.time_s))])
    else:
        known = np.isfinite(position)
        _check_inside(log, position[known], float(track.length_m))
        position = np.interp(log.time_s, log.time_s[known], position[known])
    return np.stack([np.asarray(x) * np.ones(rows) for x in mean_slopes(vehicle, track, position)], axis=1)


def _check_inside(log: Log, position_m: ndarray, length_m: float) -> None:
    """Check that logged positions lie in the section.

    Raises:
        InputError: One does not.
    """
    outside = np.maximum(-position_m, position_m - length_m)
    if outside.max(initial=0.0) > OUTSIDE_M:
        raise InputError(
            "outside the section",
            file=log.name,
            field="position",
            value=round(float(position_m[outside.argmax()]), 1),
            unit="m",
            allowed=f"0 to {length_m:g} m, from the section's origin",
        )


def _knots(piece: _Piece, start_s: float, spacing: float) -> tuple[ndarray, ndarray]:
    """Integral of the input over time: held from sample to sample, interpolated over missing samples."""
    log = piece.log
    rows = slice(piece.chunk, min(piece.last + 2, log.time_s.size))
    known = np.isfinite(piece.input[rows])  # the row behind the piece may begin a gap
    time, given = log.time_s[rows][known], piece.input[rows][known]
    missing = np.flatnonzero(np.diff(time) > 1.5 * spacing)
    if missing.size:
        extra = np.concatenate(
            [np.arange(time[k] + spacing, time[k + 1] - 0.5 * spacing, spacing) for k in missing]
        )
        given = np.insert(given, np.searchsorted(time, extra), np.interp(extra, time, given))
        time = np.insert(time, np.searchsorted(time, extra), extra)
    # Before the log: nothing was on its way to a trainset at standstill; otherwise what the log begins with.
    before = 0.0 if log.speed_mps[piece.chunk] <= 0.0 else float(given[0])
    far = 60.0
    time = np.concatenate([[time[0] - far], time, [time[-1] + far]])
    held = np.concatenate([[before], given])
    return time - start_s, np.concatenate([[0.0], np.cumsum(held * np.diff(time))])


def _on_grid(pieces: Sequence[_Piece], step: float, spacing: float) -> Runs:
    """Put the pieces on one grid, padded to the longest."""
    starts, knots, rows, slopes = [], [], [], []
    for number, piece in enumerate(pieces):
        time = piece.log.time_s
        lead = int(np.ceil(LEAD_S / step - 1e-9))
        at = float(time[piece.first])
        if piece.rolling:
            # the commands on their way at the start must be known: the simulation begins a lead later
            available = at - float(time[piece.known])
            at += max(LEAD_S - available, 0.0)
        start_s = at - lead * step
        starts.append(lead)
        knots.append(_knots(piece, start_s, spacing))
        inside = np.arange(piece.first, piece.last + 1)
        inside = inside[(time[inside] > at) & (piece.log.speed_mps[inside] > MOVING_MPS)]
        since = time[inside] - start_s
        where = np.floor(since / step + 1e-6).astype(int)
        rows.append(
            (
                np.full(inside.size, number),
                where,
                np.maximum(since / step - where, 0.0),
                piece.log.speed_mps[inside],
                since,
                piece.input[inside],
            )
        )
        slopes.append((time - start_s, piece.track))
    run, where, part, speed, since, given = (np.concatenate(column) for column in zip(*rows, strict=True))
    steps = int(where.max(initial=0)) + 2
    grid = step * np.arange(steps + 1)
    track = np.stack(
        [
            np.stack([np.interp(grid[:-1], time, values[:, j]) for j in range(3)], axis=1)
            for time, values in slopes
        ],
        axis=1,
    )
    begin = [
        float(np.interp(starts[k] * step, slopes[k][0], piece.log.speed_mps)) if piece.rolling else 0.0
        for k, piece in enumerate(pieces)
    ]
    return Runs(
        step_s=step,
        time_s=grid,
        starts=np.array(starts),
        rolling=np.array([piece.rolling for piece in pieces]),
        speed_mps=np.array(begin),
        knot_s=[k for k, _ in knots],
        integral=[values for _, values in knots],
        gradient=track[..., 0],
        curve_n_per_kg=track[..., 1],
        tunnel_n_per_mps2=track[..., 2],
        row_run=run,
        row_step=where,
        row_part=part,
        row_mps=speed,
        row_s=since,
        row_input=given,
    )
