"""Host loop of a convoy: recorded commands of a head and followers behind it, in NumPy float64."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter_ns
from typing import Any, cast, final

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.model import Convoy, Link, Member, convoy_members
from metropilot.convoy.step import (
    UNLIMITED_MPS,
    FollowerObservation,
    MemberState,
    at_departure,
    drive_period,
    make_message,
    observe_member,
    receive_message,
    update_needed_gap,
)
from metropilot.physics import Command
from metropilot.protection import permitted_speed
from metropilot.railway import Restriction
from metropilot.sim import Outcome, Recorder, Trajectory, noise_stream

STAND_S = 3.0
LONGEST_S = 240.0


@dataclass(frozen=True, eq=False)
class ConvoyDrive:
    """Record of the run of a convoy.

    Attributes:
        convoy: The convoy, its section with every restriction announced during the run.
        head: Id of the head's driver.
        follower: Id of the followers' driver.
        trajectories: Trajectory of each trainset, the head first.
        gap_m: True gaps, rear of one to front of the next, after each period. Shape (T, N - 1).
        speed_difference_mps: Speed ahead less own speed. Shape (T, N - 1).
        time_s: Time of the rows of both. Shape (T,).
        outcome: Outcome of the run of the head.
        interventions: Number of interventions of each protection. Shape (N,).
        emergencies: Number of those that used the emergency brake. Shape (N,).
        overspeed_mps: Largest excess over the limit of each. Shape (N,).
        decision_us: Median time of a decision of each follower, microseconds. Shape (N,), 0 for the head.
        recovered_j: Energy returned to the line by each. Shape (N,).
    """

    convoy: Convoy
    head: str
    follower: str
    trajectories: tuple[Trajectory, ...]
    gap_m: Float[ndarray, "rows followers"]
    speed_difference_mps: Float[ndarray, "rows followers"]
    time_s: Float[ndarray, " rows"]
    outcome: Outcome
    interventions: tuple[int, ...]
    emergencies: tuple[int, ...]
    overspeed_mps: tuple[float, ...]
    decision_us: tuple[float, ...]
    recovered_j: tuple[float, ...]

    @property
    def contacts(self) -> int:
        """Pairs of trainsets that touched."""
        return int((self.gap_m < 0.0).any(axis=0).sum())


@dataclass(frozen=True)
class HeadRun:
    """Commands of the head.

    Attributes:
        driver: Id of its driver.
        commands: Command of each period; afterwards it holds its brakes. Shape (T,).
        emergency_s: Time at which it makes an emergency brake (infinite: never).
        outcome: Outcome of its run without emergency brake.
    """

    driver: str
    commands: Float[ndarray, " rows"]
    outcome: Outcome
    emergency_s: float = float("inf")


def drive_convoy(convoy: Convoy, head: HeadRun, follower: AbstractFollower, seed: int = 0) -> ConvoyDrive:
    """Run a convoy until all stand.

    Args:
        convoy: The convoy.
        head: Run of its head.
        follower: Driver of the others, each with a memory of its own.
        seed: Seed of delays and losses of the links.
    """
    rollout = ConvoyRollout(convoy, head, follower, seed)
    while not rollout.over:
        rollout.advance()
    return rollout.result()


@final
class ConvoyRollout:
    """Stepwise run of a convoy, one control period at a time, as :func:`drive_convoy` uses it.

    Args:
        convoy: The convoy.
        head: Run of its head.
        follower: Driver of the others, each with a memory of its own.
        seed: Seed of delays and losses of the links.

    Attributes:
        states: State of every trainset, the head first.
        over: True at the end of the run: all have stood for ``STAND_S``.
    """

    def __init__(self, convoy: Convoy, head: HeadRun, follower: AbstractFollower, seed: int) -> None:
        self.convoy, self.head, self.follower, self.dt = convoy, head, follower, convoy.dt
        self.members = convoy_members(convoy)
        pairs = zip(self.members, (None, *self.members[:-1]), strict=True)
        self.states = [at_departure(own, ahead, self.dt) for own, ahead in pairs]
        self.memories: list[Any] = [follower.init(m.believed, self.dt) for m in self.members]
        self.recorders = [
            Recorder(m.vehicle, self.dt, s.plant) for m, s in zip(self.members, self.states, strict=True)
        ]
        self.errors = [noise_stream(seed, k) for k in range(len(self.members))]
        self.pending = sorted(
            (each for each in convoy.disturbance(0).updates if each.restriction is not None),
            key=lambda update: update.at_s,
        )
        self.random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
        self.decision_us: list[list[float]] = [[] for _ in self.members]
        self.rows: list[tuple[float, list[float], list[float]]] = []
        self.period, self.stood_s, self.over = 0, 0.0, False

    @property
    def time_s(self) -> float:
        """Time since departure."""
        return self.period * self.dt

    def advance(self) -> tuple[float, list[float], list[float]]:
        """Run one control period; returns time, gaps and speed differences after it."""
        now = np.float64(self.time_s)
        self.apply_updates()
        self.listen(now)
        self.move(now, self.period)
        self.note(float(now) + self.dt)
        still = all(s.plant.speed_mps <= 0 for s in self.states)
        ended = now >= min(self.head.commands.size * self.dt, self.head.emergency_s + self.dt)
        self.stood_s = self.stood_s + self.dt if still and ended else 0.0
        self.period += 1
        longest = self.head.commands.size * self.dt + LONGEST_S
        self.over = self.stood_s >= STAND_S or self.time_s >= longest
        return self.rows[-1]

    def apply_updates(self) -> None:
        """Put the temporary speed restrictions that are due into force, for plants and protections.

        New arrival times act on the driver of the head alone, in the run that gave its commands.
        """
        while self.pending and self.pending[0].at_s <= self.time_s:
            restriction = cast("Restriction", self.pending.pop(0).restriction)
            self.convoy = replace(self.convoy, section=self.convoy.section.with_restriction(restriction))
            links = [member.link for member in self.members]
            members = convoy_members(self.convoy)
            self.members = tuple(m._replace(link=link) for m, link in zip(members, links, strict=True))

    def relink(self, link: Link) -> None:
        """Change the quality of all links from now on; messages in flight are kept."""
        self.members = tuple(m._replace(link=link.numbers()) for m in self.members)

    def brake_head(self) -> None:
        """Demand the emergency brake of the head from now on."""
        self.head = replace(self.head, emergency_s=min(self.head.emergency_s, self.time_s))

    def listen(self, now: np.float64) -> None:
        """Exchange messages along the convoy."""
        before = list(self.states)
        for k in range(1, len(self.members)):
            message = make_message(self.members[k - 1], before[k - 1], now)
            state = receive_message(self.members[k], before[k], message, self.random.random(2))
            self.states[k] = update_needed_gap(self.members[k], state, now, np.float64(self.dt))

    def move(self, now: np.float64, period: int) -> None:
        """Advance all trainsets by one control period."""
        self.states = [
            self.move_one(k, own, state, now, period)
            for k, (own, state) in enumerate(zip(self.members, self.states, strict=True))
        ]

    def move_one(self, k: int, own: Member, state: MemberState, now: np.float64, period: int) -> MemberState:
        """Advance one trainset by one control period."""
        permitted = UNLIMITED_MPS
        if own.protection is not None:
            permitted = float(permitted_speed(own.protection, float(state.plant.position_m)))
        if k == 0:
            running = period < self.head.commands.size
            share = float(self.head.commands[period]) if running else -1.0
            command = Command(np.float64(share), bool(now >= self.head.emergency_s))
        else:
            command = Command(
                self.decide(k, observe_member(own, state, now, self.dt, np.float64(permitted))), False
            )
        noise = self.errors[k].standard_normal() if own.speed_noise_mps > 0 else 0.0
        after, record = drive_period(own, state, command, now, np.float64(self.dt), np.float64(noise))
        self.recorders[k].add(own.track, after.plant, record, permitted)
        return after

    def decide(self, k: int, seen: FollowerObservation) -> np.float64:
        """The command of a follower; records the decision time."""
        began = perf_counter_ns()
        share, self.memories[k] = self.follower.act(self.memories[k], seen)
        self.decision_us[k].append((perf_counter_ns() - began) / 1e3)
        return np.float64(share)

    def note(self, time_s: float) -> None:
        """Record gaps and speed differences after the period."""
        front = [float(s.plant.position_m) for s in self.states]
        speed = [float(s.plant.speed_mps) for s in self.states]
        rear = [x - float(m.length_m) for x, m in zip(front, self.members, strict=True)]
        pairs = range(1, len(front))
        self.rows.append(
            (time_s, [rear[k - 1] - front[k] for k in pairs], [speed[k - 1] - speed[k] for k in pairs])
        )

    def result(self) -> ConvoyDrive:
        """The record of the run."""
        time_s, gap, apart = zip(*self.rows, strict=True)
        watched = [s.watched for s in self.states]
        stopped = np.isfinite(self.head.emergency_s)
        return ConvoyDrive(
            convoy=self.convoy,
            head=self.head.driver,
            follower=self.follower.id,
            trajectories=tuple(
                recorder.trajectory(own.track, recorder.permitted[-1])
                for recorder, own in zip(self.recorders, self.members, strict=True)
            ),
            gap_m=np.array(gap),
            speed_difference_mps=np.array(apart),
            time_s=np.array(time_s),
            outcome=Outcome.STALLED if stopped else self.head.outcome,
            interventions=_counts(watched, "interventions"),
            emergencies=_counts(watched, "emergencies"),
            overspeed_mps=tuple(recorder.overspeed_mps for recorder in self.recorders),
            decision_us=tuple(float(np.median(times)) if times else 0.0 for times in self.decision_us),
            recovered_j=tuple(float(s.plant.recovered_j) for s in self.states),
        )


def _counts(watched: Sequence[Any], name: str) -> tuple[int, ...]:
    return tuple(0 if memory is None else int(getattr(memory, name)) for memory in watched)
