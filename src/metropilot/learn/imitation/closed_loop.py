"""Differentiable rollout of a policy on many sections at once, from its commands to energy and arrival time.

The control period is that of every other engine (:func:`metropilot.sim.control_period`), with the features,
the action and the ceiling of the driving task, but as long as a decision and without protection, whose
permitted speed the ceiling keeps; the station stop is counted in closed form from where it begins. Gradients
of energy and arrival time reach the policy through the whole drive, so that no reward has to be explored; the
policy that comes out is judged in the real task.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from metropilot._typing import Array, Flag, Float, Index, Scalar, Shaped
from metropilot.control import (
    AT_ONCE_MPS3,
    braking_distance,
    braking_time,
    build_up,
    curve_for,
)
from metropilot.env import (
    Assists,
    RegimeAction,
    SectionRows,
    SectionTables,
    apply_assists,
    feature_context,
    near_track,
    observe,
    stop_options,
)
from metropilot.physics import Command, at_rest, to_jax
from metropilot.policy import Params
from metropilot.sim import (
    NEVER_ENDS,
    RUNNING,
    RunParams,
    RunState,
    control_period,
    first_state,
    true_vehicle,
)

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

    run: RunState
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

    rows: SectionRows
    features: tuple[str, ...]
    action: RegimeAction
    assists: Assists
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
        run = first_state(plant, None)._replace(outcome=jnp.full((), RUNNING, jnp.int32))
        moving = _Moving(run, zero, zero, jnp.zeros((), bool))

        @jax.checkpoint
        def one(now: _Moving, _: None) -> tuple[_Moving, None]:
            now = within_worth(now, joule)
            after = self._step(decide, params, begin, case, now)
            return jax.tree.map(lambda old, new: jnp.where(now.done, old, new), now, after), None

        last, _ = jax.lax.scan(one, moving, None, length=decisions)
        return ClosedLoopRollout(last.energy_j, last.arrival_s - begin.arrival_s, last.done)

    def _step(
        self, decide: Decide, params: Params, begin: Begin, case: SectionTables, now: _Moving
    ) -> _Moving:
        """One control period as long as a decision, on the plant itself, under the ceiling of the assists."""
        dt, vehicle, plant = self.period_s, case.vehicle, now.run.plant
        at = plant.position_m
        context = feature_context(
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
        )

        def choose(_: None, __: RunState) -> tuple[Command, None]:
            action = decide(params, observe(self.features, context))
            soft = jnp.clip(action[0], -1.0, 1.0)
            command = self.action.command(context, action, dt) + LEAK * (soft - jax.lax.stop_gradient(soft))
            # the station stop is counted in closed form below
            under = replace(self.assists, stop=False)
            command, _ = apply_assists(under, context, jnp.clip(command, -1.0, 1.0), jnp.zeros((), bool), dt)
            return Command(command, jnp.zeros((), bool)), None

        params_of_run = RunParams(
            vehicle=true_vehicle(
                vehicle, mass_factor=begin.mass_factor, resistance_factor=begin.resistance_factor
            ),
            track=near_track(case.track, vehicle, at),
            protection=None,
            length_m=case.length_m,
            scheduled_s=begin.scheduled_s,
            speed_noise_mps=0.0,
            dt=jnp.float32(dt),
        )
        fresh = now.run._replace(plant=plant._replace(traction_j=jnp.zeros_like(plant.traction_j)))
        run, _, _ = control_period(params_of_run, fresh, None, choose, rule=NEVER_ENDS)
        reached = run.plant._replace(speed_mps=jnp.maximum(run.plant.speed_mps, SLOWEST_MPS))
        planned = self._stop_deceleration(begin, case, reached.position_m)
        curve = curve_for(vehicle, dt, planned, stop_options(self.assists.release))
        v, jerk = reached.speed_mps, jnp.minimum(vehicle.jerk_mps3, AT_ONCE_MPS3)
        quick, gone_m, build_s = build_up(v, reached.acceleration_mps2, planned, jerk)
        quick = jnp.maximum(quick, LEAST_STOP_MPS)
        distance = gone_m + braking_distance(quick, curve)
        duration = build_s + braking_time(quick, curve)
        left = case.length_m - reached.position_m
        return _Moving(
            run=run._replace(plant=reached),
            energy_j=now.energy_j + reached.traction_j / vehicle.effective_mass_kg,
            arrival_s=reached.time_s + duration + (left - distance) / v,
            done=left <= distance,
        )

    def _stop_deceleration(self, begin: Begin, case: SectionTables, position_m: Array) -> Array:
        """Deceleration the station stop is planned with from a position, m/s^2."""
        return self.assists.planned_mps2(self.rows, begin.case, case.stop_mps2, position_m)
