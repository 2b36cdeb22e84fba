"""One control period: decide, supervise, move, judge. Every engine of metropilot steps through this function.

The host loop (:mod:`metropilot.sim.rollout`) calls it with NumPy scalars in double precision, the compiled
campaign and the compiled task with JAX arrays, the convoy once for every trainset, simulations inside drivers
and the differentiable rollout of the imitation learner without protection's disturbances. What differs
between them is data: the array type, the grid of protection's curves (or none), the precision.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, no_type_check

import numpy as np

from metropilot.physics import (
    Command,
    State,
    Track,
    Vehicle,
    limit_deceleration,
    locate,
    namespace,
    scalars,
    step,
)
from metropilot.protection import Memory, Protection, TrainAhead, Verdict, supervise
from metropilot.sim.disturbance import NOISE_CUT
from metropilot.sim.outcome import RUNNING, OutcomeRule, outcome_of
from metropilot.sim.run import Run

Array = Any


class RunParams(NamedTuple):
    """The data of one control period; constant over a run but for what is announced on the way.

    Attributes:
        vehicle: True plant of the trainset.
        track: Section as the trainset feels it; the pieces around its position suffice.
        protection: Protection of the section; the nodes ahead suffice. None: no protection.
        length_m: Distance from the origin to the stop. 0-d, m.
        scheduled_s: Scheduled running time in force. 0-d, s.
        speed_noise_mps: Standard deviation of the measured speed. 0-d, m/s.
        dt: Control period. 0-d, s.
        most_mps2: Total deceleration that the brakes are controlled to, as in convoys; None: they are not.
            0-d, m/s^2.
    """

    vehicle: Vehicle
    track: Track
    protection: Protection | None
    length_m: Array
    scheduled_s: Array
    speed_noise_mps: Array
    dt: Array
    most_mps2: Array | None = None


class RunState(NamedTuple):
    """State of one run between two control periods. All 0-d but the pipelines of plant and protection.

    Attributes:
        plant: State of the plant.
        supervision: Memory of protection; None: no protection.
        measured_mps: Speed as measured for the coming period, m/s.
        stood_since_s: Time of the last standstill, s.
        outcome: Number of the outcome, or ``RUNNING``.
    """

    plant: State
    supervision: Memory | None
    measured_mps: Array
    stood_since_s: Array
    outcome: Array


class PeriodRecord(NamedTuple):
    """One control period as it was. All 0-d.

    Attributes:
        wanted: Command of the driver.
        command: Command that reached the trainset.
        verdict: Decision of protection; None: no protection.
        intervened: Whether protection changed the command, or the command was not a finite number.
        overspeed_mps: Largest excess over the limit in the period, m/s, never negative.
    """

    wanted: Command
    command: Command
    verdict: Verdict | None
    intervened: Array
    overspeed_mps: Array


Decide = Callable[[Any, RunState], tuple[Command, Any]]
"""A driver in one control period: from its memory and the state of the run to a command and a new memory."""


def first_state(plant: State, supervision: Memory | None) -> RunState:
    """The state in which a run begins (NumPy constants, also in JAX).

    Args:
        plant: State of the plant.
        supervision: Memory of protection; None: no protection.
    """
    return RunState(plant, supervision, plant.speed_mps, plant.time_s, np.int32(RUNNING))


@no_type_check
def control_period(
    params: RunParams,
    state: RunState,
    memory: Any,  # noqa: ANN401 (whatever the driver keeps)
    decide: Decide,
    *,
    rule: OutcomeRule,
    noise: Array = 0.0,
    ahead: TrainAhead | None = None,
) -> tuple[RunState, Any, PeriodRecord]:
    """One control period of one run. Pure over the array namespace; batch it with ``jax.vmap``.

    A run that has ended keeps its outcome but is stepped like any other; :func:`hold_ended` keeps all of it.

    Args:
        params: Data of the period.
        state: State of the run at its beginning.
        memory: Memory of the driver.
        decide: The driver.
        rule: Conditions that end a run.
        noise: Error of the speed measured at the end, in standard deviations, cut at ``NOISE_CUT``. 0-d.
        ahead: The trainset ahead as last heard of, if there is one.

    Returns:
        The state at the end, the driver's new memory, and a record of the period.
    """
    plant = state.plant
    wanted, memory = decide(memory, state)
    command, supervision, verdict = wanted, state.supervision, None
    intervened = False
    if params.protection is not None:
        command, supervision, verdict = supervise(
            params.protection, supervision, plant.position_m, state.measured_mps, wanted, ahead
        )
        intervened = (verdict.level > 0) | (abs(wanted.share) < float("inf")) ^ True
    vehicle, applied = params.vehicle, command
    if params.most_mps2 is not None:
        vehicle, applied = limit_deceleration(vehicle, params.track, plant, command, params.most_mps2)
    after = step(vehicle, params.track, plant, applied, params.dt)

    xp = namespace(after.speed_mps)
    stopped = (plant.speed_mps > 0.0) & (after.speed_mps <= 0.0)
    since = xp.where(stopped, after.time_s, state.stood_since_s)
    overspeed = overspeed_in_period(params.track, plant, after)
    outcome = outcome_of(
        rule,
        error_m=after.position_m - params.length_m,
        speed_mps=after.speed_mps,
        time_s=after.time_s,
        stood_since_s=since,
        scheduled_s=params.scheduled_s,
        overspeed_mps=overspeed,
    )
    outcome = xp.where(state.outcome == RUNNING, outcome, state.outcome)
    measured = measured_speed(after.speed_mps, params.speed_noise_mps, noise)
    reached = RunState(after, supervision, measured, since, outcome)
    return reached, memory, PeriodRecord(wanted, command, verdict, intervened, overspeed)


@no_type_check
def running_time(state: RunState) -> Array:
    """Time from departure to the standstill, or to now where the trainset moves, s."""
    xp = namespace(state.plant.speed_mps)
    return xp.where(state.plant.speed_mps <= 0.0, state.stood_since_s, state.plant.time_s)


def noise_stream(run: Run) -> np.random.Generator:
    """Errors of a run's measured speeds in standard deviations, one a control period, from its seed.

    The first would be that of the speed at departure, which odometry knows to be zero.
    """
    stream = np.random.default_rng(np.random.SeedSequence(run.seed, spawn_key=(1,)))
    stream.standard_normal()
    return stream


@no_type_check
def measured_speed(speed_mps: Array, sigma_mps: Array, noise: Array) -> Array:
    """Speed as odometry reports it: true speed and a cut normal error, exact at standstill, never negative.

    Args:
        speed_mps: True speed. 0-d, m/s.
        sigma_mps: Standard deviation of the error. 0-d, m/s.
        noise: The error in standard deviations; beyond ``NOISE_CUT`` it is cut. 0-d.
    """
    xp = namespace(speed_mps, sigma_mps, noise)
    error = sigma_mps * xp.clip(noise, -NOISE_CUT, NOISE_CUT)
    return xp.where(speed_mps > 0.0, xp.maximum(speed_mps + error, 0.0), speed_mps)


@no_type_check
def overspeed_in_period(track: Track, before: State, after: State) -> Array:
    """Largest excess over the limit within one control period, m/s, never negative.

    Speed squared is linear in distance over a period, so the excess is largest at an end of the period or
    where a lower limit begins; there the speed is ``sqrt(v^2 + 2 a (s - s_0))``.

    Args:
        track: The section; its limits whole.
        before: State at the beginning of the period.
        after: State at its end.
    """
    x0, x1, v0, v1 = before.position_m, after.position_m, before.speed_mps, after.speed_mps
    xp = namespace(x1, v1)
    breaks, limits = track.limit_from_m, track.limit_mps
    last = locate(breaks, x1)
    worst = xp.maximum(v1 - limits[last], 0.0)
    if xp is scalars:
        first = locate(breaks, x0)
        worst = max(worst, v0 - limits[first])
        for k in range(first + 1, last + 1):
            speed = max(v0 * v0 + (v1 * v1 - v0 * v0) * (breaks[k] - x0) / (x1 - x0), 0.0) ** 0.5
            worst = max(worst, speed - min(limits[k], limits[k - 1]))
        return worst
    # The excess at the beginning was that at the end of the period before; of limits so near to each other
    # that one period crosses several, a compiled program looks at the last.
    share = (breaks[last] - x0) / xp.maximum(x1 - x0, 1e-9)
    speed = xp.sqrt(xp.maximum(v0 * v0 + (v1 * v1 - v0 * v0) * share, 0.0))
    excess = speed - xp.minimum(limits[last], limits[xp.maximum(last - 1, 0)])
    return xp.maximum(worst, xp.where(breaks[last] > x0, excess, 0.0))


def hold_ended(before: RunState, reached: Any, kept: Any = None) -> Any:  # noqa: ANN401 (trees of arrays)
    """The state reached, or (JAX) the one before where the run had already ended.

    Args:
        before: State of the run before the period.
        reached: Whatever the period led to: a state of the run, or a tree that contains it.
        kept: The same tree before the period; None: ``before``.
    """
    import jax
    import jax.numpy as jnp

    over = before.outcome != RUNNING
    return jax.tree.map(lambda old, new: jnp.where(over, old, new), before if kept is None else kept, reached)
