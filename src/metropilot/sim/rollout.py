"""The host loop: one driver drives one run under protection, in NumPy float64 (never imports JAX)."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter_ns
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from metropilot.physics import Command, at_rest, delay_steps, step, track_arrays, vehicle_arrays
from metropilot.protection import at_start, permitted_speed, protect, supervise
from metropilot.railway import Section, Trainset
from metropilot.sim.bounds import declared_bounds
from metropilot.sim.disturbance import NOISE_CUT, TimetableUpdate
from metropilot.sim.driver import AbstractDriver
from metropilot.sim.recorder import Recorder
from metropilot.sim.run import STOP_TOLERANCE_M, Observation, Outcome, Run
from metropilot.sim.trajectory import Trajectory

STALLED_S = 20.0
GIVE_UP_M = 100.0
OVERSPEED_MPS = 1e-6


@dataclass(frozen=True, eq=False)
class Drive:
    """A run as it was driven.

    Attributes:
        run: What was to be driven.
        driver: Id of the driver.
        trajectory: Row by row.
        outcome: How it ended.
        running_time_s: From departure to the last stand (to the end, if it never came to one).
        scheduled_time_s: Scheduled running time as it stood at the end.
        section: The section with every restriction announced during the run.
        trainset: The trainset as it really was.
        interventions: How many times protection overruled the driver (an uninterrupted spell counts once).
        max_overspeed_mps: Largest excess over the limit in force, 0 if none.
        recovered_j: Energy given back to the line.
        decision_us: Time the driver took for each decision, microseconds.
        overruled: Whether protection overruled the driver in each step; a command that is no number counts.
    """

    run: Run
    driver: str
    trajectory: Trajectory
    outcome: Outcome
    running_time_s: float
    scheduled_time_s: float
    section: Section
    trainset: Trainset
    interventions: int
    max_overspeed_mps: float
    recovered_j: float
    decision_us: Float[ndarray, " steps"]
    overruled: Bool[ndarray, " steps"]


def drive(run: Run, driver: AbstractDriver) -> Drive:
    """Let a driver drive a run until it stands at the stop, or until it plainly will not.

    The run ends when the trainset stands within 0.3 m of the stop (arrived) or beyond it (overshot), has
    stood anywhere else for 20 s (stalled), is 100 m past the stop (overshot), or has used twice its scheduled
    time and 120 s more (out of time). A speed above the limit in force makes the outcome ``overspeed``
    wherever the run ended.

    Args:
        run: What is to be driven; its scenario is the truth that the driver is not told.
        driver: Whatever gives the command.

    Raises:
        Infeasible: The driver cannot meet the scheduled time.
    """
    rollout = Rollout(run, driver)
    while rollout.outcome is None:
        rollout.advance()
    return rollout.drive()


class Moment(NamedTuple):
    """A run at the end of a control period.

    Attributes:
        time_s: Time since departure.
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed.
        acceleration_mps2: Acceleration over the period.
        wanted: What the driver asked for.
        command: What protection let pass.
        level: What protection did: an index into :data:`metropilot.protection.LEVELS`.
        permitted_mps: Speed protection permits here.
        energy_wheel_j: Traction energy at the wheel so far.
        energy_line_j: Net energy at the line so far.
    """

    time_s: float
    position_m: float
    speed_mps: float
    acceleration_mps2: float
    wanted: float
    command: float
    level: int
    permitted_mps: float
    energy_wheel_j: float
    energy_line_j: float


@final
class Rollout:
    """A run in progress, one control period at a time: what :func:`drive` loops over.

    Whoever steps it may tell the driver news on the way, or take the lever for a while; both happen at the
    beginning of the next period, so that the same calls at the same times give the same bits.

    Args:
        run: What is to be driven.
        driver: Whatever gives the command.

    Attributes:
        outcome: How the run has ended, None while it goes on (see :func:`drive`).
        scheduled_time_s: Scheduled running time as it stands.
        section: The section with every restriction announced so far.

    Raises:
        Infeasible: The driver cannot meet the scheduled time.
    """

    def __init__(self, run: Run, driver: AbstractDriver) -> None:
        self.run = run
        self.driver = driver
        self.trainset = run.scenario.true_plant(run.trainset)
        self.vehicle = vehicle_arrays(self.trainset)
        self.state = at_rest(self.vehicle, delay_steps=delay_steps(float(self.vehicle.delay_s), run.dt))
        self.scheduled_time_s = run.scheduled_time_s
        self.pending = sorted(run.scenario.updates, key=lambda update: update.at_s)
        self.random = np.random.default_rng(np.random.SeedSequence(run.seed, spawn_key=(1,)))
        self.recorder = Recorder(self.vehicle, run.dt, self.state)
        self.decision_us: list[float] = []
        self.overruled: list[bool] = []
        self.stood_since_s = 0.0
        self.bounds = declared_bounds(run)
        self.enter(run.section)
        self.watched = at_start(self.protection)
        self.memory = driver.init(run)
        self.by_hand: float | None = None
        self.wanted, self.command, self.level = 0.0, 0.0, 0
        self.outcome: Outcome | None = None

    def enter(self, section: Section) -> None:
        """Take a section as the truth: at departure, and after every new restriction, at once in force."""
        self.section = section
        self.track = track_arrays(section, self.trainset)
        believed = self.run.scenario.nominal(self.run.trainset)
        self.protection = protect(section, believed, self.bounds)

    def tell(self, news: TimetableUpdate) -> None:
        """Tell the driver something on the way; what is due already is told at once."""
        self.pending = sorted([*self.pending, news], key=lambda item: item.at_s)

    def take(self, share: float | None) -> None:
        """Take the lever and hold it at a share, or (None) give it back to the driver.

        A driver who gets it back prepares anew: for the run as it was, with all the news of the way.
        """
        if share is None and self.by_hand is not None:
            self.memory = self.driver.init(self.run)
        self.by_hand = share

    def advance(self) -> Moment:
        """One control period: hear the news, decide, supervise, move."""
        self.hear()
        self._move()
        self.outcome = self._ended()
        return self.moment()

    def moment(self) -> Moment:
        """The run as it is."""
        state = self.state
        return Moment(
            time_s=float(state.time_s),
            position_m=float(state.position_m),
            speed_mps=float(state.speed_mps),
            acceleration_mps2=float(state.acceleration_mps2),
            wanted=self.wanted,
            command=self.command,
            level=self.level,
            permitted_mps=self.permitted(),
            energy_wheel_j=float(state.traction_j),
            energy_line_j=float(state.line_j),
        )

    def drive(self) -> Drive:
        """The run as it was driven, once it is over.

        Raises:
            ValueError: It is not over.
        """
        if self.outcome is None:
            raise ValueError("the run is not over")
        standing = self.state.speed_mps <= 0
        over = self.recorder.overspeed_mps
        return Drive(
            run=self.run,
            driver=self.driver.id,
            trajectory=self.recorder.trajectory(self.track, self.permitted()),
            outcome=Outcome.OVERSPEED if over > OVERSPEED_MPS else self.outcome,
            running_time_s=self.stood_since_s if standing else float(self.state.time_s),
            scheduled_time_s=self.scheduled_time_s,
            section=self.section,
            trainset=self.trainset,
            interventions=int((np.diff(self.overruled, prepend=False) & self.overruled).sum()),
            max_overspeed_mps=over,
            recovered_j=float(self.state.recovered_j),
            decision_us=np.array(self.decision_us),
            overruled=np.array(self.overruled),
        )

    def hear(self) -> None:
        """Deliver the news that is due."""
        while self.pending and self.pending[0].at_s <= self.state.time_s:
            news = self.pending.pop(0)
            if news.scheduled_time_s is not None:
                self.scheduled_time_s = news.scheduled_time_s
            if news.restriction is not None:
                self.enter(self.section.restricted(news.restriction))

    def permitted(self) -> float:
        """Permitted speed where the trainset is."""
        return float(permitted_speed(self.protection, float(self.state.position_m)))

    def observe(self, permitted_mps: float) -> Observation:
        """What the driver sees: the speed with its noise, everything else as it is."""
        speed = float(self.state.speed_mps)
        if (sigma := self.run.scenario.speed_noise_mps) > 0:
            noise = float(np.clip(self.random.standard_normal(), -NOISE_CUT, NOISE_CUT))
            speed = max(speed + sigma * noise, 0.0) if speed > 0 else 0.0
        return Observation(
            time_s=float(self.state.time_s),
            position_m=float(self.state.position_m),
            speed_mps=speed,
            acceleration_mps2=float(self.state.acceleration_mps2),
            scheduled_time_s=self.scheduled_time_s,
            permitted_mps=permitted_mps,
            section=self.section,
        )

    def _move(self) -> None:
        """Decide, supervise, move."""
        permitted = self.permitted()
        observation = self.observe(permitted)
        began = perf_counter_ns()
        if self.by_hand is None:
            share, self.memory = self.driver.act(self.memory, observation)
        else:
            share = self.by_hand
        self.decision_us.append((perf_counter_ns() - began) / 1e3)
        wanted = Command(float(share), False)
        seen = observation.position_m, observation.speed_mps
        command, self.watched, verdict = supervise(self.protection, self.watched, *seen, wanted)
        self.overruled.append(bool(verdict.level > 0 or not np.isfinite(wanted.share)))
        was_moving = self.state.speed_mps > 0
        self.state = step(self.vehicle, self.track, self.state, command, self.run.dt)
        if was_moving and self.state.speed_mps <= 0:
            self.stood_since_s = float(self.state.time_s)
        self.recorder.add(self.track, self.state, float(command.share), permitted)
        self.wanted, self.command, self.level = wanted.share, float(command.share), int(verdict.level)

    def _ended(self) -> Outcome | None:
        """How the run has ended, or None while it goes on."""
        error = float(self.state.position_m) - self.section.length_m
        now = float(self.state.time_s)
        if self.state.speed_mps <= 0:
            if abs(error) <= STOP_TOLERANCE_M:
                return Outcome.ARRIVED
            if error > 0:
                return Outcome.OVERSHOT
            if now - self.stood_since_s > STALLED_S:
                return Outcome.STALLED
        if error > GIVE_UP_M:
            return Outcome.OVERSHOT
        return Outcome.OUT_OF_TIME if now > 2 * self.scheduled_time_s + 120 else None
