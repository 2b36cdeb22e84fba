"""The task of Lu23: its twelve notches with the minimum-arrival-time filter, and its reward terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from metropilot._typing import Array
from metropilot.env import (
    AbstractAction,
    AbstractTerm,
    ActionSpace,
    FeatureContext,
    PeriodChange,
)
from metropilot.errors import InputError
from metropilot.physics import command_for_force, effort_at, namespace, resistance_and_gradient

LU2023_N = (-149e3, -132e3, -99e3, -66e3, -33e3, 0.0, 34e3, 68e3, 102e3, 136e3, 170e3, 180e3)
"""The twelve actions of Lu23 Table 3."""
ROUNDING_N = 200.0
"""Tolerance within which a force equals a notch, for single precision."""


@final
@dataclass(frozen=True)
class NotchForceAction(AbstractAction):
    """Choice from a table of forces, to which the command after the assists is rounded as well.

    Attributes:
        notches_n: Forces in N, increasing, braking negative, 0 (coasting) among them.
        in_time: Mask choices after which even the flat-out run would be late (Lu23 section 3.3.4).
        margin: Relative allowance on the flat-out time in this mask, for the margin to protection and the
            steps of the notches.
    """

    kind = "notch_forces"

    notches_n: tuple[float, ...] = LU2023_N
    in_time: bool = True
    margin: float = 0.05

    def __post_init__(self) -> None:
        """Check that the table contains traction, coasting and braking."""
        notches = self.notches_n
        if 0.0 not in notches or list(notches) != sorted(set(notches)) or not notches[0] < 0 < notches[-1]:
            allowed = "increasing forces in N, the first below 0, 0 among them, the last above 0"
            raise InputError("no table of notches", field="notches_n", value=str(notches), allowed=allowed)
        if not 0.0 <= self.margin <= 1.0:
            raise InputError("out of range", field="margin", value=self.margin, allowed="0 to 1")

    @property
    def space(self) -> ActionSpace:
        """Action space with one choice a notch."""
        return ActionSpace(count=len(self.notches_n))

    def command(self, context: FeatureContext, action: Array, period_s: float) -> Array:
        """Command of the notch, limited to the available force."""
        del period_s
        force_n = context.rows.xp.asarray(self.notches_n, np.float32)[action]
        return command_for_force(context.vehicle, context.speed_mps, force_n)

    def hold(self, context: FeatureContext, action: Array, command: Array) -> Array:
        """The same force at another speed."""
        del command
        return self.command(context, action, 0.0)

    def action_mask(self, context: FeatureContext, period_s: float) -> Array | None:
        """Mask of the choices after which the trainset can still arrive in time; the last is always allowed.

        The state after one decision at each notch (with the resistance at the present state) and the
        flat-out time from there are compared with the time left (Lu23 section 3.3.4, steps a to c:
        ``T - t_k < t_lim`` chooses again). The flat-out time is that of the plant with its resistance and
        limits, not of a speed that changes at once.
        """
        if not self.in_time:
            return None
        xp, vehicle, v = context.rows.xp, context.vehicle, context.speed_mps
        resistance, gradient = resistance_and_gradient(vehicle, context.track, context.position_m, v)
        effort = effort_at(vehicle, v)
        notches = xp.asarray(self.notches_n, np.float32)
        force = xp.clip(notches, -effort.brake_n, effort.traction_n)
        rate = (force - resistance - gradient) / vehicle.effective_mass_kg
        after = xp.maximum(v + rate * period_s, 0.0)
        left_m = xp.maximum(context.left_m - 0.5 * (v + after) * period_s, 0.0)
        to_go = context.rows.to_go_s(context.case, left_m, context.length_m, after)
        in_time = context.left_s - period_s >= (1.0 + self.margin) * to_go
        return in_time | (notches >= notches[-1])

    def round(self, context: FeatureContext, command: Array) -> Array:
        """The notch for a command the assists have changed: the weakest brake that is strong enough.

        Where no notch is (another trainset than the table is of), the stop needs the command as it is.
        """
        xp, effort = context.rows.xp, effort_at(context.vehicle, context.speed_mps)
        notches = xp.asarray(self.notches_n, np.float32)
        wanted = effort.force_n(command)
        reached = xp.clip(notches, -effort.brake_n, effort.traction_n)
        # the strongest notch not above what is wanted: a weaker pull, or a stronger brake
        index = xp.sum(reached <= wanted + ROUNDING_N) - 1
        notch = command_for_force(context.vehicle, context.speed_mps, notches[xp.maximum(index, 0)])
        return xp.where(index >= 0, notch, command)


@final
@dataclass(frozen=True)
class EffortEnergy(AbstractTerm):
    """Minus the work of traction and of the electric brake, ``mu |f dx|`` (Lu23 eq. 16).

    Attributes:
        per_j: mu.
    """

    name = "effort_energy"
    per_j: float = 1e-5

    def value(self, change: PeriodChange) -> Array:
        """Minus the work, traction and braking alike."""
        return -self.per_j * (change.wheel_j + change.braked_j)


@final
@dataclass(frozen=True)
class StopWindow(AbstractTerm):
    """Bonus at the end if the trainset stands close enough to the stop, otherwise its negative (Lu23 eq. 17).

    Attributes:
        bonus: K.
        within_m: Largest distance that earns it.
    """

    name = "stop_window"
    bonus: float = 1000.0
    within_m: float = 0.3

    def value(self, change: PeriodChange) -> Array:
        """Plus or minus the bonus, at the end only."""
        xp = namespace(change.error_m)
        won = change.arrived & (xp.abs(change.error_m) <= self.within_m)
        return xp.where(change.ended, xp.where(won, self.bonus, -self.bonus), 0.0 * change.error_m)


@final
@dataclass(frozen=True)
class AccelerationComfort(AbstractTerm):
    """Small bonus for every decision with a gentle acceleration, its negative for a strong one (Lu23 eq. 18).

    The paper prints ``P + a`` for a gentle one; that rewards acceleration, so this is ``P - |a|``.

    Attributes:
        bonus: P.
        limit_mps2: a_lim, the largest gentle acceleration.
        jump_mps2: Change of acceleration from one decision to the next beyond which the price is L.
        jump_price: L.
        literal: Add the acceleration to P, as printed, braking negative.
    """

    name = "acceleration_comfort"
    bonus: float = 1.0
    limit_mps2: float = 0.8
    jump_mps2: float = 0.4
    jump_price: float = 10.0
    literal: bool = False

    def value(self, change: PeriodChange) -> Array:
        """P less the size of the acceleration, -P beyond the limit, -L after a jump up."""
        xp = namespace(change.acceleration_mps2)
        size = xp.abs(change.acceleration_mps2)
        earned = self.bonus + (change.acceleration_mps2 if self.literal else -size)
        gentle = xp.where(size <= self.limit_mps2, earned, -self.bonus)
        return xp.where(
            change.acceleration_mps2 - change.before_mps2 > self.jump_mps2, -self.jump_price, gentle
        )


@final
@dataclass(frozen=True)
class Moving(AbstractTerm):
    """Very small bonus for every decision after which the trainset moves (Lu23 eq. 20).

    Attributes:
        bonus: r_v.
    """

    name = "moving"
    bonus: float = 0.01

    def value(self, change: PeriodChange) -> Array:
        """Bonus where the speed is above zero."""
        xp = namespace(change.speed_mps)
        return xp.where(change.speed_mps > 0.0, self.bonus, 0.0 * change.speed_mps)
