"""Analyses of a convoy: the gap that protection needs, string stability.

A disturbance of the speed of the head is amplified along a convoy that is not string stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.leaders import record_leader
from metropilot.convoy.model import Convoy, ConvoyGuard, Member, convoy_members
from metropilot.convoy.plan import MotionPlan
from metropilot.convoy.rollout import HeadRun, drive_convoy
from metropilot.protection import TrainAhead, at_start, spare_gap
from metropilot.railway import Steps
from metropilot.sim import Outcome

FAR_M = 1e4
"""Gap at which the gap that is needed is measured."""
SETTLE_S, RISE_MPS2 = 60.0, 0.4


def needed_gap_m(convoy: Convoy, guard: ConvoyGuard, speed_mps: float) -> float:
    """Smallest gap, rear to front, at which protection does not intervene at a common steady speed.

    Args:
        convoy: The convoy; its last pair is considered.
        guard: Assumption of protection.
        speed_mps: Speed of both.
    """
    pair = convoy_members(replace(convoy, guard=guard))
    own = pair[-1]
    if own.protection is None:
        return 0.0
    at = 0.4 * convoy.section.length_m
    return FAR_M - spare_m(own, at, speed_mps, Ahead(FAR_M, speed_mps))


class Ahead(NamedTuple):
    """The trainset ahead as a member sees it.

    Attributes:
        gap_m: Gap to its rear.
        speed_mps: Its speed.
        acceleration_mps2: Its acceleration.
        age_s: Age of the message that says so.
    """

    gap_m: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    age_s: float = 0.0


def spare_m(
    own: Member,
    position_m: float,
    speed_mps: float,
    ahead: Ahead,
    *,
    share: float = 0.0,
    acceleration_mps2: float = 0.0,
) -> float:
    """Distance by which the trainset ahead could be nearer and a member's command still pass, m.

    Args:
        own: Member with a protection.
        position_m: Position of its front.
        speed_mps: Its speed.
        ahead: The trainset ahead.
        share: Command.
        acceleration_mps2: Acceleration of the member.
    """
    assert own.protection is not None
    seen = TrainAhead(
        np.float64(position_m + ahead.gap_m),
        np.float64(ahead.speed_mps),
        np.float64(ahead.acceleration_mps2),
        np.float64(ahead.age_s),
        own.bounds,
    )
    memory = at_start(own.protection, share=share, acceleration_mps2=acceleration_mps2)
    x, v = np.float64(position_m), np.float64(speed_mps)
    return float(spare_gap(own.protection, memory, x, v, np.float64(share), seen))


class StringGains(NamedTuple):
    """Amplitudes along a convoy whose head swings about a mean speed, at several periods.

    Attributes:
        speed: Of the speed of each trainset, over that of the head. Shape (P, N).
        gap: Of each gap, over that of the first. Shape (P, N - 1).
    """

    speed: Float[ndarray, "periods trainsets"]
    gap: Float[ndarray, "periods followers"]

    @property
    def largest(self) -> tuple[float, float]:
        """Largest gain of speed and of gap from one trainset to the next, over all periods."""
        speed, gap = (float((each[:, 1:] / each[:, :-1]).max(initial=0.0)) for each in self)
        return speed, gap


MEAN_MPS, SWING_MPS2 = 12.0, 0.15
"""Mean speed of the head, and the amplitude of its acceleration."""
BEYOND_S = 60.0
"""Time for which a plan goes on after the motion that is measured."""


def string_gains(
    convoy: Convoy,
    follower: AbstractFollower,
    periods_s: Sequence[float],
    *,
    planned: bool = True,
) -> StringGains:
    """Measure how a convoy amplifies the motion of its head, which accelerates as a sine.

    On a long level track; amplitudes by correlation over whole periods after a settling time. A convoy is
    string stable at a period if no amplitude exceeds that of the trainset ahead.

    Args:
        convoy: The convoy; its section is replaced by a long level one.
        follower: Driver of the followers.
        periods_s: Periods of the sine.
        planned: True if the head announces the mean speed as its plan, from which the sine departs; else it
            announces nothing.
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
    found = [_amplitudes(flat, follower, each, planned=planned) for each in periods_s]
    speed, gap = (np.array(each) for each in zip(*found, strict=True))
    return StringGains(speed / speed[:, :1], gap / gap[:, :1])


def _amplitudes(
    convoy: Convoy, follower: AbstractFollower, period_s: float, *, planned: bool
) -> tuple[ndarray, ndarray]:
    """Amplitudes of speeds and gaps at one period."""
    dt = convoy.dt
    count = max(int(np.ceil(40.0 / period_s)), 2)
    times = dt * np.arange(1, int((SETTLE_S + count * period_s) / dt) + 1)
    swing = SWING_MPS2 * period_s / (2.0 * np.pi)
    begun = times > SETTLE_S - 2.0 * period_s if period_s < 20.0 else times > 35.0
    rising = np.minimum(RISE_MPS2 * times, MEAN_MPS)
    phase = 2.0 * np.pi * (times - SETTLE_S) / period_s
    speeds = rising + np.where(begun, swing * np.sin(phase), 0.0)
    commands = record_leader(*convoy.leader(), np.maximum(speeds, 0.0), dt).command
    # The plan goes on beyond the run: its end is a stop, for which the followers would brake.
    told = np.concatenate([[0.0], rising, np.full(round(BEYOND_S / dt), MEAN_MPS)])
    way = np.concatenate([[0.0], np.cumsum(0.5 * dt * (told[1:] + told[:-1]))])
    plan = MotionPlan(np.float64(0.0), np.float64(dt), way, told) if planned else None
    drive = drive_convoy(convoy, HeadRun("sine", commands, Outcome.OUT_OF_TIME, plan=plan), follower)
    whole = round(count * period_s / dt)
    rows = slice(times.size - whole, times.size)
    wave = np.exp(-1j * phase[rows])
    speeds = [t.speed_mps[1:][rows] - MEAN_MPS for t in drive.trajectories]
    # gaps have no row at departure
    gaps = (drive.gap_m[rows] - drive.gap_m[rows].mean(axis=0)).T
    speed, gap = (np.array([abs(np.mean(each * wave)) for each in found]) for found in (speeds, gaps))
    return speed, gap
