"""One control period: decide, supervise, step the plant, determine the outcome; common to all simulations.

The host loop (:mod:`metropilot.sim.rollout`) calls it with NumPy scalars in double precision, the compiled
campaign and the compiled task with JAX arrays, the convoy once for every trainset, simulations inside drivers
and the differentiable rollout of the imitation learner without disturbances. They differ in data alone: the
array type, the grid of protection's curves (or none), the precision.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Flag, Index, Scalar
from metropilot.physics import (
    Command,
    State,
    Track,
    Vehicle,
    control_brakes,
    locate,
    namespace,
    scalars,
    step,
)
from metropilot.protection import Memory, Protection, TrainAhead, Verdict, supervise
from metropilot.sim.disturbance import NOISE_CUT
from metropilot.sim.outcome import RUNNING, OutcomeRule, outcome_of


class RunParams(NamedTuple):
    """Data of one control period; constant over a run except for timetable updates.

    Attributes:
        vehicle: True plant of the trainset.
        track: Section as it acts on the trainset; the pieces around its position suffice.
        protection: Protection of the section; the nodes ahead suffice. None: no protection.
        length_m: Distance from the origin to the stop. 0-d, m.
        scheduled_s: Scheduled running time in force. 0-d, s.
        speed_noise_mps: Standard deviation of the measured speed. 0-d, m/s.
        dt: Control period. 0-d, s.
        most_mps2: Total deceleration that the brakes are controlled to, as in convoys; None: they are not.
            0-d, m/s^2.
        restricted_s: Time that restrictions announced on the way take at their speed. 0-d, s.
    """

    vehicle: Vehicle
    track: Track
    protection: Protection | None
    length_m: Scalar
    scheduled_s: Scalar
    speed_noise_mps: Scalar
    dt: Scalar
    most_mps2: Scalar | None = None
    restricted_s: Scalar = 0.0


class RunState(NamedTuple):
    """State of one run between two control periods. All 0-d but the pipelines of plant and protection.

    Attributes:
        plant: State of the plant.
        supervision: Memory of protection; None: no protection.
        measured_mps: Speed as measured for the coming period, m/s.
        stood_since_s: Time at which the trainset last came to a standstill, s.
        outcome: Number of the outcome, or ``RUNNING``.
    """

    plant: State
    supervision: Memory | None
    measured_mps: Scalar
    stood_since_s: Scalar
    outcome: Index


class PeriodRecord(NamedTuple):
    """Record of one control period. All 0-d.

    Attributes:
        wanted: Command of the driver.
        command: Command after protection.
        verdict: Decision of protection; None: no protection.
        intervened: True where protection changed the command, or the command was not a finite number.
        overspeed_mps: Largest excess over the limit in the period, m/s, never negative.
    """

    wanted: Command
    command: Command
    verdict: Verdict | None
    intervened: Flag
    overspeed_mps: Scalar


Decide = Callable[[Any, RunState], tuple[Command, Any]]
"""A driver in one control period: from its memory and the state of the run to a command and a new memory."""


def first_state(plant: State, supervision: Memory | None) -> RunState:
    """State at the beginning of a run (NumPy constants, also in JAX).

    Args:
        plant: State of the plant.
        supervision: Memory of protection; None: no protection.
    """
    return RunState(plant, supervision, plant.speed_mps, plant.time_s, np.int32(RUNNING))


@no_type_check
def control_period(
    params: RunParams,
    state: RunState,
    memory: Any,  # noqa: ANN401 (a driver's memory)
    decide: Decide,
    *,
    rule: OutcomeRule,
    noise: Scalar = 0.0,
    ahead: TrainAhead | None = None,
) -> tuple[RunState, Any, PeriodRecord]:
    """Simulate one control period of one run. Pure over the array namespace; batch it with ``jax.vmap``.

    A run that has ended keeps its outcome but is stepped like any other; :func:`hold_ended` restores all of
    its state.

    Args:
        params: Data of the period.
        state: State of the run at its beginning.
        memory: Memory of the driver.
        decide: The driver.
        rule: Conditions that end a run.
        noise: Error of the speed measured at the end, in standard deviations, cut at ``NOISE_CUT``. 0-d.
        ahead: Last message of the trainset ahead; None: there is none.

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
        # ``^ True`` negates arrays, tracers and plain bools alike; NaN compares false and so counts.
        intervened = (verdict.level > 0) | (abs(wanted.share) < float("inf")) ^ True
    vehicle, most_n = params.vehicle, None
    if params.most_mps2 is not None:
        vehicle, most_n = control_brakes(vehicle, params.track, plant, params.most_mps2)
    after = step(vehicle, params.track, plant, command, params.dt, most_brake_n=most_n)

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
        restricted_s=params.restricted_s,
    )
    outcome = xp.where(state.outcome == RUNNING, outcome, state.outcome)
    measured = measured_speed(after.speed_mps, params.speed_noise_mps, noise)
    reached = RunState(after, supervision, measured, since, outcome)
    return reached, memory, PeriodRecord(wanted, command, verdict, intervened, overspeed)


@no_type_check
def running_time(state: RunState) -> Scalar:
    """Time from departure to the standstill, or to now while the trainset moves, s."""
    xp = namespace(state.plant.speed_mps)
    return xp.where(state.plant.speed_mps <= 0.0, state.stood_since_s, state.plant.time_s)


def noise_stream(seed: int, member: int = 0) -> np.random.Generator:
    """Random stream of the errors of the measured speeds of a run, one a control period.

    Args:
        seed: Seed of the run.
        member: Number of the trainset in a convoy, 0 for the head.
    """
    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, member)[: 1 + (member > 0)]))
    # the first number belongs to the speed at departure, which odometry measures exactly as zero
    stream.standard_normal()
    return stream


@no_type_check
def measured_speed(speed_mps: Scalar, sigma_mps: Scalar, noise: Scalar) -> Scalar:
    """Speed from odometry: true speed plus a cut normal error, exact at standstill, never negative.

    Args:
        speed_mps: True speed. 0-d, m/s.
        sigma_mps: Standard deviation of the error. 0-d, m/s.
        noise: The error in standard deviations; beyond ``NOISE_CUT`` it is cut. 0-d.
    """
    xp = namespace(speed_mps, sigma_mps, noise)
    error = sigma_mps * xp.clip(noise, -NOISE_CUT, NOISE_CUT)
    return xp.where(speed_mps > 0.0, xp.maximum(speed_mps + error, 0.0), speed_mps)


@no_type_check
def overspeed_in_period(track: Track, before: State, after: State) -> Scalar:
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
    # The excess at the beginning equals that at the end of the period before. If one period crosses several
    # limits, a compiled program evaluates only the last, which keeps its shapes fixed.
    # At standstill both ends coincide; the share is then not used, but may not be NaN.
    share = (breaks[last] - x0) / xp.maximum(x1 - x0, 1e-9)
    speed = xp.sqrt(xp.maximum(v0 * v0 + (v1 * v1 - v0 * v0) * share, 0.0))
    excess = speed - xp.minimum(limits[last], limits[xp.maximum(last - 1, 0)])
    return xp.maximum(worst, xp.where(breaks[last] > x0, excess, 0.0))


def hold_ended(before: RunState, reached: Any, kept: Any = None) -> Any:  # noqa: ANN401 (trees of arrays)
    """State after the period, or (JAX) the one before it where the run had already ended.

    Args:
        before: State of the run before the period.
        reached: State of the run after the period, or a tree that contains it.
        kept: The same tree before the period; None: ``before``.
    """
    import jax
    import jax.numpy as jnp

    over = before.outcome != RUNNING
    return jax.tree.map(lambda old, new: jnp.where(over, old, new), before if kept is None else kept, reached)
