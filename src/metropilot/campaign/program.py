"""The compiled run of a batch: the host loop of :mod:`metropilot.sim.rollout`, in JAX, float64.

One control period of one run is written here over the very functions the host loop calls (plant, protection,
what a policy sees and means); ``vmap`` makes a batch of it and ``scan`` some periods in a row. What differs
between runs is data, so that one program serves every section, trainset and disturbance of a campaign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from metropilot.drivers.learned import EARLY_S
from metropilot.env import PolicyInterface
from metropilot.env.assists import Assists, assisted
from metropilot.env.features import FeatureContext, observe
from metropilot.env.tables import PERMITTED, SectionRows, SectionTables, near_protection, near_track
from metropilot.physics import Command, Forces, State, Vehicle, step
from metropilot.policy.networks import Params
from metropilot.policy.policy import PolicySpec, chosen, network_output
from metropilot.protection import Memory, supervise
from metropilot.sim import CODES, RUNNING, STOP_TOLERANCE_M, Outcome
from metropilot.sim.rollout import GIVE_UP_M, STALLED_S

Array = Any

PERIODS = 50
"""Control periods between two looks at whether all runs have ended."""
BROKEN = -2
"""Outcome of a run whose policy answered what is not a number."""


class EpisodeParams(NamedTuple):
    """What one run of a batch is. All 0-d but the vehicle's curves.

    Attributes:
        vehicle: The trainset as it really is.
        guard: Row of protection's tables: at departure, and after the restriction is announced. Shape (2,).
        seen: Row of the tables the policy sees: the same two. Shape (2,).
        restricted_at_s: When the restriction is announced (infinite: never).
        scheduled_s: Scheduled running time.
        news_at_s: When another one is announced (infinite: never).
        news_s: The other one.
        speed_noise_mps: Standard deviation of the measured speed.
        slots: Commands that protection takes to be on their way.
        length_m: Distance to the stop.
    """

    vehicle: Vehicle
    guard: Array
    seen: Array
    restricted_at_s: Array
    scheduled_s: Array
    news_at_s: Array
    news_s: Array
    speed_noise_mps: Array
    slots: Array
    length_m: Array


class EpisodeState(NamedTuple):
    """Where one run is. All 0-d but the pipelines and the action.

    Attributes:
        plant: State of the plant.
        watched: Protection's memory.
        stood_since_s: When it last came to a stand.
        command: The policy's last command, assists included.
        action: Action of its last decision.
        wanted: Command that asked for.
        decided: Decisions taken.
        stopping: Whether the last braking has begun.
        outcome: Number of the outcome, ``RUNNING`` or ``BROKEN``.
    """

    plant: State
    watched: Memory
    stood_since_s: Array
    command: Array
    action: Array
    wanted: Array
    decided: Array
    stopping: Array
    outcome: Array


class CompiledRow(NamedTuple):
    """What is kept of one control period: the state at its end, the rest at or over it."""

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
    outcome: Array


@dataclass(frozen=True)
class Kind:
    """What a program is compiled for; everything else is data.

    Attributes:
        spec: What the policy's parameters mean.
        perception: What the policy sees and does.
        dt: Control period, s.
        guard_spacing_m: Distance between the nodes of protection's tables.
    """

    spec: PolicySpec
    perception: PolicyInterface
    dt: float
    guard_spacing_m: float


@cache
def program(kind: Kind) -> Callable[..., tuple[EpisodeState, CompiledRow]]:
    """``PERIODS`` control periods of a batch, compiled.

    The function takes the policy's parameters, protection's tables and those the policy sees, the runs,
    where they are, and the noise of each period in deviations, shape (PERIODS, B); it gives where they are
    then, and a row a period, leading axes (PERIODS, B).
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
        seen = SectionRows(tables[1], jax=True, spacing_m=kind.perception.spacing_m)

        def all_runs(going: EpisodeState, noise: Array) -> tuple[EpisodeState, CompiledRow]:
            return jax.vmap(lambda a, b, c: period(kind, params, guard, seen, a, b, c))(given, going, noise)

        return jax.lax.scan(all_runs, going, noise)

    return jax.jit(some, donate_argnums=3)


def period(
    kind: Kind,
    params: Params,
    guard: SectionRows,
    seen: SectionRows,
    given: EpisodeParams,
    before: EpisodeState,
    noise: Array,
) -> tuple[EpisodeState, CompiledRow]:
    """One control period of one run: hear the news, decide, supervise, move, look whether it is over."""
    import jax
    import jax.numpy as jnp

    plant, now = before.plant, before.plant.time_s
    told = (now >= given.restricted_at_s).astype(jnp.int32)
    scheduled = jnp.where(now >= given.news_at_s, given.news_s, given.scheduled_s)
    place = given.guard[told]
    case = guard.case(place)
    noisy = jnp.maximum(plant.speed_mps + given.speed_noise_mps * noise, 0.0)
    noisy = jnp.where(plant.speed_mps > 0.0, noisy, 0.0)
    speed = jnp.where(given.speed_noise_mps > 0.0, noisy, plant.speed_mps)
    sight = _sight(kind.perception.assists, seen, given.seen[told], before, speed, scheduled)
    going, broken = _decided(kind, params, sight, before)

    near = near_protection(guard, case.protection, place, plant.position_m)
    asked = Command(going.command, jnp.zeros((), bool))
    command, watched, verdict = supervise(near, before.watched, plant.position_m, speed, asked)
    older = jnp.arange(watched.recent.shape[0]) >= given.slots - 1
    watched = watched._replace(recent=jnp.where(older, -1.0, watched.recent))
    after = step(
        given.vehicle, near_track(case.track, given.vehicle, plant.position_m), plant, command, kind.dt
    )

    stopped = (plant.speed_mps > 0.0) & (after.speed_mps <= 0.0)
    since = jnp.where(stopped, after.time_s, before.stood_since_s)
    outcome = jnp.where(broken, BROKEN, _outcome(after, since, given.length_m, scheduled))
    going = going._replace(plant=after, watched=watched, stood_since_s=since, outcome=outcome)
    over = before.outcome != RUNNING
    going = jax.tree.map(lambda old, new: jnp.where(over, old, new), before, going)
    row = CompiledRow(
        time_s=after.time_s,
        position_m=after.position_m,
        speed_mps=after.speed_mps,
        acceleration_mps2=after.acceleration_mps2,
        forces=after.forces,
        traction_j=after.traction_j,
        line_j=after.line_j,
        recovered_j=after.recovered_j,
        command=command.share,
        permitted_mps=guard.ground_at(PERMITTED, place, plant.position_m),
        overruled=(verdict.level > 0) | (jnp.abs(asked.share) < jnp.inf) ^ True,
        told=told,
        outcome=going.outcome,
    )
    return going, row


def _sight(
    assists: Assists,
    rows: SectionRows,
    place: Array,
    going: EpisodeState,
    speed_mps: Array,
    scheduled_s: Array,
) -> FeatureContext:
    """What the policy sees; as :class:`metropilot.drivers.learned.LearnedDriver` has it."""
    case, plant = rows.case(place), going.plant
    return FeatureContext(
        rows=rows,
        case=place,
        vehicle=case.vehicle,
        track=near_track(case.track, case.vehicle, plant.position_m),
        length_m=case.length_m,
        load=case.load,
        stop_mps2=assists.planned_mps2(rows, place, case.stop_mps2, plant.position_m),
        rates=case.protection.rates,
        time_s=plant.time_s,
        position_m=plant.position_m,
        speed_mps=speed_mps,
        acceleration_mps2=plant.acceleration_mps2,
        scheduled_s=scheduled_s,
        command=going.command,
    )


def _decided(
    kind: Kind, params: Params, sight: FeatureContext, before: EpisodeState
) -> tuple[EpisodeState, Array]:
    """The policy's decision if it is due, what the assists make of it, and whether it was no number."""
    import jax.numpy as jnp

    perception, spec = kind.perception, kind.spec
    output = network_output(spec, params, observe(perception.features, sight), jnp)
    action = chosen(spec, output, perception.action.allowed(sight, perception.period_s), jnp)
    action = action.astype(before.action.dtype)
    due = sight.time_s >= before.decided * perception.period_s - EARLY_S
    broken = due & (jnp.all(jnp.isfinite(output)) ^ True)
    count = ((sight.time_s + EARLY_S) / perception.period_s).astype(jnp.int32) + 1
    wanted = perception.action.command(sight, action, perception.period_s)
    action, decided = jnp.where(due, action, before.action), jnp.where(due, count, before.decided)
    wanted = jnp.where(due, wanted.astype(sight.speed_mps.dtype), before.wanted)
    command = perception.action.held(sight, action, wanted)
    command, stopping = assisted(perception.assists, sight, command, before.stopping, kind.dt)
    command = perception.action.settled(sight, command).astype(sight.speed_mps.dtype)
    after = before._replace(command=command, action=action, wanted=wanted, decided=decided, stopping=stopping)
    return after, broken


def _outcome(plant: State, stood_since_s: Array, length_m: Array, scheduled_s: Array) -> Array:
    """How a run has ended, if it has; as :meth:`metropilot.sim.rollout.Rollout.advance` has it."""
    import jax.numpy as jnp

    error, now = plant.position_m - length_m, plant.time_s
    codes = {outcome: CODES.index(outcome) for outcome in Outcome}
    late = now > 2.0 * scheduled_s + 120.0
    found = jnp.where(late, codes[Outcome.OUT_OF_TIME], RUNNING)
    found = jnp.where(error > GIVE_UP_M, codes[Outcome.OVERSHOT], found)
    stalled = jnp.where(now - stood_since_s > STALLED_S, codes[Outcome.STALLED], found)
    stands = jnp.where(error > 0.0, codes[Outcome.OVERSHOT], stalled)
    stands = jnp.where(jnp.abs(error) <= STOP_TOLERANCE_M, codes[Outcome.ARRIVED], stands)
    return jnp.where(plant.speed_mps <= 0.0, stands, found).astype(jnp.int32)
