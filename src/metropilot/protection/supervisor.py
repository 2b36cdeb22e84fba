"""The supervisor: the last word on every command. Pure, over NumPy or JAX; batch it with ``jax.vmap``."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from metropilot._typing import Array, Float, Index, Scalar
from metropilot.physics import Command, namespace, push_command, scalars, slice_from, unless
from metropilot.protection.predict import (
    EffortsAround,
    Forces,
    acceleration,
    efforts_around,
    fastest,
    gain_on_fall,
    reaction_way,
    stays_under,
)
from metropilot.protection.separation import TrainAhead, brake_motion, least_gap
from metropilot.protection.types import Memory, Protection, Rates, Verdict

RELEASE_MPS = 0.1
"""After an intervention the driver's command must fit at this much more speed before it passes again."""
EXPECTED_MPS = 0.02
"""Error of a speed expected some periods ahead."""
FELT_SHARE = 0.2
"""Share of a command that a lag leaves when it counts as over."""
STANDSTILL_MPS = 0.05
"""At or below this measured speed, plus its error, the emergency brake is released; a speed further below
zero is no measurement."""


def supervise(
    protection: Protection,
    memory: Memory,
    position_m: Scalar,
    speed_mps: Scalar,
    command: Command,
    ahead: TrainAhead | None = None,
) -> tuple[Command, Memory, Verdict]:
    """Decide what reaches the trainset in the coming period.

    A command passes if, whatever plant within the declared bounds carries it out, the emergency brake decided
    one period later would still keep every limit ahead. Otherwise the mildest of three does: traction cut
    off, full service brake, emergency brake. So at every instant either the command passes or the emergency
    brake is still in time: that is the guarantee, by induction. Before that, the driver's command must leave
    time for the service brake, as the nominal plant has it; this only spares the emergency brake. The
    emergency brake stays on until standstill. A command that is not a finite number is a full service brake,
    one out of range is clipped, and a measurement that is not finite brings the emergency brake, as do a
    speed below zero by more than its declared error and ``STANDSTILL_MPS`` (what an odometer reads at a
    standstill), a position before the map, and one beyond the end of the movement authority.

    Behind another trainset the authority moves: the same brake must also keep clear of that trainset, however
    hard it brakes within what is declared of it (see :mod:`metropilot.protection.separation`).

    Args:
        protection: Curves and bounds.
        memory: From the last period.
        position_m: Measured position of the head.
        speed_mps: Measured speed.
        command: The driver's command.
        ahead: The trainset ahead as last heard of, if there is one.

    Returns:
        The command to apply, the new memory, and what was decided.
    """
    xp = namespace(protection.start_m, position_m, command.share)
    error = protection.rates.speed_error_mps
    valid = xp.abs(command.share) <= 1.0
    none = 0.0 * error
    full = none - 1.0
    wanted = xp.where(xp.abs(command.share) < float("inf"), xp.clip(command.share, -1.0, 1.0), full)
    cut = xp.minimum(wanted, none)
    margin = xp.where(memory.level > 0, RELEASE_MPS, 0.0)
    check = CommandCheck(protection, memory, position_m, speed_mps, ahead)

    passes = check.passes(wanted, margin)
    level = unless(passes, 0, _milder, protection, memory, position_m, speed_mps, cut, ahead)
    moving = (speed_mps <= STANDSTILL_MPS + error) ^ True
    beyond = check.position_m > protection.authority_m
    emergency = (level == 3) | (memory.emergency & moving) | command.emergency | beyond
    level = xp.where(emergency, 3, level)
    share = xp.where(level == 0, wanted, xp.where(level == 1, cut, full))

    kept, acceleration_mps2 = check.effect(share)
    overruled = (level > 0) & (command.emergency ^ True)
    after = Memory(
        recent=push_command(memory.recent, share),
        share=kept,
        acceleration_mps2=acceleration_mps2,
        emergency=emergency,
        level=_as_count(level),
        interventions=memory.interventions + _as_count(overruled & (memory.level == 0)),
        emergencies=memory.emergencies + _as_count(emergency & (memory.emergency ^ True)),
        invalid=memory.invalid + _as_count(valid ^ True),
    )
    permitted = _interpolate(protection.permitted_mps, check.node, check.way)
    verdict = Verdict(after.level, permitted, (2.0 * check.energy(protection.emergency)) ** 0.5, valid)
    return Command(share, emergency), after, verdict


def _milder(
    protection: Protection,
    memory: Memory,
    position_m: Scalar,
    speed_mps: Scalar,
    cut: Scalar,
    ahead: TrainAhead | None,
) -> Scalar:
    """The mildest level that will do for a command that does not pass: 1, 2 or 3."""
    check = CommandCheck(protection, memory, position_m, speed_mps, ahead)
    none = 0.0 * protection.rates.speed_error_mps
    if check.xp is scalars:
        return 1 if check.passes(cut, none) else 2 if check.emergency(none - 1.0, none) else 3
    brake = check.xp.where(check.emergency(none - 1.0, none), 2, 3)
    return check.xp.where(check.passes(cut, none), 1, brake)


def periods_in_effect(protection: Protection, memory: Memory) -> int:
    """Number of periods in which a command given now may be on its way or still be felt.

    Args:
        protection: Curves and bounds.
        memory: Memory of protection, of this or any other period.
    """
    keep = float(protection.fading.share)
    return memory.recent.size + (math.ceil(math.log(FELT_SHARE) / math.log(keep)) if keep > 0.0 else 0)


def admits_braking(
    protection: Protection,
    memory: Memory,
    position_m: Float[np.ndarray, " periods"],
    speed_mps: Float[np.ndarray, " periods"],
) -> bool:
    """Tell if full braking would pass in each of the coming periods, whatever is still on its way (NumPy).

    A command that passes counts for as long as it may still be on its way, and then as a lag lets go of it.
    For drivers whose commands act late: while full braking passes, they can still avoid an intervention.
    Nothing of the guarantee rests on it.

    Args:
        protection: Curves and bounds.
        memory: After the last command.
        position_m: Position expected at the end of each period.
        speed_mps: Speed expected there.
    """
    if isinstance(position_m, np.ndarray) and _far_below(
        protection, memory, position_m, float(speed_mps.max())
    ):
        return True
    # After the last of them full braking alone is on its way, and what is in effect falls.
    rest = np.full(max(position_m.size - memory.recent.size + 1, 0), -1.0)
    older = np.append(np.maximum.accumulate(memory.recent)[-2::-1], rest)[: position_m.size]
    share, keep = [memory.share], protection.fading.share
    for each in older:
        share.append(each + max(share[-1] - each, 0.0) * keep)
    bound = np.stack(share[1:])[:, None]
    before = memory._replace(recent=np.full(1, -1.0), share=bound)
    check = CommandCheck(protection, before, position_m[:, None], speed_mps[:, None])
    # An acceleration fades at the jerk limit, but not while the commands on their way still uphold it.
    upheld, fades = acceleration(check.worst.forces, bound)[:, 0], protection.fading.acceleration_mps2
    gained = [memory.acceleration_mps2]
    for each in upheld[:-1]:
        gained.append(np.maximum(each, gained[-1] - fades))
    check.fading = np.stack(gained)[:, None] - fades
    margin = EXPECTED_MPS + protection.rates.speed_error_mps
    return bool(check.passes(bound, margin).all())


def _far_below(
    protection: Protection, memory: Memory, position_m: Float[np.ndarray, " periods"], speed_mps: float
) -> bool:
    """Tell cheaply if a speed is so far below both curves that no command on its way can reach them."""
    usual, worst, pull = protection.service_rates, protection.rates, protection.pull_mps2
    (first, _), (last, _) = on_grid(protection, position_m[0]), on_grid(protection, position_m[-1])
    ahead = slice(first, last + protection.ahead.size)
    # the service curve looks at the gradient over a longer reaction, so its pull may grow before the other's
    most = max(pull[first : last + 2].max(), protection.usual_pull_mps2[first : last + 2].max())
    # the acceleration remembered is one of the pull where the last command was given, a period before
    back_m = speed_mps * min(float(usual.reaction_s), float(worst.reaction_s))
    start = max(first - 1 - int(back_m / float(protection.spacing_m)), 0)
    rise = max(float(memory.acceleration_mps2 + most - pull[start : first + 1].min()), 0.0)
    reaction_s = max(float(usual.reaction_s), float(worst.reaction_s))
    jerk = min(float(usual.jerk_mps3), float(worst.jerk_mps3))
    peak = speed_mps + EXPECTED_MPS + 2.0 * worst.speed_error_mps + rise * (reaction_s + 0.5 * rise / jerk)
    return bool(0.5 * peak**2 <= min(protection.service[ahead].min(), protection.emergency[ahead].min()))


class Brake(NamedTuple):
    """One brake at one position: its rates, its curve ahead, the gradient's pull, what efforts do."""

    rates: Rates
    curve: Scalar
    pull_mps2: Scalar
    forces: Forces


class CommandCheck:
    """Tests of a command at one measured position and speed."""

    def __init__(
        self,
        protection: Protection,
        memory: Memory,
        position_m: Scalar,
        speed_mps: Scalar,
        ahead: TrainAhead | None = None,
    ) -> None:
        self.xp = xp = namespace(protection.start_m, position_m)
        self.protection, self.memory = protection, memory
        # what is before the map or runs backward is no measurement either: it would permit too much
        known = (position_m >= protection.start_m - protection.spacing_m) & (position_m < float("inf"))
        forward = (speed_mps >= -(STANDSTILL_MPS + protection.rates.speed_error_mps)) & (
            speed_mps < float("inf")
        )
        position = xp.where(known, position_m, protection.start_m)
        self.speed_mps = speed_mps = xp.where(forward, speed_mps, 0.0)
        self.measured = known & forward
        self.ahead, self.position_m = ahead, position
        self.node, self.way = on_grid(protection, position)
        self.first_m = protection.start_m + protection.spacing_m * _like(position, self.node) - position
        worst, usual = protection.rates, protection.service_rates
        pull, usual_pull = (self._pull(each) for each in (protection.pull_mps2, protection.usual_pull_mps2))
        gain = gain_on_fall(worst, pull)
        around = efforts_around(protection.vehicle, worst, speed_mps, gain)
        self.worst = self._brake(worst, protection.emergency, pull, around)
        if xp is not scalars or usual.speed_error_mps != worst.speed_error_mps:
            around = efforts_around(protection.vehicle, usual, speed_mps, gain)
        self.usual = self._brake(usual, protection.service, usual_pull, around)
        # The oldest command remembered has arrived; the others may still be on their way.
        self.older = -1.0 if memory.recent.shape[0] == 1 else memory.recent[:-1].max()
        self.fading = memory.acceleration_mps2 - protection.fading.acceleration_mps2

    @cached_property
    def distance_m(self) -> Array:
        """Distance to the nodes ahead, the first at hand or just behind."""
        steps = self.protection.ahead.astype(self.protection.emergency.dtype) * self.protection.spacing_m
        return steps + self.first_m

    def energy(self, curve: Float[Array, " nodes"]) -> Scalar:
        """A curve at this position, m^2/s^2."""
        return _interpolate(curve, self.node, self.way)

    def emergency(self, share: Scalar, margin_mps: Scalar) -> Scalar:
        """True if the emergency brake decided one period from now is in time, whatever the plant."""
        return self._in_time(self.worst, share, margin_mps) & self._clear(share, margin_mps, 0.0)

    def passes(self, share: Scalar, margin_mps: Scalar) -> Scalar:
        """The same, and whether the service brake would do on the nominal plant."""
        in_time = self._in_time(self.usual, share, margin_mps) & self._in_time(self.worst, share, margin_mps)
        return in_time & self._clear(share, margin_mps, 1.0)

    def _pull(self, pulls: Array) -> Scalar:
        return self.xp.maximum(pulls[self.node], pulls[self.node + 1])

    def _brake(self, rates: Rates, curve: Array, pull: Scalar, around: EffortsAround) -> Brake:
        ahead = slice_from(curve, self.node, self.protection.ahead.shape[0])
        forces = fastest(self.protection.vehicle, rates, self.speed_mps, pull, around)
        return Brake(rates, ahead, pull, forces)

    def _in_time(self, brake: Brake, share: Scalar, margin_mps: Scalar) -> Scalar:
        fading = self._usual_fading() if brake is self.usual else self.fading
        acting = self.xp.maximum(acceleration(brake.forces, self.share_bound(share)), fading)
        speed = self.speed_mps + brake.rates.speed_error_mps + margin_mps
        moving = speed, acting, brake.pull_mps2
        if self.xp is scalars:
            _, peak, _, full = reaction_way(brake.rates, *moving)
            last_m = float(self.protection.ahead[-1]) * self.protection.spacing_m + self.first_m
            if full <= last_m and 0.5 * peak * peak <= brake.curve.min():
                # every node is level, as most of the way; the rest takes ten times as long
                return self.measured
        return self.measured & stays_under(brake.rates, brake.curve, self.distance_m, *moving)

    def _usual_fading(self) -> Scalar:
        """Acceleration left for the service brake, on the nominal plant.

        The acceleration remembered is that of the lightest trainset. Where the brakes are controlled it
        leaves climbs out, and a trainset that holds its speed on one seemed to accelerate.
        """
        (push, _, coast), (usual_push, _, usual_coast) = self.worst.forces, self.usual.forces
        share = (self.fading - coast) / self.xp.maximum(push, 1e-6)
        nominal = share * self.xp.maximum(usual_push, 1e-6) + usual_coast
        return self.xp.where(self.protection.fading.nominal > 0.0, nominal, self.fading)

    def _clear(self, share: Scalar, margin_mps: Scalar, rooms: float) -> Scalar:
        """True if the emergency brake decided one period from now keeps clear of the trainset ahead.

        Args:
            share: Command let pass until then.
            margin_mps: Speed to allow on top of the measured one.
            rooms: Multiple of its ``room_m`` that must be left.
        """
        if self.ahead is None:
            return self.measured
        bounds = self.ahead.bounds
        return self.least_gap(self.ahead, share, margin_mps) >= bounds.margin_m + rooms * bounds.room_m

    def least_gap(self, ahead: TrainAhead, share: Scalar, margin_mps: Scalar) -> Scalar:
        """Smallest gap to come if a command passes now and both brake as hard as they must thereafter."""
        rates = self.worst.rates
        acting = self.xp.maximum(acceleration(self.worst.forces, self.share_bound(share)), self.fading)
        speed = self.speed_mps + rates.speed_error_mps + margin_mps
        motion = brake_motion(speed, acting, rates.reaction_s, rates.jerk_mps3, ahead.bounds.held_mps2)
        return least_gap(ahead, self.position_m, motion)

    def share_bound(self, share: Scalar) -> Scalar:
        """Upper bound on the share in effect from now on, after dead time and lag."""
        newest = self.xp.maximum(share, self.older)
        return newest + self.xp.maximum(self.memory.share - newest, 0.0) * self.protection.fading.share

    def effect(self, share: Scalar) -> tuple[Scalar, Scalar]:
        """Upper bounds on the share in effect and on the acceleration over the coming period."""
        kept = self.share_bound(share)
        return kept, self.xp.maximum(acceleration(self.worst.forces, kept), self.fading)


def permitted_speed(protection: Protection, position_m: Scalar) -> Scalar:
    """Permitted speed at one or many positions, m/s: a cap for planners and drivers.

    Whoever holds a speed at or under it is not overruled. Whoever still accelerates by ``a`` must stay lower
    by ``a * reaction_s`` and what the emergency brake needs to undo ``a``; see :func:`approach_margin`.
    """
    return _interpolate(protection.permitted_mps, *on_grid(protection, position_m))


def spare_gap(
    protection: Protection,
    memory: Memory,
    position_m: Scalar,
    speed_mps: Scalar,
    share: Scalar,
    ahead: TrainAhead,
) -> Scalar:
    """Distance by which the trainset ahead could be nearer and a command pass, m; negative: it does not pass.

    For drivers that follow: whoever keeps it above zero is not overruled on account of the trainset ahead.
    """
    check = CommandCheck(protection, memory, position_m, speed_mps, ahead)
    bounds = ahead.bounds
    return check.least_gap(ahead, share, 0.0 * speed_mps) - bounds.margin_m - bounds.room_m


def approach_margin(protection: Protection, acceleration_mps2: Scalar) -> Scalar:
    """Margin under the permitted speed that a trainset needs which still accelerates, m/s.

    Until the emergency brake acts the acceleration goes on, and it may be that of the lightest trainset.
    """
    xp = namespace(protection.start_m, acceleration_mps2)

    def margin(rates: Rates) -> Scalar:
        most = xp.maximum(acceleration_mps2, 0.0) * (rates.mass_high / rates.mass_low)
        return most * rates.reaction_s + 0.5 * most * most / rates.jerk_mps3

    return xp.maximum(margin(protection.rates), margin(protection.service_rates))


def passing_share(
    protection: Protection,
    position_m: Scalar,
    speed_mps: Scalar,
    permitted_mps: Scalar,
    late_s: Scalar,
    drag_mps2: Scalar,
) -> Scalar:
    """Largest traction, 0 to 1, with which a trainset stays under the limits of the line.

    Protection reckons with the lightest trainset, and with no climb where the brakes are controlled: a heavy
    one that accelerates little on a climb may ask for more than passes. For drivers that come up to a limit.

    Args:
        protection: Curves and bounds.
        position_m: Position.
        speed_mps: Measured speed.
        permitted_mps: Permitted speed here, or a lower one to come.
        late_s: Time after which a lower command acts.
        drag_mps2: Resistance and gradient of the trainset.
    """
    xp = namespace(protection.start_m, position_m, speed_mps)
    node, way = on_grid(protection, position_m)
    lower_mps = _interpolate(protection.permitted_mps, node, way) - permitted_mps

    def share(rates: Rates, curve: Array, pulls: Array) -> Scalar:
        push, _, coast = fastest(
            protection.vehicle, rates, speed_mps, xp.maximum(pulls[node], pulls[node + 1])
        )
        top_mps = (2.0 * _interpolate(curve, node, way)) ** 0.5 - lower_mps - EXPECTED_MPS
        # until a lower command acts the trainset gains what it has over its drag, at most
        room = top_mps - speed_mps - rates.speed_error_mps + late_s * (coast + drag_mps2)
        room, time_s = xp.maximum(room, 0.0), rates.reaction_s + late_s
        rise = 2.0 * room / (time_s + (time_s * time_s + 2.0 * room / rates.jerk_mps3) ** 0.5)
        return (rise - coast) / xp.maximum(push, 1e-6)

    worst = share(protection.rates, protection.emergency, protection.pull_mps2)
    usual = share(protection.service_rates, protection.service, protection.usual_pull_mps2)
    return xp.clip(xp.minimum(worst, usual), 0.0, 1.0)


def on_grid(protection: Protection, position_m: Scalar) -> tuple[Index, Scalar]:
    """The last node not beyond a position, and the share of the way to the next."""
    xp = namespace(protection.start_m, position_m)
    last = protection.emergency.shape[0] - protection.ahead.shape[0] - 2.0
    steps = (position_m - protection.start_m) / protection.spacing_m
    if last <= 0.0 and xp is not scalars:
        return 0, xp.clip(steps, 0.0, 1.0)
    whole = xp.clip(steps // 1.0, 0.0, last)
    share = xp.clip(steps - whole, 0.0, 1.0)
    return (int(whole) if xp is scalars else whole.astype(np.int32)), share


def _interpolate(values: Array, node: Array, share: Array) -> Array:
    return values[node] + (values[node + 1] - values[node]) * share


def _like(value: Scalar, whole: Scalar) -> Scalar:
    return whole if isinstance(whole, int) else whole.astype(value.dtype)


def _as_count(value: Scalar) -> Scalar:
    return value.astype(np.int32) if hasattr(value, "astype") else np.int32(value)
