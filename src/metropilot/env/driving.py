"""Driving problem as a functional, compiled environment: the plant under protection, composed of parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from metropilot._schema import Range, check_name, check_number
from metropilot._typing import Array, Bool, Flag, Float, Index, Key, Num, Scalar
from metropilot.control import MeasuredMotion, first_motion, fuse_motion
from metropilot.env.assists import apply_assists
from metropilot.env.config import DrivingConfig
from metropilot.env.features import FeatureContext, feature_context, observe
from metropilot.env.interface import AbstractTask, ActionSpace, Transition
from metropilot.env.randomization import StartDistribution, draw
from metropilot.env.rewards import PeriodChange
from metropilot.env.tables import PERMITTED_COLUMN, SectionRows, near_protection
from metropilot.errors import InputError
from metropilot.physics import Command, Forces, State, delay_steps
from metropilot.protection import Memory
from metropilot.sim import (
    CODES,
    RUNNING,
    Episode,
    Outcome,
    RunParams,
    RunState,
    control_period,
    first_state,
    running_time,
    true_vehicle,
)

UNROLLED = 2
"""More control periods to a decision than this are a loop: unrolled, each would be compiled again."""


class DriveState(NamedTuple):
    """State of an episode. All 0-d but the pipelines of plant and protection.

    Attributes:
        start: Parameters drawn for the episode.
        run: State of the run.
        motion: Position and speed as estimated from the measurements, where they are noisy.
        command: Last command of the driver, assists included.
        stopping: True while the stop assist brakes for the station.
        decisions: Decisions taken.
        overruled: Share of the last decision's periods with an intervention of protection.
        jerk_mps2: Integral of the absolute jerk.
        max_jerk_mps3: Largest jerk.
        max_overspeed_mps: Largest excess over the limit.
    """

    start: StartDistribution
    run: RunState
    motion: MeasuredMotion
    command: Scalar
    stopping: Flag
    decisions: Index
    overruled: Scalar
    jerk_mps2: Scalar
    max_jerk_mps3: Scalar
    max_overspeed_mps: Scalar

    @property
    def plant(self) -> State:
        """State of the plant."""
        return self.run.plant

    @property
    def outcome(self) -> Index:
        """Number of the outcome, or ``RUNNING``."""
        return self.run.outcome


class DrivingTask(AbstractTask):
    """Drive a section: on time, with little energy, under protection.

    Args:
        config: Configuration of the task.
    """

    def __init__(self, config: DrivingConfig) -> None:
        self.config = config
        self.rows = SectionRows(config.tables(), jax=True)
        # rows of the cases come first, those of the cases with a restriction after them
        minimum = np.asarray(self.rows.tables.minimum_s, np.float64)[: len(config.cases)]
        low, high = config.scenarios.times_s(minimum)
        self.minimum_s = minimum
        self.times_s = np.stack([low, high]).astype(np.float32)
        period_s, rule = config.dt * config.periods, config.outcomes
        longest_s = rule.late_ratio * float(high.max()) + rule.late_s
        self.most_decisions = config.most_decisions or math.ceil(longest_s / period_s)
        longest = max(config.scenarios.delay_s[1] + t.actuation.delay_s for _, t in config.cases)
        self.pipeline = delay_steps(longest, config.dt) + 1

    @property
    def action_space(self) -> ActionSpace:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Action space."""
        return self.config.action.space

    @property
    def noisy(self) -> bool:
        """True if the speed is measured with noise."""
        return self.config.scenarios.speed_noise_mps[1] > 0.0

    @cached_property
    def observation_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Length of the observation."""
        import jax

        return int(jax.eval_shape(self.reset, jax.random.key(0))[1].shape[0])

    def draw(self, key: Key, case: Index | None = None) -> StartDistribution:
        """Draw the parameters of an episode from the task's distribution; in a case, if one is given."""
        import jax.numpy as jnp

        start = draw(self.config.scenarios, key, jnp.asarray(self.times_s), case)
        return self._on_the_way(key, start) if self.config.scenarios.on_the_way > 0 else start

    def begin(self, start: StartDistribution) -> tuple[DriveState, Float[Array, " features"]]:
        """Begin an episode with given parameters; returns its state and first observation.

        Raises:
            InputError: No such case.
        """
        import jax.numpy as jnp
        from jax.core import Tracer

        if not isinstance(start.case, Tracer):  # in a compiled program it is known too late
            check_number("case", int(start.case), int, Range(0, self.minimum_s.size - 1))
        zero = jnp.zeros((), jnp.float32)
        count, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
        plant = State(
            time_s=start.time_s,
            position_m=start.position_m,
            speed_mps=start.speed_mps,
            acceleration_mps2=zero,
            share=zero,
            pipeline=jnp.zeros((self.pipeline,), jnp.float32),
            emergency_s=zero,
            forces=Forces(zero, zero, zero, zero, zero),
            traction_j=zero,
            electric_brake_j=zero,
            line_j=zero,
            recovered_j=zero,
        )
        recent = jnp.zeros((self.rows.slots,), jnp.float32)
        watched = Memory(recent, zero, zero, no, count, count, count, count)
        state = DriveState(
            start=start,
            run=first_state(plant, watched)._replace(outcome=jnp.full((), RUNNING, jnp.int32)),
            motion=first_motion(start.position_m, start.speed_mps),
            command=zero,
            stopping=no,
            decisions=count,
            overruled=zero,
            jerk_mps2=zero,
            max_jerk_mps3=zero,
            max_overspeed_mps=zero,
        )
        return state, self.observe(state)

    def reset(self, key: Key) -> tuple[DriveState, Float[Array, " features"]]:
        """Begin an episode drawn from the task's distribution."""
        return self.begin(self.draw(key))

    def step(
        self, key: Key, state: DriveState, action: Num[Array, "*actions"]
    ) -> tuple[DriveState, Transition]:
        """Take one decision: map the action, then assist, supervise and step in each control period."""
        return self._traced_parts["step"](key, state, action)

    @cached_property
    def _traced_parts(self) -> Mapping[str, Callable[..., Any]]:
        """Parts that a learner's program holds several times, traced once and inlined elsewhere."""
        import jax

        parts = {"step": self._step, "observe": self._observe}
        return {name: jax.jit(part, inline=True) for name, part in parts.items()}

    def _step(
        self, key: Key, state: DriveState, action: Num[Array, "*actions"]
    ) -> tuple[DriveState, Transition]:
        import jax
        import jax.numpy as jnp

        config = self.config
        wanted = config.action.command(self.context(state), action, config.dt * config.periods)

        def period(carry: tuple[DriveState, Scalar, Scalar], k: Index) -> tuple[Any, None]:
            now, overruled, overspeed = carry
            noise = jax.random.fold_in(key, k) if self.noisy else key
            reached, over, excess = self._period(noise, now, (action, wanted))
            reached = reached, overruled + over, jnp.maximum(overspeed, excess)
            return reached, None

        carry = state, jnp.zeros((), jnp.float32), jnp.zeros((), jnp.float32)
        if config.periods > UNROLLED:
            carry, _ = jax.lax.scan(period, carry, jnp.arange(config.periods, dtype=jnp.uint32))
        else:
            for k in range(config.periods):
                carry, _ = period(carry, k)
        after, overruled, overspeed = carry
        after = after._replace(decisions=state.decisions + 1, overruled=overruled / config.periods)
        plant = after.plant
        error = plant.position_m - self.rows.case(state.start.case).length_m
        terminated = after.outcome != RUNNING
        truncated = (after.decisions >= self.most_decisions) & ~terminated
        change = PeriodChange(
            wheel_j=plant.traction_j - state.plant.traction_j,
            line_j=plant.line_j - state.plant.line_j,
            jerk_mps2=after.jerk_mps2 - state.jerk_mps2,
            seconds=plant.time_s - state.plant.time_s,
            overruled=after.overruled,
            overspeed_mps=overspeed,
            ended=terminated,
            arrived=after.outcome == CODES.index(Outcome.ARRIVED),
            late_s=running_time(after.run) - scheduled_s(after),
            error_m=error,
            braked_j=plant.electric_brake_j - state.plant.electric_brake_j,
            acceleration_mps2=plant.acceleration_mps2,
            before_mps2=state.plant.acceleration_mps2,
            speed_mps=plant.speed_mps,
            command=after.command,
            command_before=state.command,
        )
        terms = {term.name: term.value(change) for term in config.rewards}
        reward = sum(terms.values(), jnp.zeros((), jnp.float32))
        return after, Transition(self.observe(after), reward, terminated, truncated, terms)

    def action_mask(self, state: DriveState) -> Bool[Array, " choices"] | None:
        """Mask of the choices that the action's filter allows. None: all."""
        return self.config.action.action_mask(self.context(state), self.config.dt * self.config.periods)

    def observe(self, state: DriveState) -> Float[Array, " features"]:
        """Observation of a state."""
        return self._traced_parts["observe"](state)

    def _observe(self, state: DriveState) -> Float[Array, " features"]:
        return observe(self.config.features, self.context(state))

    def context(self, state: DriveState) -> FeatureContext:
        """Context of a state, the input of observers and actions."""
        plant, row = state.plant, self.row(state)
        case, assists = self.rows.case(row), self.config.assists
        return feature_context(
            self.rows,
            row,
            case,
            stop_mps2=assists.planned_mps2(self.rows, row, case.stop_mps2, plant.position_m),
            time_s=plant.time_s,
            position_m=plant.position_m,
            # as on the host, where a driver has an estimator if it has the assist
            speed_mps=state.motion.speed_mps if self.noisy and assists.stop else state.run.measured_mps,
            acceleration_mps2=plant.acceleration_mps2,
            scheduled_s=scheduled_s(state),
            command=state.command,
            assists=assists,
        )

    def row(self, state: DriveState) -> Index:
        """Row of the tables in force: the case, or the case with the restriction announced by now."""
        import jax.numpy as jnp

        start = state.start
        if self.config.scenarios.restriction <= 0:
            return start.case
        return jnp.where(state.plant.time_s >= start.restricted_at_s, start.restricted, start.case)

    def _period(
        self, key: Key, state: DriveState, decided: tuple[Num[Array, "*actions"], Scalar]
    ) -> tuple[DriveState, Scalar, Scalar]:
        """Simulate one control period; also returns interventions (0 or 1) and the largest overspeed."""
        import jax
        import jax.numpy as jnp

        config, start, plant = self.config, state.start, state.plant
        dt, row = jnp.float32(config.dt), self.row(state)
        case, context = self.rows.case(row), self.context(state)
        scenarios = config.scenarios
        drawn = {name: getattr(start, name) for name in scenarios.mismatches}
        params = RunParams(
            vehicle=true_vehicle(case.vehicle, **drawn),
            track=context.track,
            protection=near_protection(self.rows, case.protection, row, plant.position_m),
            length_m=case.length_m,
            scheduled_s=scheduled_s(state),
            speed_noise_mps=start.speed_noise_mps if self.noisy else 0.0,
            dt=dt,
        )

        def decide(_: None, __: RunState) -> tuple[Command, tuple[Scalar, Flag]]:
            wanted = config.action.hold(context, *decided)
            command, stopping = apply_assists(config.assists, context, wanted, state.stopping, config.dt)
            command = config.action.round(context, command)
            if config.periods > 1:  # an episode that ends within a decision waits for the next one
                command = jnp.where(state.outcome == RUNNING, command, -jnp.ones_like(command))
            return Command(command, jnp.zeros((), bool)), (command, stopping)

        noise = jax.random.normal(key, (), jnp.float32) if self.noisy else 0.0
        run, (command, stopping), record = control_period(
            params, state.run, None, decide, rule=config.outcomes, noise=noise
        )
        jerk = jnp.abs(run.plant.acceleration_mps2 - plant.acceleration_mps2)
        motion = state.motion
        if self.noisy:
            measured = run.plant.position_m, run.measured_mps, run.plant.acceleration_mps2
            motion = fuse_motion(motion, *measured, dt)
        state = state._replace(
            run=run,
            motion=motion,
            command=command,
            stopping=stopping,
            jerk_mps2=state.jerk_mps2 + jerk,
            max_jerk_mps3=jnp.maximum(state.max_jerk_mps3, jerk / dt),
            max_overspeed_mps=jnp.maximum(state.max_overspeed_mps, record.overspeed_mps),
        )
        return state, record.intervened.astype(jnp.float32), record.overspeed_mps

    def _on_the_way(self, key: Key, start: StartDistribution) -> StartDistribution:
        """Move a share of the starts to a random position, speed and time left on the way."""
        import jax
        import jax.numpy as jnp

        ratio = self.config.scenarios.left_ratio
        shares = jax.random.uniform(jax.random.fold_in(key, 1), (3 if ratio is None else 4,), jnp.float32)
        chance, place, speed = shares[0], shares[1], shares[2]
        length = self.rows.case(start.case).length_m
        position = 0.9 * length * place
        permitted = self.rows.curve_at(PERMITTED_COLUMN, start.case, position)
        stops = jnp.sqrt(2.0 * 0.7 * self.rows.case(start.case).stop_mps2 * (length - position))
        speed = speed * jnp.maximum(jnp.minimum(permitted - 1.0, stops), 0.0)
        to_go = self.rows.to_go_s(start.case, length - position, length, speed)
        whole = jnp.asarray(self.rows.tables.minimum_s)[start.case]
        if ratio is None:
            left = to_go * start.scheduled_s / whole
        else:
            left = to_go * (ratio[0] + (ratio[1] - ratio[0]) * shares[3])
        never = jnp.float32(jnp.inf)  # a restriction could lie too near to brake for
        moved = start._replace(
            position_m=position, speed_mps=speed, time_s=start.scheduled_s - left, restricted_at_s=never
        )
        here = chance < self.config.scenarios.on_the_way
        return jax.tree.map(lambda a, b: jnp.where(here, a, b), moved, start)


def scheduled_s(state: DriveState) -> Scalar:
    """Scheduled running time as announced by now, s."""
    import jax.numpy as jnp

    told = state.plant.time_s >= state.start.news_at_s
    return jnp.where(told, state.start.news_s, state.start.scheduled_s)


def episode_of(task: DrivingTask, state: DriveState) -> Episode:
    """KPIs of an episode so far; batch it with ``jax.vmap`` over the state."""
    plant = state.plant
    return Episode(
        outcome=state.outcome,
        case=state.start.case,
        running_time_s=running_time(state.run),
        scheduled_s=scheduled_s(state),
        wheel_j=plant.traction_j,
        line_j=plant.line_j,
        stop_error_m=plant.position_m - task.rows.case(state.start.case).length_m,
        interventions=cast("Memory", state.run.supervision).interventions,
        max_jerk_mps3=state.max_jerk_mps3,
        jerk_mps2=state.jerk_mps2,
        max_overspeed_mps=state.max_overspeed_mps,
        decisions=state.decisions,
    )


def starts(
    cases: Sequence[int], scheduled_s: Sequence[float], **fields: Sequence[float]
) -> StartDistribution:
    """Starts from standstill for chosen cases and scheduled times, one row each.

    Args:
        cases: Rows in the task's cases.
        scheduled_s: Scheduled running times, s.
        fields: Other fields of :class:`StartDistribution`, one value a row.

    Raises:
        InputError: No such field, or not one value a row.
    """
    import jax.numpy as jnp

    count = len(cases)
    for name in fields:
        check_name(name, StartDistribution._fields[2:], "field", field=name)
    never = float("inf")
    default = {"mass_factor": 1.0, "resistance_factor": 1.0, "adhesion": never, "brake_factor": 1.0}
    default |= {"news_at_s": never, "restricted_at_s": never}
    values = {
        name: jnp.asarray(fields.get(name, [default.get(name, 0.0)] * count), jnp.float32)
        for name in StartDistribution._fields
    }
    values["case"] = jnp.asarray(cases, jnp.int32)
    values["restricted"] = jnp.asarray(fields.get("restricted", cases), jnp.int32)
    values["scheduled_s"] = jnp.asarray(scheduled_s, jnp.float32)
    for name, value in values.items():
        if value.shape != (count,):
            raise InputError(
                "not one value a row", field=name, value=str(value.shape), allowed=f"shape ({count},)"
            )
    return StartDistribution(**values)
