"""Host loop: one driver drives one run under protection, in NumPy float64 (never imports JAX)."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Any, NamedTuple, cast, final

import numpy as np
from numpy import ndarray

from metropilot._typing import Bool, Float, Int
from metropilot.errors import InputError
from metropilot.physics import Command, at_rest, delay_steps, track_arrays, vehicle_arrays
from metropilot.protection import Protection, Verdict, at_start, permitted_speed, protect
from metropilot.railway import Section, Trainset
from metropilot.sim.bounds import declared_bounds
from metropilot.sim.disturbance import TimetableUpdate
from metropilot.sim.driver import AbstractDriver, read_command
from metropilot.sim.outcome import CODES, RUNNING, OutcomeRule, final_outcome
from metropilot.sim.run import Observation, Outcome, Run
from metropilot.sim.step import RunParams, RunState, control_period, first_state, noise_stream, running_time
from metropilot.sim.trajectory import Recorder, Trajectory

RULE = OutcomeRule()


@dataclass(frozen=True, eq=False)
class Drive:
    """Completed run with its record.

    Attributes:
        run: The run.
        driver: Id of the driver.
        trajectory: Trajectory, one row a control period.
        outcome: Outcome of the run.
        running_time_s: Time from departure to the last standstill (to the end, if there was none), s.
        scheduled_time_s: Scheduled running time in force at the end, s.
        section: The section with every restriction announced during the run.
        trainset: True plant.
        interventions: Interventions of protection; consecutive periods count once.
        max_overspeed_mps: Largest excess over the limit in force, 0 if none, m/s.
        recovered_j: Energy fed back into the line, J.
        decision_us: Computing time of each decision, microseconds.
        overruled: True in each step in which protection overruled the driver, or the command was not a
            finite number.
        levels: Level of the intervention in each step, an index into
            :data:`metropilot.protection.LEVELS`; empty where it is not recorded (compiled batches).
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
    levels: Int[ndarray, " steps"] = field(default_factory=lambda: np.zeros(0, np.int64))


def drive(run: Run, driver: AbstractDriver) -> Drive:
    """Simulate a run with a driver until an :class:`OutcomeRule` ends it.

    The run ends when the trainset stands within 0.3 m of the stop (arrived) or beyond it (overshot), has
    stood anywhere else for 20 s (stalled), is 100 m past the stop (overshot), or has used twice its scheduled
    time and 120 s more (out of time). A speed above the limit in force makes the outcome ``overspeed``
    wherever the run ended.

    Args:
        run: The run; its disturbance acts on the plant and is not visible to the driver.
        driver: The driver.

    Raises:
        Infeasible: The driver cannot meet the scheduled time.
    """
    rollout = Rollout(run, driver)
    while rollout.outcome is None:
        rollout.advance()
    return rollout.drive()


class Moment(NamedTuple):
    """State of a run at the end of a control period.

    Attributes:
        time_s: Time since departure.
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed.
        acceleration_mps2: Acceleration over the period.
        wanted: Command of the driver, or of the manual lever.
        command: Command after protection.
        level: Level of the intervention, an index into :data:`metropilot.protection.LEVELS`.
        permitted_mps: Permitted speed at the position.
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
    """Run in progress, advanced one control period at a time; :func:`drive` loops over it.

    A caller may announce timetable updates on the way (:meth:`tell`) and give the command by hand
    (:meth:`take`). Both take effect at the beginning of the next period, so that the same calls at the same
    times give bitwise equal results.

    Args:
        run: The run.
        driver: The driver.

    Attributes:
        outcome: Outcome of the run; None while it is in progress (see :func:`drive`).
        scheduled_time_s: Scheduled running time in force, s.
        section: The section with every restriction announced so far.

    Raises:
        Infeasible: The driver cannot meet the scheduled time.
    """

    def __init__(self, run: Run, driver: AbstractDriver) -> None:
        self.run = run
        self.driver = driver
        self.trainset = run.disturbance.true_plant(run.trainset)
        vehicle = vehicle_arrays(self.trainset)
        self.section = run.section
        self.pending = sorted(run.disturbance.updates, key=lambda update: update.at_s)
        self.errors = noise_stream(run.seed)
        self.bounds = declared_bounds(run)
        self.params = RunParams(
            vehicle=vehicle,
            track=track_arrays(run.section, self.trainset),
            protection=protect(run.section, run.disturbance.nominal(run.trainset), self.bounds),
            length_m=run.section.length_m,
            scheduled_s=run.scheduled_time_s,
            speed_noise_mps=run.disturbance.speed_noise_mps,
            dt=run.dt,
        )
        plant = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), run.dt))
        self.state = first_state(plant, at_start(self.protection))
        self.recorder = Recorder(vehicle, run.dt, plant)
        self.decision_us: list[float] = []
        self.overruled: list[bool] = []
        self.levels: list[int] = []
        self.memory = driver.init(run)
        self.by_hand: float | None = None
        self.permitted_mps = self.find_permitted_speed()
        self.wanted, self.command, self.level = 0.0, 0.0, 0
        self.outcome: Outcome | None = None

    @property
    def scheduled_time_s(self) -> float:
        """Scheduled running time in force, s."""
        return self.params.scheduled_s

    def enter(self, section: Section) -> None:
        """Replace the section in force, for plant and protection, after a new restriction."""
        self.section = section
        nominal = self.run.disturbance.nominal(self.run.trainset)
        self.params = self.params._replace(
            track=track_arrays(section, self.trainset), protection=protect(section, nominal, self.bounds)
        )

    def tell(self, update: TimetableUpdate) -> None:
        """Announce a timetable update during the run; one already due takes effect in the next period."""
        self.pending = sorted([*self.pending, update], key=lambda item: item.at_s)

    def take(self, share: float | None) -> None:
        """Hold the command at a share by hand, or (None) return control to the driver.

        On return the driver is initialised again for the original run.
        """
        if share is None and self.by_hand is not None:
            self.memory = self.driver.init(self.run)
        self.by_hand = share

    def advance(self) -> Moment:
        """Simulate one control period, with the timetable updates that are due at its beginning."""
        self.apply_updates()
        self.permitted_mps = self.find_permitted_speed()
        params = self.params
        self.state, self.memory, record = control_period(
            params, self.state, self.memory, self.decide, rule=RULE, noise=self.noise()
        )
        self.overruled.append(bool(record.intervened))
        self.recorder.add(params.track, self.state.plant, record, self.permitted_mps)
        self.wanted, self.command = record.wanted.share, float(record.command.share)
        self.level = int(cast("Verdict", record.verdict).level)
        self.levels.append(self.level)
        if self.state.outcome != RUNNING:
            self.outcome = CODES[self.state.outcome]
        return self.moment()

    def decide(self, memory: Any, state: RunState) -> tuple[Command, Any]:  # noqa: ANN401 (a driver's)
        """Command of the driver or of the manual lever; records the computing time."""
        observation = observation_of(self.params, state, self.section, self.permitted_mps)
        began = perf_counter_ns()
        if self.by_hand is None:
            share, memory = self.driver.act(memory, observation)
        else:
            share = self.by_hand
        self.decision_us.append((perf_counter_ns() - began) / 1e3)
        return Command(read_command(self.driver, share), False), memory

    def noise(self) -> float:
        """Error of the next measured speed in standard deviations, from the run's own stream."""
        return float(self.errors.standard_normal()) if self.run.disturbance.speed_noise_mps > 0 else 0.0

    def moment(self) -> Moment:
        """State of the run now."""
        state = self.state.plant
        return Moment(
            time_s=float(state.time_s),
            position_m=float(state.position_m),
            speed_mps=float(state.speed_mps),
            acceleration_mps2=float(state.acceleration_mps2),
            wanted=self.wanted,
            command=self.command,
            level=self.level,
            permitted_mps=self.find_permitted_speed(),
            energy_wheel_j=float(state.traction_j),
            energy_line_j=float(state.line_j),
        )

    def drive(self) -> Drive:
        """Result of the run after its end.

        Raises:
            ValueError: The run has not ended.
        """
        if self.outcome is None:
            raise ValueError("the run is not over")
        plant, over = self.state.plant, self.recorder.overspeed_mps
        return Drive(
            run=self.run,
            driver=self.driver.id,
            trajectory=self.recorder.trajectory(self.params.track, self.find_permitted_speed()),
            outcome=final_outcome(int(self.state.outcome), over),
            running_time_s=float(running_time(self.state)),
            scheduled_time_s=self.scheduled_time_s,
            section=self.section,
            trainset=self.trainset,
            interventions=int((np.diff(self.overruled, prepend=False) & self.overruled).sum()),
            max_overspeed_mps=over,
            recovered_j=float(plant.recovered_j),
            decision_us=np.array(self.decision_us),
            overruled=np.array(self.overruled),
            levels=np.array(self.levels, np.int64),
        )

    def apply_updates(self) -> None:
        """Apply the timetable updates that are due."""
        while self.pending and self.pending[0].at_s <= self.state.plant.time_s:
            update = self.pending.pop(0)
            if update.scheduled_time_s is not None:
                self.params = self.params._replace(scheduled_s=update.scheduled_time_s)
            if update.restriction is not None:
                self.enter(self.section.with_restriction(update.restriction))
                more_s = update.restriction.passing_time_s(self.trainset.length_m)
                self.params = self.params._replace(restricted_s=self.params.restricted_s + more_s)

    @property
    def protection(self) -> Protection:
        """Protection under the restrictions in force; every rollout is supervised."""
        return cast("Protection", self.params.protection)

    def find_permitted_speed(self) -> float:
        """Permitted speed at the trainset's position, m/s."""
        return float(permitted_speed(self.protection, float(self.state.plant.position_m)))


def observation_of(params: RunParams, state: RunState, section: Section, permitted_mps: float) -> Observation:
    """Observation of a driver: the measured speed, and the true values of everything else.

    Args:
        params: Data of the period.
        state: State of the run at its beginning.
        section: The section with every restriction announced so far.
        permitted_mps: Permitted speed at the position of the state.
    """
    plant = state.plant
    return Observation(
        time_s=float(plant.time_s),
        position_m=float(plant.position_m),
        speed_mps=float(state.measured_mps),
        acceleration_mps2=float(plant.acceleration_mps2),
        scheduled_time_s=params.scheduled_s,
        permitted_mps=permitted_mps,
        section=section,
        intervention=0 if state.supervision is None else int(state.supervision.level),
    )


LATE_RATIO = 1.5
"""The simulation ends after this many times the scheduled running time."""
LEAST_NODES = 3
"""With fewer positions on the way the trainset has not moved."""
STANDING_S = 2.0
"""The simulation ends once the trainset has stood this long."""
LEAST_SPEED_MPS = 0.05
"""Speed between the two ends is at least this, so that the time between two nodes is finite."""


class NominalDrive(NamedTuple):
    """Simulated drive at nodes of distance.

    Attributes:
        position_m: Positions, increasing, from the origin to the stop. Shape (N,).
        speed_mps: Speed there, zero at both ends and positive between. Shape (N,).
        running_time_s: Running time, s.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    running_time_s: float


def simulate_nominal(run: Run, driver: AbstractDriver) -> NominalDrive:
    """Simulate a run with a driver on the nominal plant, under protection.

    Args:
        run: The run.
        driver: The driver to simulate.

    Raises:
        InputError: The trainset never moves.
    """
    trainset = run.disturbance.nominal(run.trainset)
    vehicle = vehicle_arrays(trainset)
    guard = protect(run.section, trainset, declared_bounds(run))
    params = RunParams(
        vehicle=vehicle,
        track=track_arrays(run.section, trainset),
        protection=guard,
        length_m=run.section.length_m,
        scheduled_s=run.scheduled_time_s,
        speed_noise_mps=0.0,
        dt=run.dt,
    )

    def decide(memory: Any, state: RunState) -> tuple[Command, Any]:  # noqa: ANN401 (a driver's memory)
        permitted = float(permitted_speed(guard, float(state.plant.position_m)))
        share, memory = driver.act(memory, observation_of(params, state, run.section, permitted))
        return Command(read_command(driver, share), False), memory

    plant = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), run.dt))
    state, memory = first_state(plant, at_start(guard)), driver.init(run)
    nodes, still_s, time_s = [(0.0, 0.0)], 0.0, 0.0
    while float(state.plant.time_s) < LATE_RATIO * run.scheduled_time_s and still_s < STANDING_S:
        state, memory, _ = control_period(params, state, memory, decide, rule=RULE)
        moved = float(state.plant.position_m) > nodes[-1][0]
        still_s = 0.0 if moved else still_s + run.dt
        if moved:
            nodes.append((float(state.plant.position_m), float(state.plant.speed_mps)))
            time_s = float(state.plant.time_s)
    if len(nodes) < LEAST_NODES:
        raise InputError("the driver to be tracked does not move", field="driver", value=driver.id)
    position_m, speed_mps = np.array(nodes).T
    # the plan ends at the stop itself, a few centimetres from where the trainset stood
    position_m = position_m * float(params.track.length_m) / position_m[-1]
    speed_mps[1:-1] = np.maximum(speed_mps[1:-1], LEAST_SPEED_MPS)
    speed_mps[-1] = 0.0
    return NominalDrive(position_m, speed_mps, time_s)
