"""String stability: amplification of a disturbance of the speed of the head along a convoy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.leaders import record_leader
from metropilot.convoy.model import Convoy
from metropilot.convoy.rollout import HeadRun, drive_convoy
from metropilot.railway import Steps
from metropilot.sim import Outcome

SETTLE_S, RISE_MPS2 = 60.0, 0.4


def speed_gains(
    convoy: Convoy,
    follower: AbstractFollower,
    periods_s: Sequence[float],
    mean_mps: float = 12.0,
    swing_mps2: float = 0.15,
) -> Float[ndarray, "periods trainsets"]:
    """Amplitude of the speed of each trainset over that of the head, which accelerates as a sine.

    On a long level track; amplitudes by correlation over whole periods after a settling time. A convoy is
    string stable at a period if no amplitude exceeds that of the trainset ahead.

    Args:
        convoy: The convoy; its section is replaced by a long level one.
        follower: Driver of the followers.
        periods_s: Periods of the sine.
        mean_mps: Mean speed.
        swing_mps2: Amplitude of the acceleration of the head.
    """
    level = replace(
        convoy.section,
        length_m=20_000.0,
        gradient_permil=Steps(np.array([0.0]), np.array([0.0])),
        limit_mps=Steps(np.array([0.0]), np.array([40.0])),
        curves=(),
        tunnels=(),
    )
    flat = replace(convoy, section=level)
    return np.array([_gains(flat, follower, each, mean_mps, swing_mps2) for each in periods_s])


def _gains(
    convoy: Convoy, follower: AbstractFollower, period_s: float, mean_mps: float, swing_mps2: float
) -> ndarray:
    """Gains at one period; the first, of the head, is 1."""
    dt = convoy.dt
    count = max(int(np.ceil(40.0 / period_s)), 2)
    times = dt * np.arange(1, int((SETTLE_S + count * period_s) / dt) + 1)
    swing = swing_mps2 * period_s / (2.0 * np.pi)
    begun = times > SETTLE_S - 2.0 * period_s if period_s < 20.0 else times > 35.0
    rising = np.minimum(RISE_MPS2 * times, mean_mps)
    phase = 2.0 * np.pi * (times - SETTLE_S) / period_s
    speeds = rising + np.where(begun, swing * np.sin(phase), 0.0)
    commands = record_leader(*convoy.leader(), np.maximum(speeds, 0.0), dt).command
    drive = drive_convoy(convoy, HeadRun("sine", commands, Outcome.OUT_OF_TIME), follower)
    whole = round(count * period_s / dt)
    rows = slice(times.size - whole, times.size)
    wave = np.exp(-1j * phase[rows])
    amplitude = [abs(np.mean((t.speed_mps[1:][rows] - mean_mps) * wave)) for t in drive.trajectories]
    return np.array(amplitude) / amplitude[0]
