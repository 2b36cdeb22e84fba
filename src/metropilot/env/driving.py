"""The driving problem as a functional, compiled environment: the plant under protection, from parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from metropilot.env.assists import assisted
from metropilot.env.config import DrivingConfig
from metropilot.env.features import FeatureContext, observe
from metropilot.env.interface import AbstractTask, ActionSpace, Transition
from metropilot.env.randomization import StartDistribution, draw
from metropilot.env.rewards import Change
from metropilot.env.tables import PERMITTED, SectionRows, SectionTables, near_protection, near_track
from metropilot.physics import Command, Forces, State, Vehicle, delay_steps, step
from metropilot.physics.arrays import locate
from metropilot.protection import Memory, supervise
from metropilot.sim.disturbance import NOISE_CUT
from metropilot.sim.outcome import CODES, RUNNING, Episode, OutcomeFacts, outcome_of
from metropilot.sim.run import Outcome

Array = Any

UNROLLED = 2
"""More control periods to a decision than this are a loop: unrolled, each would be compiled again."""


class DriveState(NamedTuple):
    """Where an episode is. All 0-d but the pipelines of plant and protection.

    Attributes:
        start: How it began.
        plant: State of the plant.
        watched: Protection's memory.
        seen_mps: Speed as last measured.
        command: Last command of the driver, assists included.
        stopping: Whether the stop assist has begun the last braking.
        stood_s: How long the trainset has stood.
        decisions: Decisions taken.
        overruled: Share of the last decision's periods in which protection overruled the command.
        jerk_mps2: Integral of the size of the jerk.
        max_jerk_mps3: Largest jerk.
        max_overspeed_mps: Largest excess over the limit.
        outcome: Number of the outcome, or ``RUNNING``.
    """

    start: StartDistribution
    plant: State
    watched: Memory
    seen_mps: Array
    command: Array
    stopping: Array
    stood_s: Array
    decisions: Array
    overruled: Array
    jerk_mps2: Array
    max_jerk_mps3: Array
    max_overspeed_mps: Array
    outcome: Array


class DrivingTask(AbstractTask):
    """Drive a section: on time, with little energy, under protection.

    Args:
        config: What it is made of.
    """

    def __init__(self, config: DrivingConfig) -> None:
        self.config = config
        self.rows = SectionRows(config.tables(), jax=True)
        minimum = np.asarray(self.rows.tables.minimum_s, np.float64)
        low, high = config.scenarios.times_s(minimum)
        self.minimum_s = minimum
        self.times_s = np.stack([low, high]).astype(np.float32)
        longest = max(config.scenarios.delay_s[1] + t.actuation.delay_s for _, t in config.cases)
        self.pipeline = delay_steps(longest, config.dt) + 1

    @property
    def action_space(self) -> ActionSpace:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What an action is."""
        return self.config.action.space

    @cached_property
    def observation_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Length of the observation."""
        import jax

        return int(jax.eval_shape(self.reset, jax.random.key(0))[1].shape[0])

    def draw(self, key: Array) -> StartDistribution:
        """How an episode begins, drawn from the task's scenarios."""
        import jax.numpy as jnp

        start = draw(self.config.scenarios, key, jnp.asarray(self.times_s))
        return self._on_the_way(key, start) if self.config.scenarios.on_the_way > 0 else start

    def begin(self, start: StartDistribution) -> tuple[DriveState, Array]:
        """An episode that begins as told: its state and first observation."""
        import jax.numpy as jnp

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
            plant=plant,
            watched=watched,
            seen_mps=start.speed_mps,
            command=zero,
            stopping=no,
            stood_s=zero,
            decisions=count,
            overruled=zero,
            jerk_mps2=zero,
            max_jerk_mps3=zero,
            max_overspeed_mps=zero,
            outcome=jnp.full((), RUNNING, jnp.int32),
        )
        return state, self.observe(state)

    def reset(self, key: Array) -> tuple[DriveState, Array]:
        """A new episode drawn from the task's scenarios."""
        return self.begin(self.draw(key))

    def step(self, key: Array, state: DriveState, action: Array) -> tuple[DriveState, Transition]:
        """One decision: map the action, then assist, supervise and move, once in each control period."""
        return self._traced_once["step"](key, state, action)

    @cached_property
    def _traced_once(self) -> Mapping[str, Callable[..., Any]]:
        """What a learner's program holds several times: traced for the first, put in place for the others."""
        import jax

        parts = {"step": self._step, "observe": self._observe}
        return {name: jax.jit(part, inline=True) for name, part in parts.items()}

    def _step(self, key: Array, state: DriveState, action: Array) -> tuple[DriveState, Transition]:
        import jax
        import jax.numpy as jnp

        config = self.config
        case = self.rows.case(state.start.case)
        sight = self.sight(state, case)
        wanted = config.action.command(sight, action, config.dt * config.periods)

        def period(carry: tuple[DriveState, Array, Array], k: Array) -> tuple[Any, None]:
            now, overruled, overspeed = carry
            noise = jax.random.fold_in(key, k) if config.scenarios.speed_noise_mps[1] > 0 else key
            now, over, excess = self._period(noise, now, case, (action, wanted))
            return (now, overruled + over, jnp.maximum(overspeed, excess)), None

        carry = state, jnp.zeros((), jnp.float32), jnp.zeros((), jnp.float32)
        if config.periods > UNROLLED:
            carry, _ = jax.lax.scan(period, carry, jnp.arange(config.periods, dtype=jnp.uint32))
        else:
            for k in range(config.periods):
                carry, _ = period(carry, k)
        after, overruled, overspeed = carry
        after = after._replace(decisions=state.decisions + 1, overruled=overruled / config.periods)
        plant = after.plant
        error = plant.position_m - case.length_m
        facts = OutcomeFacts(
            error, plant.speed_mps, plant.time_s, after.stood_s, scheduled_s(after), overspeed
        )
        after = after._replace(outcome=outcome_of(config.outcomes, facts))
        terminated = after.outcome != RUNNING
        truncated = (after.decisions >= config.most_decisions) & ~terminated
        change = Change(
            wheel_j=plant.traction_j - state.plant.traction_j,
            line_j=plant.line_j - state.plant.line_j,
            jerk_mps2=after.jerk_mps2 - state.jerk_mps2,
            seconds=plant.time_s - state.plant.time_s,
            overruled=after.overruled,
            overspeed_mps=overspeed,
            ended=terminated,
            arrived=after.outcome == CODES.index(Outcome.ARRIVED),
            late_s=plant.time_s - after.stood_s - scheduled_s(after),
            error_m=error,
            braked_j=plant.electric_brake_j - state.plant.electric_brake_j,
            acceleration_mps2=plant.acceleration_mps2,
            before_mps2=state.plant.acceleration_mps2,
            speed_mps=plant.speed_mps,
        )
        terms = {term.name: term.value(change) for term in config.rewards}
        reward = sum(terms.values(), jnp.zeros((), jnp.float32))
        return after, Transition(self.observe(after), reward, terminated, truncated, terms)

    def allowed(self, state: DriveState) -> Array | None:
        """Choices the action's filter allows in this state. Shape (count,), or None: all."""
        case = self.rows.case(state.start.case)
        return self.config.action.allowed(self.sight(state, case), self.config.dt * self.config.periods)

    def observe(self, state: DriveState) -> Array:
        """The observation of a state. Shape (O,)."""
        return self._traced_once["observe"](state)

    def _observe(self, state: DriveState) -> Array:
        return observe(self.config.features, self.sight(state, self.rows.case(state.start.case)))

    def sight(self, state: DriveState, case: SectionTables) -> FeatureContext:
        """What observers and actions may use of a state."""
        plant = state.plant
        return FeatureContext(
            rows=self.rows,
            case=state.start.case,
            vehicle=case.vehicle,
            track=near_track(case.track, case.vehicle, plant.position_m),
            length_m=case.length_m,
            load=case.load,
            stop_mps2=self.config.assists.planned_mps2(
                self.rows, state.start.case, case.stop_mps2, plant.position_m
            ),
            rates=case.protection.rates,
            time_s=plant.time_s,
            position_m=plant.position_m,
            speed_mps=state.seen_mps,
            acceleration_mps2=plant.acceleration_mps2,
            scheduled_s=scheduled_s(state),
            command=state.command,
        )

    def _period(
        self, key: Array, state: DriveState, case: SectionTables, decided: tuple[Array, Array]
    ) -> tuple[DriveState, Array, Array]:
        """One control period; also whether protection overruled the command, and the largest overspeed."""
        import jax.numpy as jnp

        config, plant, start = self.config, state.plant, state.start
        dt = jnp.float32(config.dt)
        sight = self.sight(state, case)
        wanted = config.action.held(sight, *decided)
        command, stopping = assisted(config.assists, sight, wanted, state.stopping, config.dt)
        command = config.action.settled(sight, command)
        near = near_protection(self.rows, case.protection, start.case, plant.position_m)
        given = Command(command, jnp.zeros((), bool))
        given, watched, verdict = supervise(near, state.watched, plant.position_m, state.seen_mps, given)
        actual = self._actual(case.vehicle, start)
        after = step(actual, sight.track, plant, given, dt)
        jerk = jnp.abs(after.acceleration_mps2 - plant.acceleration_mps2)
        stands = after.speed_mps <= 0.0
        excess = jnp.maximum(after.speed_mps - limit_at(case, after.position_m), 0.0)
        state = state._replace(
            plant=after,
            watched=watched,
            seen_mps=self._measured(key, after.speed_mps, start.speed_noise_mps),
            command=command,
            stopping=stopping,
            stood_s=jnp.where(stands & (plant.speed_mps <= 0.0), state.stood_s + dt, 0.0),
            jerk_mps2=state.jerk_mps2 + jerk,
            max_jerk_mps3=jnp.maximum(state.max_jerk_mps3, jerk / dt),
            max_overspeed_mps=jnp.maximum(state.max_overspeed_mps, excess),
        )
        return state, (verdict.level > 0).astype(jnp.float32), excess

    def _measured(self, key: Array, speed_mps: Array, sigma_mps: Array) -> Array:
        """The speed as measured: normal noise cut at three deviations, none at a stand."""
        import jax
        import jax.numpy as jnp

        if self.config.scenarios.speed_noise_mps[1] <= 0:
            return speed_mps
        noise = jnp.clip(jax.random.normal(key, (), jnp.float32), -NOISE_CUT, NOISE_CUT)
        return jnp.where(speed_mps > 0.0, jnp.maximum(speed_mps + sigma_mps * noise, 0.0), 0.0)

    def _actual(self, vehicle: Vehicle, start: StartDistribution) -> Vehicle:
        """The trainset as it really is in this episode; see :meth:`metropilot.sim.Disturbance.true_plant`."""
        scenarios = self.config.scenarios
        if scenarios.mass_factor != (1.0, 1.0):
            m = start.mass_factor
            vehicle = vehicle._replace(
                mass_kg=vehicle.mass_kg * m,
                effective_mass_kg=vehicle.effective_mass_kg * m,
                service_n=vehicle.service_n * m,
                emergency_n=vehicle.emergency_n * m,
                adhesion_n=vehicle.adhesion_n * m,
            )
        if scenarios.resistance_factor != (1.0, 1.0):
            vehicle = vehicle._replace(davis_n=vehicle.davis_n * start.resistance_factor)
        if scenarios.delay_s[1] > 0:
            vehicle = vehicle._replace(delay_s=vehicle.delay_s + start.delay_s)
        if scenarios.lag_s[1] > 0:
            vehicle = vehicle._replace(lag_s=vehicle.lag_s + start.lag_s)
        return vehicle

    def _on_the_way(self, key: Array, start: StartDistribution) -> StartDistribution:
        """Move some starts to a random place, speed and time left on the way."""
        import jax
        import jax.numpy as jnp

        ratio = self.config.scenarios.left_ratio
        shares = jax.random.uniform(jax.random.fold_in(key, 1), (3 if ratio is None else 4,), jnp.float32)
        chance, place, speed = shares[0], shares[1], shares[2]
        length = self.rows.case(start.case).length_m
        position = 0.9 * length * place
        permitted = self.rows.ground_at(PERMITTED, start.case, position)
        stops = jnp.sqrt(2.0 * 0.7 * self.rows.case(start.case).stop_mps2 * (length - position))
        speed = speed * jnp.maximum(jnp.minimum(permitted - 1.0, stops), 0.0)
        to_go = self.rows.to_go_s(start.case, length - position, length, speed)
        whole = jnp.asarray(self.rows.tables.minimum_s)[start.case]
        if ratio is None:
            left = to_go * start.scheduled_s / whole
        else:
            left = to_go * (ratio[0] + (ratio[1] - ratio[0]) * shares[3])
        moved = start._replace(position_m=position, speed_mps=speed, time_s=start.scheduled_s - left)
        here = chance < self.config.scenarios.on_the_way
        return jax.tree.map(lambda a, b: jnp.where(here, a, b), moved, start)


def scheduled_s(state: DriveState) -> Array:
    """Scheduled running time as announced by now, s."""
    import jax.numpy as jnp

    told = state.plant.time_s >= state.start.news_at_s
    return jnp.where(told, state.start.news_s, state.start.scheduled_s)


def limit_at(case: SectionTables, position_m: Array) -> Array:
    """Speed limit of the head, m/s."""
    return case.track.limit_mps[locate(case.track.limit_from_m, position_m)]


def episode_of(task: DrivingTask, state: DriveState) -> Episode:
    """KPIs of an episode so far; batch it with ``jax.vmap`` over the state."""
    plant = state.plant
    return Episode(
        outcome=state.outcome,
        case=state.start.case,
        running_time_s=plant.time_s - state.stood_s,
        scheduled_s=scheduled_s(state),
        wheel_j=plant.traction_j,
        line_j=plant.line_j,
        stop_error_m=plant.position_m - task.rows.case(state.start.case).length_m,
        interventions=state.watched.interventions,
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
        cases: Row of each in the task's cases.
        scheduled_s: Scheduled time of each.
        fields: Other fields of :class:`StartDistribution`, one value a row.
    """
    import jax.numpy as jnp

    count = len(cases)
    default = {"mass_factor": 1.0, "resistance_factor": 1.0, "news_at_s": float("inf")}
    values = {
        name: jnp.asarray(fields.get(name, [default.get(name, 0.0)] * count), jnp.float32)
        for name in StartDistribution._fields
    }
    values["case"] = jnp.asarray(cases, jnp.int32)
    values["scheduled_s"] = jnp.asarray(scheduled_s, jnp.float32)
    return StartDistribution(**values)
