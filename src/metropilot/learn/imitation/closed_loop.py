"""Differentiable rollout of a policy on many sections at once, and learning by its gradient.

The control period is that of every other engine (:func:`metropilot.sim.control_period`), with the features,
the action and the ceiling of the driving task, but as long as a decision and without protection, whose
permitted speed the ceiling keeps; the station stop is counted in closed form from where it begins. Gradients
of energy and arrival time reach the policy through the whole drive, so that no reward has to be explored; the
policy that comes out is judged in the real task. A gradient step lowers the cost of many drives above the
optimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray
from numpy.random import Generator

from metropilot import control, env, sim
from metropilot._typing import Array, Flag, Float, Index, Int, Scalar, Shaped
from metropilot.learn.config import TeacherConfig
from metropilot.learn.imitation.demonstrations import Demonstrations
from metropilot.learn.imitation.train_state import TrainState, apply_gradient, imitation_loss, labels
from metropilot.physics import Command, at_rest, to_jax
from metropilot.policy import Params, PolicySpec, network_output

Decide = Callable[[Params, Float[Array, " features"]], Float[Array, "1"]]
"""From parameters and an observation to an action."""

LEAK = 0.3
"""Slope that the dead zone and the saturated ends of the action have for the gradient."""
SLOWEST_MPS = 0.3
LEAST_STOP_MPS = 0.1
"""Least speed that a station stop is counted from: keeps its gradient bounded."""


class Begin(NamedTuple):
    """Start of a drive and the optimum it is compared with. All 0-d, or one entry a drive.

    Attributes:
        case: Row of the section.
        position_m: Initial position.
        speed_mps: Initial speed.
        time_s: Time already used.
        scheduled_s: Scheduled running time.
        arrival_s: Arrival of the optimal plan from here: the scheduled time, or the first possible.
        optimum_j: Energy of that plan from here, per kilogram.
        second_w: Marginal price of that plan's time, per kilogram.
        mass_factor: True over believed mass.
        resistance_factor: True over believed resistance.
    """

    case: Index
    position_m: Scalar
    speed_mps: Scalar
    time_s: Scalar
    scheduled_s: Scalar
    arrival_s: Scalar
    optimum_j: Scalar
    second_w: Scalar
    mass_factor: Scalar
    resistance_factor: Scalar


class ClosedLoopRollout(NamedTuple):
    """Result of a drive. All 0-d, or one entry a drive.

    Attributes:
        energy_j: Traction energy, per kilogram.
        late_s: Arrival minus the optimal plan's.
        done: True once the station-stop braking was reached.
    """

    energy_j: Scalar
    late_s: Scalar
    done: Flag


class _Moving(NamedTuple):
    """State of a drive that has not begun its station stop. All 0-d but the pipeline of the plant."""

    run: sim.RunState
    energy_j: Scalar
    arrival_s: Scalar
    done: Flag


WORTH = MappingProxyType(
    {
        "time_s": 50.0,
        "position_m": 4.0,
        "speed_mps": 90.0,
        "measured_mps": 90.0,
        "acceleration_mps2": 45.0,
        "share": 45.0,
        "pipeline": 45.0,
        "energy_j": 1.5,
        "arrival_s": 50.0,
    }
)
"""Largest worth of a unit of each, J/kg: a metre is worth no more than the largest effort, a
metre per second no more than the kinetic energy it adds, a second a few times its price. Nothing flows back
through the other fields: they are accounts that the next period does not depend on."""


@jax.custom_vjp
def within_worth(now: _Moving, joule: Scalar) -> _Moving:
    """The state as it is; what flows back through it is kept within ``WORTH``.

    On the best drive the worth of speed, place and time is bounded by physics; a policy that switches to and
    fro multiplies its gradient at every switch and would drown that of all other drives.

    Args:
        now: The state.
        joule: Weight of a joule per kilogram in the loss.
    """
    del joule
    return now


def _forth(now: _Moving, joule: Scalar) -> tuple[_Moving, Scalar]:
    return now, joule


def _back(joule: Scalar, worth: _Moving) -> tuple[_Moving, Scalar]:
    def clip_worth(path: tuple[Any, ...], value: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
        if value.dtype == jax.dtypes.float0:
            return value
        most = WORTH.get(path[-1].name, 0.0) * joule
        return jnp.clip(jnp.nan_to_num(value, posinf=0.0, neginf=0.0), -most, most)

    return jax.tree_util.tree_map_with_path(clip_worth, worth), jnp.zeros_like(joule)


within_worth.defvjp(_forth, _back)


@dataclass(frozen=True)
class ClosedLoop:
    """Drives on a set of sections.

    Attributes:
        rows: Their tables.
        features: Features the policy sees.
        action: Meaning of the policy's action.
        assists: Assists to the policy.
        period_s: Time between two decisions.
    """

    rows: env.SectionRows
    features: tuple[str, ...]
    action: env.RegimeAction
    assists: env.Assists
    period_s: float

    def drive(
        self, decide: Decide, params: Params, begin: Begin, decisions: int, joule: Scalar
    ) -> ClosedLoopRollout:
        """One drive; ``vmap`` it over ``begin``.

        Args:
            decide: The policy.
            params: Its parameters.
            begin: Start of the drive.
            decisions: Largest number of decisions.
            joule: Weight of a joule per kilogram in the loss.
        """
        zero, case = jnp.zeros((), jnp.float32), self.rows.case(begin.case)
        plant = to_jax(at_rest(self.rows.tables.vehicle))
        plant = plant._replace(position_m=begin.position_m, speed_mps=begin.speed_mps, time_s=begin.time_s)
        run = sim.first_state(plant, None)._replace(outcome=jnp.full((), sim.RUNNING, jnp.int32))
        moving = _Moving(run, zero, zero, jnp.zeros((), bool))

        @jax.checkpoint
        def one(now: _Moving, _: None) -> tuple[_Moving, None]:
            now = within_worth(now, joule)
            # the unused step of a drive that is done begins at its start: at the stop slopes are infinite
            still = jax.tree.map(lambda first, old: jnp.where(now.done, first, old), moving, now)
            after = self._step(decide, params, begin, case, still)
            return jax.tree.map(lambda old, new: jnp.where(now.done, old, new), now, after), None

        last, _ = jax.lax.scan(one, moving, None, length=decisions)
        return ClosedLoopRollout(last.energy_j, last.arrival_s - begin.arrival_s, last.done)

    def _step(
        self, decide: Decide, params: Params, begin: Begin, case: env.SectionTables, now: _Moving
    ) -> _Moving:
        """One control period as long as a decision, on the plant itself, under the ceiling of the assists."""
        dt, vehicle, plant = self.period_s, case.vehicle, now.run.plant
        # limited to what is needed, an action would have no slope, and nothing be learned from it
        free = replace(self.action, needed=False)
        at = plant.position_m
        context = env.feature_context(
            self.rows,
            begin.case,
            case,
            stop_mps2=self._stop_deceleration(begin, case, at),
            time_s=plant.time_s,
            position_m=at,
            speed_mps=plant.speed_mps,
            acceleration_mps2=plant.acceleration_mps2,
            scheduled_s=begin.scheduled_s,
            command=jnp.zeros((), jnp.float32),
            assists=self.assists,
        )

        def choose(_: None, __: sim.RunState) -> tuple[Command, None]:
            action = decide(params, env.observe(self.features, context))
            soft = jnp.clip(action[0], -1.0, 1.0)
            command = free.command(context, action, dt) + LEAK * (soft - jax.lax.stop_gradient(soft))
            # the station stop is counted in closed form below
            under = replace(self.assists, stop=False)
            command, _ = env.apply_assists(
                under, context, jnp.clip(command, -1.0, 1.0), jnp.zeros((), bool), dt
            )
            return Command(command, jnp.zeros((), bool)), None

        params_of_run = sim.RunParams(
            vehicle=sim.true_vehicle(
                vehicle, mass_factor=begin.mass_factor, resistance_factor=begin.resistance_factor
            ),
            track=env.near_track(case.track, vehicle, at),
            protection=None,
            length_m=case.length_m,
            scheduled_s=begin.scheduled_s,
            speed_noise_mps=0.0,
            dt=jnp.float32(dt),
        )
        fresh = now.run._replace(plant=plant._replace(traction_j=jnp.zeros_like(plant.traction_j)))
        run, _, _ = sim.control_period(params_of_run, fresh, None, choose, rule=sim.NEVER_ENDS)
        reached = run.plant._replace(speed_mps=jnp.maximum(run.plant.speed_mps, SLOWEST_MPS))
        planned = self._stop_deceleration(begin, case, reached.position_m)
        curve = control.curve_for(vehicle, dt, planned, env.stop_options(self.assists.release))
        v, jerk = reached.speed_mps, jnp.minimum(vehicle.jerk_mps3, control.AT_ONCE_MPS3)
        quick, gone_m, build_s = control.build_up(v, reached.acceleration_mps2, planned, jerk)
        quick = jnp.maximum(quick, LEAST_STOP_MPS)
        distance = gone_m + control.braking_distance(quick, curve)
        duration = build_s + control.braking_time(quick, curve)
        left = case.length_m - reached.position_m
        return _Moving(
            run=run._replace(plant=reached),
            energy_j=now.energy_j + reached.traction_j / vehicle.effective_mass_kg,
            arrival_s=reached.time_s + duration + (left - distance) / v,
            done=left <= distance,
        )

    def _stop_deceleration(self, begin: Begin, case: env.SectionTables, position_m: Array) -> Array:
        """Deceleration the station stop is planned with from a position, m/s^2."""
        return self.assists.planned_mps2(self.rows, begin.case, case.stop_mps2, position_m)


DECISIONS = (200, 400, 600)
"""Drives are put together by length, each length compiled by itself."""
SPARE_S, SPARE_SHARE = 15.0, 0.05
"""Time beyond the optimal plan's that a drive may take before it is cut off."""
LEAST_J = 60.0
"""Least energy a drive's cost is a share of, per kilogram."""
SECOND_W = (0.2, 25.0)
ON_TIME_S = 0.3
"""Below this the price of being off time is square, beyond straight."""
DISTURBED = 0.5
MASS, RESISTANCE = 0.1, 0.2
"""Half the drives are of a trainset that is heavier or lighter, and runs harder or easier, than believed."""


@dataclass(frozen=True)
class TuningRuns:
    """Starts of drives, by length.

    Attributes:
        case: Row of the section in the tables. Shape (K,).
        begins: See :class:`~metropilot.learn.imitation.demonstrations.Demonstrations`. Shape (K, 7).
        lengths: Entries of each length in ``DECISIONS``.
    """

    case: Int[ndarray, " k"]
    begins: Float[ndarray, "k 7"]
    lengths: tuple[Int[ndarray, " drives"], ...]


def drives_of(case: Int[ndarray, " k"], begins: Float[ndarray, "k 7"], period_s: float) -> TuningRuns:
    """The drives short enough to be driven whole, sorted by length; those that cost nothing teach nothing."""
    taken = (begins[:, 4] - begins[:, 2]) * (1.0 + SPARE_SHARE) + SPARE_S
    needed = np.ceil(taken / period_s)
    costs = begins[:, 5] > 1.0
    edges = (0, *DECISIONS)
    lengths = tuple(
        np.flatnonzero(costs & (needed > low) & (needed <= high)) for low, high in pairwise(edges)
    )
    return TuningRuns(case, begins, lengths)


def batch_of(drives: TuningRuns, random: Generator, decisions: int) -> tuple[int, Begin]:
    """A length, as likely as there is to drive of it, and so many drives of it as make up the decisions."""
    work = np.array([rows.size * n for rows, n in zip(drives.lengths, DECISIONS, strict=True)], float)
    k = int(random.choice(len(DECISIONS), p=work / work.sum()))
    count = max(decisions // DECISIONS[k], 16)
    rows = random.choice(drives.lengths[k], count)
    position, speed, time, scheduled, arrival, optimum, second = drives.begins[rows].T
    off = random.random(count) < DISTURBED
    begin = Begin(
        case=drives.case[rows].astype(np.int32),
        position_m=position,
        speed_mps=speed,
        time_s=time,
        scheduled_s=scheduled,
        arrival_s=arrival,
        optimum_j=optimum,
        second_w=np.clip(second, *SECOND_W),
        mass_factor=1.0 + off * random.uniform(-MASS, MASS, count),
        resistance_factor=1.0 + off * random.uniform(-RESISTANCE, RESISTANCE, count),
    )
    return DECISIONS[k], Begin(begin.case, *(np.asarray(v, np.float32) for v in begin[1:]))


def excess_cost(
    loop: ClosedLoop, spec: PolicySpec, params: Params, begin: Begin, decisions: int, late: float
) -> Array:
    """Cost of one drive above the optimum, as a share of it; lateness at its price and more.

    Args:
        loop: Closed loop over the sections.
        spec: Layout of the policy's parameters.
        params: Of the policy.
        begin: The drive.
        decisions: Largest number of decisions.
        late: Price of a second off time besides, as a share.
    """

    def decide(params: Params, observation: Array) -> Array:
        return network_output(spec, params, observation, jnp)

    joule = 1.0 / jnp.maximum(begin.optimum_j, LEAST_J)
    drive = loop.drive(decide, params, begin, decisions, joule)
    spent = joule * (drive.energy_j - begin.optimum_j + begin.second_w * drive.late_s)
    off = jnp.sqrt(drive.late_s * drive.late_s + ON_TIME_S * ON_TIME_S) - ON_TIME_S
    return jnp.where(drive.done, spent + late * off, 0.0)


Step = Callable[[TrainState, Array, Begin, Array, Array], tuple[TrainState, Array]]


class Tuning:
    """Gradient steps in closed loop.

    Args:
        config: Configuration.
        spec: Layout of the policy's parameters.
        loop: Closed loop over the sections.
        drives: Starts of drives.
        demonstrations: Demonstrations still imitated beside.
    """

    def __init__(
        self,
        config: TeacherConfig,
        spec: PolicySpec,
        loop: ClosedLoop,
        drives: TuningRuns,
        demonstrations: Demonstrations,
    ) -> None:
        self.config = config
        self.spec = spec
        self.loop = loop
        self.drives = drives
        self.observations = demonstrations.observations
        self.wanted = labels(loop.action, demonstrations.commands)
        self._steps: dict[int, Step] = {}

    def step(self, train_state: TrainState, random: Generator, rate: float) -> tuple[TrainState, float]:
        """One step; the policy after it, and what its drives cost above the optimum, as a share."""
        decisions, begin = batch_of(self.drives, random, self.config.decisions)
        rows = random.integers(0, self.wanted.size, self.config.batch_size)
        step = self._steps.setdefault(decisions, jax.jit(partial(self._step, decisions)))
        train_state, cost = step(
            train_state, jnp.float32(rate), begin, self.observations[rows], self.wanted[rows]
        )
        return train_state, float(cost)

    def _step(
        self, decisions: int, train_state: TrainState, rate: Array, begin: Begin, seen: Array, wanted: Array
    ) -> tuple[TrainState, Array]:
        config, spec = self.config, self.spec

        def loss(params: Params) -> tuple[Array, Array]:
            one = partial(excess_cost, self.loop, spec, params, decisions=decisions, late=config.late_per_s)
            cost = jnp.mean(jax.vmap(lambda b: one(begin=b))(begin))
            return cost + config.imitation_weight * imitation_loss(spec, params, seen, wanted), cost

        (_, cost), gradient = jax.value_and_grad(loss, has_aux=True)(train_state.params)
        return apply_gradient(train_state, gradient, rate, config.max_gradient_norm), cost
