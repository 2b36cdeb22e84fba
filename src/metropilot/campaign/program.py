"""Compiled program of a batch of runs: :func:`metropilot.sim.control_period` with a policy, in JAX, float64.

``vmap`` runs a batch and ``scan`` several periods. All that differs between runs is data, so that one program
serves every section, trainset and disturbance of a campaign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, cast

import numpy as np

from metropilot._typing import Array
from metropilot.control import MeasuredMotion, first_motion, fuse_motion
from metropilot.drivers import DECISION_EARLY_S
from metropilot.env import (
    PERMITTED_COLUMN,
    PolicyInterface,
    SectionRows,
    SectionTables,
    apply_assists,
    feature_context,
    near_protection,
    near_track,
    observe,
)
from metropilot.physics import Command, Forces, Vehicle
from metropilot.policy import Params, PolicySpec, choose_action, network_output
from metropilot.protection import Memory
from metropilot.sim import OutcomeRule, RunParams, RunState, control_period, hold_ended

RULE = OutcomeRule()

PERIODS = 50
"""Control periods between two checks for the end of all runs."""
BROKEN = -2
"""Outcome of a run whose policy returned NaN or infinity."""


class EpisodeParams(NamedTuple):
    """Parameters of one run of a batch. All 0-d except the curves of the vehicle.

    Attributes:
        vehicle: True plant.
        guard: Rows of the tables of protection: at departure, and after the restriction is announced.
            Shape (2,).
        seen: Rows of the tables of the policy, likewise. Shape (2,).
        restricted_at_s: Time at which the restriction is announced (infinite: never).
        restricted_s: Time that it takes at its speed.
        scheduled_s: Scheduled running time.
        news_at_s: Time at which a new running time is announced (infinite: never).
        news_s: New running time.
        speed_noise_mps: Standard deviation of the measured speed.
        slots: Number of commands in the dead time that protection assumes.
        length_m: Distance to the stop.
    """

    vehicle: Vehicle
    guard: Array
    seen: Array
    restricted_at_s: Array
    restricted_s: Array
    scheduled_s: Array
    news_at_s: Array
    news_s: Array
    speed_noise_mps: Array
    slots: Array
    length_m: Array


class DecisionMemory(NamedTuple):
    """Memory of a policy between two control periods. All 0-d except the action.

    Attributes:
        command: Last command of the policy, assists included.
        action: Action of its last decision.
        wanted: Command requested by that action.
        decided: Number of decisions so far.
        stopping: True after station-stop braking has begun.
    """

    command: Array
    action: Array
    wanted: Array
    decided: Array
    stopping: Array


def first_memory(spec: PolicySpec) -> DecisionMemory:
    """Memory of a policy at departure (NumPy)."""
    zero, none = np.float64(0.0), np.int32(0)
    return DecisionMemory(
        zero, none if spec.discrete else np.zeros(spec.actions), zero, none, np.bool_(False)
    )


class EpisodeState(NamedTuple):
    """State of one run of a batch.

    Attributes:
        run: State of the run; its outcome may be ``BROKEN``.
        policy: Memory of the policy.
        motion: Position and speed as estimated a control period ago.
    """

    run: RunState
    policy: DecisionMemory
    motion: MeasuredMotion


class CompiledRow(NamedTuple):
    """Record of one control period: the state at its end, the rest at its beginning or over it."""

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    forces: Forces
    traction_j: Array
    line_j: Array
    recovered_j: Array
    command: Array
    permitted_mps: Array
    overruled: Array
    told: Array
    overspeed_mps: Array
    outcome: Array


@dataclass(frozen=True)
class Kind:
    """Static parameters of a program; everything else is data.

    Attributes:
        spec: Architecture of the policy.
        interface: Features, actions and assists of the policy.
        dt: Control period, s.
        guard_spacing_m: Distance between the nodes of the tables of protection.
    """

    spec: PolicySpec
    interface: PolicyInterface
    dt: float
    guard_spacing_m: float


@cache
def program(kind: Kind) -> Callable[..., tuple[EpisodeState, CompiledRow]]:
    """``PERIODS`` control periods of a batch, compiled.

    The function takes the parameters of the policy, the tables of protection and of the policy, the
    parameters and states of the runs, and the standard normal noise, shape (PERIODS, B); it returns the
    states after the periods and a row for each period, leading axes (PERIODS, B).
    """
    import jax

    def some(
        params: Params,
        tables: tuple[SectionTables, SectionTables],
        given: EpisodeParams,
        going: EpisodeState,
        noise: Array,
    ) -> tuple[EpisodeState, CompiledRow]:
        guard = SectionRows(tables[0], jax=True, spacing_m=kind.guard_spacing_m)
        seen = SectionRows(tables[1], jax=True, spacing_m=kind.interface.spacing_m)

        def all_runs(going: EpisodeState, noise: Array) -> tuple[EpisodeState, CompiledRow]:
            return jax.vmap(lambda a, b, c: period(kind, params, guard, seen, a, b, c))(given, going, noise)

        return jax.lax.scan(all_runs, going, noise)

    # The states are donated: the next call needs only what this one returns.
    return jax.jit(some, donate_argnums=3)


def period(
    kind: Kind,
    params_of_policy: Params,
    guard: SectionRows,
    seen: SectionRows,
    given: EpisodeParams,
    before: EpisodeState,
    noise: Array,
) -> tuple[EpisodeState, CompiledRow]:
    """One control period of one run, with the timetable updates that are due at its beginning."""
    import jax.numpy as jnp

    plant, now = before.run.plant, before.run.plant.time_s
    told = (now >= given.restricted_at_s).astype(jnp.int32)
    place = given.guard[told]
    case = guard.case(place)
    params = RunParams(
        vehicle=given.vehicle,
        track=near_track(case.track, given.vehicle, plant.position_m),
        protection=near_protection(guard, case.protection, place, plant.position_m),
        length_m=given.length_m,
        scheduled_s=jnp.where(now >= given.news_at_s, given.news_s, given.scheduled_s),
        speed_noise_mps=given.speed_noise_mps,
        dt=kind.dt,
        restricted_s=told * given.restricted_s,
    )

    motion = before.motion
    seen_mps = before.run.measured_mps
    if kind.interface.assists.stop:
        # the driver of the host has an estimator where it has the assist
        motion = estimate_motion(before, kind.dt)
        seen_mps = jnp.where(given.speed_noise_mps > 0.0, motion.speed_mps, seen_mps)
    measured = Measurements(now, plant.position_m, seen_mps, plant.acceleration_mps2)

    def decide(memory: DecisionMemory, _: RunState) -> tuple[Command, tuple[DecisionMemory, Array]]:
        memory, broken = decide_by_policy(
            kind, params_of_policy, seen, given.seen[told], measured, params.scheduled_s, memory
        )
        return Command(memory.command, jnp.zeros((), bool)), (memory, broken)

    run, (memory, broken), record = control_period(
        params, before.run, before.policy, decide, rule=RULE, noise=noise
    )
    supervision = cast("Memory", run.supervision)
    older = jnp.arange(supervision.recent.shape[0]) >= given.slots - 1
    recent = jnp.where(older, -1.0, supervision.recent)
    run = run._replace(
        supervision=supervision._replace(recent=recent), outcome=jnp.where(broken, BROKEN, run.outcome)
    )
    going = hold_ended(before.run, EpisodeState(run, memory, motion), before)
    after = run.plant
    row = CompiledRow(
        time_s=after.time_s,
        position_m=after.position_m,
        speed_mps=after.speed_mps,
        acceleration_mps2=after.acceleration_mps2,
        forces=after.forces,
        traction_j=after.traction_j,
        line_j=after.line_j,
        recovered_j=after.recovered_j,
        command=record.command.share,
        permitted_mps=guard.curve_at(PERMITTED_COLUMN, place, plant.position_m),
        overruled=record.intervened,
        told=told,
        overspeed_mps=record.overspeed_mps,
        outcome=going.run.outcome,
    )
    return going, row


class Measurements(NamedTuple):
    """Measurements at the beginning of a control period. All 0-d.

    Attributes:
        time_s: Time since departure.
        position_m: Position of the head.
        speed_mps: Measured speed.
        acceleration_mps2: Acceleration over the last period.
    """

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array


def estimate_motion(state: EpisodeState, dt: float) -> MeasuredMotion:
    """Position and speed as estimated from the measurements at the beginning of a control period (JAX)."""
    import jax
    import jax.numpy as jnp

    plant = state.run.plant
    x, v, begins = plant.position_m, state.run.measured_mps, plant.time_s <= 0.0
    fused = fuse_motion(state.motion, x, v, plant.acceleration_mps2, dt)
    return jax.tree.map(lambda first, later: jnp.where(begins, first, later), first_motion(x, v), fused)


def decide_by_policy(
    kind: Kind,
    params: Params,
    seen: SectionRows,
    row: Array,
    measured: Measurements,
    scheduled_s: Array,
    before: DecisionMemory,
) -> tuple[DecisionMemory, Array]:
    """Take a decision if one is due and apply the assists, in one control period (JAX).

    Args:
        kind: Policy and control period.
        params: Parameters of the policy.
        seen: Tables of the policy.
        row: Their row in force.
        measured: Measurements.
        scheduled_s: Scheduled running time in force.
        before: Memory of the policy.

    Returns:
        Its next memory, command included, and True if the output was not finite.
    """
    import jax.numpy as jnp

    interface, spec = kind.interface, kind.spec
    found = seen.case(row)
    context = feature_context(
        seen,
        row,
        found,
        stop_mps2=interface.assists.planned_mps2(seen, row, found.stop_mps2, measured.position_m),
        **measured._asdict(),
        scheduled_s=scheduled_s,
        command=before.command,
        assists=interface.assists,
    )
    output = network_output(spec, params, observe(interface.features, context), jnp)
    action = choose_action(spec, output, interface.action.action_mask(context, interface.period_s), jnp)
    action = action.astype(before.action.dtype)
    due = context.time_s >= before.decided * interface.period_s - DECISION_EARLY_S
    broken = due & (jnp.all(jnp.isfinite(output)) ^ True)
    count = ((context.time_s + DECISION_EARLY_S) / interface.period_s).astype(jnp.int32) + 1
    wanted = interface.action.command(context, action, interface.period_s)
    action, decided = jnp.where(due, action, before.action), jnp.where(due, count, before.decided)
    wanted = jnp.where(due, wanted.astype(context.speed_mps.dtype), before.wanted)
    command = interface.action.hold(context, action, wanted)
    command, stopping = apply_assists(interface.assists, context, command, before.stopping, kind.dt)
    command = interface.action.round(context, command).astype(context.speed_mps.dtype)
    after = before._replace(command=command, action=action, wanted=wanted, decided=decided, stopping=stopping)
    return after, broken
