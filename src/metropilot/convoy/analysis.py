"""Analyses of a convoy: the gap that protection needs, capacity, string stability.

A disturbance of the speed of the head is amplified along a convoy that is not string stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.leaders import record_leader
from metropilot.convoy.model import Convoy, ConvoyGuard, convoy_members
from metropilot.convoy.rollout import HeadRun, drive_convoy
from metropilot.protection import TrainAhead, at_start, spare_gap
from metropilot.railway import Steps
from metropilot.sim import Outcome

OVERLAP_M = 20.0
SETTLE_S, RISE_MPS2 = 60.0, 0.4


def needed_gap_m(convoy: Convoy, guard: ConvoyGuard, speed_mps: float, age_s: float = 0.0) -> float:
    """Smallest gap, rear to front, at which protection does not intervene at a common steady speed.

    Args:
        convoy: The convoy; its last pair is considered.
        guard: Assumption of protection.
        speed_mps: Speed of both.
        age_s: Age of the last message.
    """
    pair = convoy_members(replace(convoy, guard=guard))
    own = pair[-1]
    if own.protection is None:
        return 0.0
    far, at = np.float64(1e4), np.float64(0.4 * convoy.section.length_m)
    ahead = TrainAhead(at + far, np.float64(speed_mps), np.float64(0.0), np.float64(age_s), own.bounds)
    watched = at_start(own.protection)
    spare = spare_gap(own.protection, watched, at, np.float64(speed_mps), np.float64(0.0), ahead)
    return float(far - spare)


@dataclass(frozen=True)
class ConvoyService:
    """Service on a line: convoys of identical trainsets under a moving block.

    Attributes:
        count: Trainsets of a convoy; 1: no convoys.
        length_m: Length of one trainset.
        inside_m: Gap inside a convoy.
        apart_m: Gap between convoys at the speed on the line.
        speed_mps: Speed on the line.
        rate_mps2: Acceleration and deceleration in service.
        dwell_s: Time at a platform.
    """

    count: int
    length_m: float
    inside_m: float
    apart_m: float
    speed_mps: float
    rate_mps2: float = 0.8
    dwell_s: float = 30.0

    @property
    def convoy_m(self) -> float:
        """Length of a convoy."""
        return self.count * self.length_m + (self.count - 1) * self.inside_m

    @property
    def line_per_h(self) -> float:
        """Trainsets that pass a point of plain line in an hour at a steady speed."""
        return 3600.0 * self.count * self.speed_mps / (self.convoy_m + self.apart_m)

    @property
    def platform_per_h(self) -> float:
        """Trainsets an hour through a platform as long as a convoy.

        Dwell, the time until the convoy has cleared platform and overlap, and the time the next one, as near
        as its braking distance, takes to run in.
        """
        clear_m, rate, speed = self.convoy_m + OVERLAP_M, self.rate_mps2, self.speed_mps
        rising_m = 0.5 * speed**2 / rate
        clear_s = (2.0 * min(clear_m, rising_m) / rate) ** 0.5 + max(clear_m - rising_m, 0.0) / speed
        return 3600.0 * self.count / (self.dwell_s + clear_s + speed / rate)


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
