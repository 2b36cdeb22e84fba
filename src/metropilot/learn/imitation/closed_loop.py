"""Drives a policy through many worlds at once, compiled and differentiable from its commands to the bill.

A lean stand-in for the driving task: the same curves, features, action and assists, without protection (whose
permitted speed it keeps by itself), one step a decision, and the last braking counted in closed form from the
moment it begins. Gradients of energy and arrival time reach the policy through the whole drive, so that no
reward has to be explored; the policy that comes out is judged in the real task.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from metropilot.control.stopping import (
    AT_ONCE_MPS3,
    STRONGEST_MPS2,
    braking_distance,
    braking_time,
    build_up,
    curve_for,
)
from metropilot.env.actions import RegimeAction
from metropilot.env.assists import Assists, ceiling_at, stop_options
from metropilot.env.features import FeatureContext, observe
from metropilot.env.tables import CLIMB, SectionRows, SectionTables
from metropilot.physics import davis_n, effort_at
from metropilot.policy import Params

Array = Any
Decide = Callable[[Params, Array], Array]
"""From parameters and an observation of shape (O,) to an action of shape (1,)."""

LEAK = 0.3
"""Slope that the dead zone and the saturated ends of the action have for the gradient."""
SLOWEST_MPS = 0.3
LEAST_STOP_MPS = 0.1
"""Least speed that a station stop is counted from: keeps its gradient bounded."""


class Begin(NamedTuple):
    """How a drive begins, and what it is compared with. All 0-d, or one entry a drive.

    Attributes:
        case: Row of the world.
        position_m: Where.
        speed_mps: How fast.
        time_s: Time already used.
        scheduled_s: Scheduled running time.
        arrival_s: When the optimal plan arrives from here: the scheduled time, or the first possible.
        optimum_j: What that plan spends from here, per kilogram.
        second_w: What its last second costs, per kilogram.
        mass_factor: True over believed mass.
        resistance_factor: True over believed resistance.
    """

    case: Array
    position_m: Array
    speed_mps: Array
    time_s: Array
    scheduled_s: Array
    arrival_s: Array
    optimum_j: Array
    second_w: Array
    mass_factor: Array
    resistance_factor: Array


class ClosedLoopRollout(NamedTuple):
    """What came of a drive. All 0-d, or one entry a drive.

    Attributes:
        energy_j: Traction energy, per kilogram.
        late_s: Arrival minus the optimal plan's.
        done: Whether the last braking was reached.
    """

    energy_j: Array
    late_s: Array
    done: Array


class _Moving(NamedTuple):
    """State of a drive that has not begun its last braking."""

    position_m: Array
    speed_mps: Array
    time_s: Array
    effort_mps2: Array
    acceleration_mps2: Array
    energy_j: Array
    arrival_s: Array
    done: Array


WORTH = _Moving(4.0, 90.0, 50.0, 45.0, 45.0, 1.5, 50.0, 0.0)
"""What a unit of each can be worth at most, in joules per kilogram: a metre is worth no more than the largest
effort, a metre per second no more than the kinetic energy it adds, a second a few times its price."""


@jax.custom_vjp
def within_worth(now: _Moving, joule: Array) -> _Moving:
    """The state as it is; what flows back through it is kept within ``WORTH``.

    On the best drive the worth of speed, place and time is bounded by physics; a policy that switches to and
    fro multiplies its gradient at every switch and would drown that of all other drives.

    Args:
        now: The state.
        joule: What a joule per kilogram is worth to the loss.
    """
    del joule
    return now


def _forth(now: _Moving, joule: Array) -> tuple[_Moving, Array]:
    return now, joule


def _back(joule: Array, worth: _Moving) -> tuple[_Moving, Array]:
    def kept(value: Array, most: float) -> Array:
        if value.dtype == jax.dtypes.float0:
            return value
        return jnp.clip(jnp.nan_to_num(value, posinf=0.0, neginf=0.0), -most * joule, most * joule)

    return jax.tree.map(kept, worth, WORTH), jnp.zeros_like(joule)


within_worth.defvjp(_forth, _back)


@dataclass(frozen=True)
class ClosedLoop:
    """The drives of a set of worlds.

    Attributes:
        rows: Their tables.
        features: What the policy sees.
        action: What its action means.
        assists: What is done for it.
        period_s: Time between two decisions.
    """

    rows: SectionRows
    features: tuple[str, ...]
    action: RegimeAction
    assists: Assists
    period_s: float

    def drive(
        self, decide: Decide, params: Params, begin: Begin, decisions: int, joule: Array
    ) -> ClosedLoopRollout:
        """One drive; ``vmap`` it over ``begin``.

        Args:
            decide: The policy.
            params: Its parameters.
            begin: How it begins.
            decisions: How many at most.
            joule: What a joule per kilogram is worth to the loss.
        """
        zero = jnp.zeros((), jnp.float32)
        case = self.rows.case(begin.case)
        moving = _Moving(
            begin.position_m,
            begin.speed_mps,
            begin.time_s,
            zero,
            zero,
            zero,
            zero,
            jnp.zeros((), bool),
        )

        @jax.checkpoint
        def one(now: _Moving, _: None) -> tuple[_Moving, None]:
            now = within_worth(now, joule)
            after = self._step(decide, params, begin, case, now)
            return jax.tree.map(lambda old, new: jnp.where(now.done, old, new), now, after), None

        last, _ = jax.lax.scan(one, moving, None, length=decisions)
        return ClosedLoopRollout(last.energy_j, last.arrival_s - begin.arrival_s, last.done)

    def _sight(self, begin: Begin, case: SectionTables, now: _Moving) -> FeatureContext:
        return FeatureContext(
            rows=self.rows,
            case=begin.case,
            vehicle=case.vehicle,
            track=case.track,
            length_m=case.length_m,
            load=case.load,
            stop_mps2=self._planned(begin, case, now.position_m),
            rates=case.protection.rates,
            time_s=now.time_s,
            position_m=now.position_m,
            speed_mps=now.speed_mps,
            acceleration_mps2=now.acceleration_mps2,
            scheduled_s=begin.scheduled_s,
            command=jnp.zeros((), jnp.float32),
        )

    def _step(
        self, decide: Decide, params: Params, begin: Begin, case: SectionTables, now: _Moving
    ) -> _Moving:
        """One decision held for a period."""
        sight, dt, vehicle = self._sight(begin, case, now), self.period_s, case.vehicle
        action = decide(params, observe(self.features, sight))
        soft = jnp.clip(action[0], -1.0, 1.0)
        command = self.action.command(sight, action, dt) + LEAK * (soft - jax.lax.stop_gradient(soft))
        command = jnp.clip(command, -1.0, 1.0)
        v, mass = now.speed_mps, vehicle.effective_mass_kg * begin.mass_factor
        way = v * dt + 0.5
        rise = self._at(CLIMB, begin, now.position_m + way) - self._at(CLIMB, begin, now.position_m)
        slope = rise / way * (vehicle.mass_kg / vehicle.effective_mass_kg)

        def acting(v: Array) -> tuple[Array, Array]:
            effort = effort_at(vehicle, v)
            force = jnp.where(command >= 0.0, command * effort.traction_n, command * effort.brake_n)
            return force, begin.resistance_factor * davis_n(vehicle, v) / mass + slope

        force, drag = acting(v)
        gained = jnp.clip(force / mass - drag, -STRONGEST_MPS2, vehicle.max_acceleration_mps2) * dt
        force, drag = acting(jnp.maximum(v + 0.5 * gained, 0.0))
        jerk = jnp.minimum(vehicle.jerk_mps3, AT_ONCE_MPS3)
        acceleration = jnp.minimum(force / mass - drag, self._ceiling(sight, jerk))
        wanted = jnp.minimum(acceleration, vehicle.max_acceleration_mps2) + drag
        step = jnp.minimum(jerk * dt, 1e3)
        reached = jnp.clip(wanted, now.effort_mps2 - step, now.effort_mps2 + step)
        ramp = jnp.abs(reached - now.effort_mps2) / jerk
        mean = reached - 0.5 * (reached - now.effort_mps2) * jnp.clip(ramp / dt, 0.0, 1.0)
        after = jnp.maximum(v + (mean - drag) * dt, SLOWEST_MPS)
        gone = 0.5 * (v + after) * dt
        moved = now._replace(
            position_m=now.position_m + gone,
            speed_mps=after,
            time_s=now.time_s + dt,
            effort_mps2=reached,
            acceleration_mps2=reached - drag,
            energy_j=now.energy_j + jnp.maximum(mean, 0.0) * gone * begin.mass_factor,
        )
        planned = self._planned(begin, case, moved.position_m)
        curve = curve_for(vehicle, dt, planned, stop_options(self.assists.release))
        quick, gone_m, build_s = build_up(after, reached - drag, planned, jerk)
        quick = jnp.maximum(quick, LEAST_STOP_MPS)
        distance = gone_m + braking_distance(quick, curve)
        duration = build_s + braking_time(quick, curve)
        left = case.length_m - moved.position_m
        arrival = moved.time_s + duration + (left - distance) / after
        return moved._replace(arrival_s=arrival, done=left <= distance)

    def _at(self, column: int, begin: Begin, position_m: Array) -> Array:
        return self.rows.ground_at(column, begin.case, position_m)

    def _planned(self, begin: Begin, case: SectionTables, position_m: Array) -> Array:
        """Deceleration the last braking is planned with from a position."""
        return self.assists.planned_mps2(self.rows, begin.case, case.stop_mps2, position_m)

    def _ceiling(self, sight: FeatureContext, jerk: Array) -> Array:
        """Largest acceleration that stays under the permitted speed."""
        v, x, rates, dt = sight.speed_mps, sight.position_m, sight.rates, self.period_s
        margin = self.assists.margin_mps + rates.speed_error_mps
        ahead_s = dt + rates.reaction_s + 1.0 / jerk

        def room(seconds: Array | float) -> Array:
            return ceiling_at(self.assists, sight.rows, sight.case, x + v * seconds) - margin - v

        near, later = jnp.minimum(room(0.0), room(dt)), room(ahead_s)
        up = jnp.maximum(jnp.minimum(near, later), 0.0) / (dt + rates.reaction_s)
        return up + jnp.minimum(jnp.minimum(near / dt, later / ahead_s), 0.0)
