"""The task of Lu23: its twelve notches with the minimum-arrival-time filter, and its reward terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from metropilot._schema import check_fields, declare
from metropilot._typing import Array, Scalar
from metropilot.env import (
    PERMITTED_COLUMN,
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
CONTROL_S = 0.2
"""Control period."""
SHARES = (1 / 3, 2 / 3, 1.0)
"""Where in a decision the speed is compared with the permitted one."""
ON_CURVE, LAST_M = 0.6, 3.0
"""Share of the planned deceleration from which it is a station stop, and where its last metres begin."""
CRAWL_MPS = 1.0
"""What ends a decision slower than this, short of the stop, cannot be chosen with ``below_mps``."""
HELD_S, AGAIN_S = 2.0, 10.0
"""Time for which a stronger notch, and one after coasting, must stay below protection to be taken up."""
MEAN = 0.6
"""Speed over that at the beginning at which the resistance of a whole stop is taken."""
KEPT = 0.9
"""Share of the way to the next notch at which a station stop changes to it."""
ROOM_MPS = 0.3
"""Distance to the permitted speed below which braking may be that of the ceiling assist."""
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
        most_mps2: Largest acceleration and deceleration that a chosen notch may cause, m/s^2 (a_lim of Lu23
            eq. 18); 0: any.
        below_mps: Distance that a notch keeps from protection's permitted speed, m/s, so that the ceiling
            assist need not change notches: a weaker one is held where the chosen one would come nearer, and
            what comes nearer even by coasting cannot be chosen; 0: neither.
        late_brake: Brake to the stop by notches that are not stronger than needed, until the last metres.
    """

    kind = "notch_forces"

    notches_n: tuple[float, ...] = LU2023_N
    in_time: bool = True
    margin: float = declare(0.05, low=0.0, high=1.0)
    most_mps2: float = declare(0.0, low=0.0, high=5.0)
    below_mps: float = declare(0.0, low=0.0, high=5.0)
    late_brake: bool = False

    def __post_init__(self) -> None:
        """Check that the table contains traction, coasting and braking."""
        notches = self.notches_n
        if 0.0 not in notches or list(notches) != sorted(set(notches)) or not notches[0] < 0 < notches[-1]:
            allowed = "increasing forces in N, the first below 0, 0 among them, the last above 0"
            raise InputError("no table of notches", field="notches_n", value=str(notches), allowed=allowed)
        check_fields(self)

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
        """The same force at another speed; a weaker notch where it is too strong or the ceiling too near.

        A notch that pulls is held as long as the next control period stays below protection. A stronger one
        is taken up where it can be held for ``HELD_S``, and one after coasting for ``AGAIN_S``, so that the
        ceiling costs few switches.
        """
        del command
        if not (self.most_mps2 or self.below_mps):
            return self.command(context, action, 0.0)
        xp, (notches, rate, gentle) = context.rows.xp, self._effects(context)
        chosen = notches[action]
        pulls = gentle & (notches <= chosen)
        if self.below_mps:
            effort = effort_at(context.vehicle, context.speed_mps)
            in_force_n = effort.force_n(context.command)
            not_stronger = xp.minimum(notches, effort.traction_n) <= in_force_n + ROUNDING_N
            kept = not_stronger & self._stays_below(context, rate, CONTROL_S)
            held_s = xp.where(in_force_n > ROUNDING_N, HELD_S, AGAIN_S)
            pulls = pulls & (kept | self._stays_below(context, rate, held_s))
        traction = xp.max(xp.where(pulls, notches, 0.0))
        brake = xp.min(xp.where(gentle & (notches >= chosen), notches, 0.0))
        force_n = xp.where(chosen > 0.0, traction, brake)
        return command_for_force(context.vehicle, context.speed_mps, force_n)

    def action_mask(self, context: FeatureContext, period_s: float) -> Array | None:
        """Mask of the choices that stay below protection and can still arrive in time.

        Every notch that pulls can be chosen where coasting can: :meth:`hold` weakens it. The state after one
        decision at each notch is taken with the resistance at the present state. The flat-out time from there
        is compared with the time left (Lu23 section 3.3.4, steps a to c: ``T - t_k < t_lim`` chooses again);
        it is that of the plant with its resistance and limits, not of a speed that changes at once. Where no
        choice is in time, the strongest of the others is allowed; where all come too near to protection, the
        strongest gentle brake.
        """
        if not (self.in_time or self.most_mps2 or self.below_mps):
            return None
        xp, v = context.rows.xp, context.speed_mps
        notches, rate, gentle = self._effects(context)
        allowed = gentle | (notches > 0.0)
        rate = xp.minimum(rate, self.most_mps2 or np.inf)
        coasting = rate[self.notches_n.index(0.0)]
        if self.below_mps:
            strongest = notches == xp.min(xp.where(allowed, notches, 0.0))
            held = self._stays_below(context, xp.minimum(rate, coasting), period_s)
            allowed = allowed & (held | strongest)
            moves = (notches > 0.0) | (v + rate * period_s > CRAWL_MPS) | (context.left_m <= LAST_M)
            allowed = xp.where(xp.any(allowed & moves), allowed & moves, allowed)
        if not self.in_time:
            return allowed
        after = xp.maximum(v + rate * period_s, 0.0)
        if self.below_mps:
            at = context.position_m + v * period_s
            highest = context.rows.curve_at(PERMITTED_COLUMN, context.case, at) - self.below_mps
            after = xp.minimum(after, xp.maximum(highest, v + xp.minimum(rate, coasting) * period_s))
        left_m = xp.maximum(context.left_m - 0.5 * (v + after) * period_s, 0.0)
        to_go = context.rows.to_go_s(context.case, left_m, context.length_m, after)
        in_time = context.left_s - period_s >= (1.0 + self.margin) * to_go
        return allowed & (in_time | (notches >= xp.max(xp.where(allowed, notches, notches[0]))))

    def _effects(self, context: FeatureContext) -> tuple[Array, Array, Array]:
        """Notches, N, the acceleration that each causes here, m/s^2, and if it is gentle; coasting is."""
        xp, vehicle, v = context.rows.xp, context.vehicle, context.speed_mps
        resistance, gradient = resistance_and_gradient(vehicle, context.track, context.position_m, v)
        effort = effort_at(vehicle, v)
        notches = xp.asarray(self.notches_n, np.float32)
        force = xp.clip(notches, -effort.brake_n, effort.traction_n)
        rate = (force - resistance - gradient) / vehicle.effective_mass_kg
        most = self.most_mps2 or np.inf
        return notches, rate, xp.where(notches > 0.0, rate, -rate) <= xp.where(notches == 0.0, np.inf, most)

    def _stays_below(self, context: FeatureContext, rate: Array, period_s: Scalar) -> Array:
        """Tell for each notch if the ceiling assist would let it pass for ``period_s``."""
        xp, rates, v = context.rows.xp, context.rates, context.speed_mps
        ahead_s = rates.reaction_s + CONTROL_S
        rise = xp.maximum(rate, 0.0) * ahead_s * rates.mass_high / rates.mass_low
        least = context.permitted_mps - v + 0.0 * rate
        for share in SHARES:
            passed_s = share * period_s
            after = xp.maximum(v + rate * passed_s, 0.0)
            x = context.position_m + 0.5 * (v + after) * passed_s
            for at in (x, x + after * ahead_s):
                permitted = context.rows.curve_at(PERMITTED_COLUMN, context.case, at)
                least = xp.minimum(least, permitted - after - rise)
        return least >= self.below_mps + rates.speed_error_mps

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
        if self.late_brake:
            steady, stops = self._steady_brake(context, notches)
            chosen = xp.min(xp.abs(reached - wanted)) <= ROUNDING_N  # a notch of the policy's own
            index = xp.where(stops & (wanted < 0.0) & (index >= 0) & (chosen ^ True), steady, index)
        notch = command_for_force(context.vehicle, context.speed_mps, notches[xp.maximum(index, 0)])
        return xp.where(index >= 0, notch, command)

    def _steady_brake(self, context: FeatureContext, notches: Array) -> tuple[Array, Array]:
        """Index of the notch for the deceleration that the stop needs, and if this is a station stop.

        The notch in force stays until the next stronger one is not too strong, or nearly the next weaker one
        suffices (``KEPT``): a stop that falls behind its curve loses its time in the last metres.
        """
        xp, vehicle, v = context.rows.xp, context.vehicle, context.speed_mps
        resistance, gradient = resistance_and_gradient(vehicle, context.track, context.position_m, MEAN * v)
        needed_mps2 = 0.5 * v * v / xp.maximum(context.left_m, LAST_M)
        force_n = -(needed_mps2 * vehicle.effective_mass_kg - gradient - resistance)
        in_force_n = effort_at(vehicle, v).force_n(context.command)
        index = xp.minimum(xp.sum(notches < force_n - ROUNDING_N), notches.size - 1)
        stronger = xp.maximum(index - 1, 0)
        keeps = (xp.abs(in_force_n - notches[stronger]) <= ROUNDING_N) & (
            force_n <= notches[index] - KEPT * (notches[index] - notches[stronger])
        )
        index = xp.where(keeps, stronger, index)
        gentle = self._effects(context)[2][index]
        index = xp.where(gentle, index, xp.minimum(index + 1, notches.size - 1))
        stops = (needed_mps2 >= ON_CURVE * context.stop_mps2) & (context.left_m > LAST_M)
        stops = stops & (v <= context.permitted_mps - ROOM_MPS)  # else it may be the ceiling that brakes
        return index, stops


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


@final
@dataclass(frozen=True)
class RegimeSwitch(AbstractTerm):
    """Price of a decision that changes between traction, coasting and braking (counted in Lu23 Fig. 9).

    Attributes:
        price: Price of a change.
    """

    name = "regime_switch"
    price: float = 2.0

    def value(self, change: PeriodChange) -> Array:
        """Minus the price where the sign of the command is another one than after the decision before."""
        xp = namespace(change.speed_mps)
        now, before = change.command, change.command_before
        switched = ((now > 0.0) ^ (before > 0.0)) | ((now < 0.0) ^ (before < 0.0))
        return xp.where(switched, -self.price, 0.0 * now)
