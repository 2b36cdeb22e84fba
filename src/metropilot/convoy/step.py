"""One control period of one trainset of a convoy: message, protection, motion. NumPy and JAX."""

from __future__ import annotations

from typing import Any, NamedTuple, no_type_check

from metropilot._typing import Array
from metropilot.convoy.model import FAR_M, Channel, Member, Message, open_channel, transmit
from metropilot.convoy.plan import MotionPlan, plan_at
from metropilot.physics import Command, State, at_rest, delay_steps, namespace, resistance_and_gradient
from metropilot.protection import Memory as Watched
from metropilot.protection import TrainAhead, at_start, passing_share, spare_gap
from metropilot.sim import NEVER_ENDS, PeriodRecord, RunParams, control_period, first_state

LIMIT_S = 1.0
"""Time constant with which a speed above the permitted one is given up."""
UNDER_MPS = 0.05
"""Margin of a follower below the permitted speed."""
UNLIMITED_MPS = 1e3
"""Permitted speed of a trainset without protection."""
SPARE_M, SPARE_SHARE, SILENT_S = 0.2, 0.1, 0.4
"""Margins beyond the gap that protection needs: distance, command, and age of messages on a lossy link."""
HALF = 0.5
"""Command between coasting and full traction at which the needed gap is evaluated too."""
EASE_M = 2.0
"""Lack of gap at which a follower brakes fully."""
REACTION_S = 1.0
"""Time during which a higher speed takes gap before a brake acts."""
SHOWS_LAGS = 2.3
"""Lags after its dead time until a command shows, to 90 %."""
FADING_MPS, LONG_M, FADING_S = 0.1, 10.0, 2.0
"""Decay of the needed gap: a constant rate, and a time constant for what exceeds a long gap."""


class NeededGaps(NamedTuple):
    """Gaps that protection needs now to pass commands, by the trainset ahead. All 0-d.

    Attributes:
        on_its_way: Largest command that may still be on its way, in [0, 1]; one that is no larger needs as
            much as 0 does.
        coasting_m: Gap for a command of 0.
        half_m: Gap for a command of ``HALF``.
        pulling_m: Gap for a command of 1.
    """

    on_its_way: Array
    coasting_m: Array
    half_m: Array
    pulling_m: Array


class MemberState(NamedTuple):
    """State of one trainset of a convoy.

    Attributes:
        plant: State of the plant.
        measured_mps: Speed as measured for the coming period.
        watched: Protection's memory; None: no protection.
        channel: Link from the trainset ahead.
        wanted: Last command of its driver.
        command: Last command after protection.
        emergency: True if the emergency brake was demanded last.
        needed_gap_m: Gap that protection needs behind the trainset ahead: recent maximum, decaying.
        needs: Gaps that it needs now to pass commands.
    """

    plant: State
    measured_mps: Array
    watched: Watched | None
    channel: Channel
    wanted: Array
    command: Array
    emergency: Array
    needed_gap_m: Array
    needs: NeededGaps


class FollowerObservation(NamedTuple):
    """Observation of a follower; the trainset ahead is extrapolated from its last message. Mostly 0-d.

    Attributes:
        time_s: Time since departure.
        position_m: Own front.
        speed_mps: Own speed as measured.
        acceleration_mps2: Own acceleration over the last period.
        command: Own last command, after protection.
        vehicle: Nominal plant.
        track: The section.
        gap_m: Extrapolated gap to the trainset ahead.
        desired_gap_m: Desired gap.
        wanted_gap_m: Desired gap, or the gap that protection has needed lately if that is larger.
        needs: Gaps that protection needs now to pass commands, with a margin.
        speed_error_mps: Largest error of the measured speed that protection allows for.
        held_mps2: Deceleration that it counts on: the gap needed grows by the own speed over it for each m/s.
        ahead_mps: Extrapolated speed of the trainset ahead.
        ahead_mps2: Its acceleration in the last message.
        ahead_loses_mps: Speed that it plans to lose until a command given now shows; 0 without its plan.
        age_s: Age of the last message.
        alarm: 1 if the trainset ahead reported an emergency brake, else 0.
        permitted_mps: Speed that protection permits for line limits.
        most_rise_mps2: Largest acceleration that it passes for them here.
        most_share: Largest traction that it passes for them here, 0 to 1.
        period_s: Control period.
        most_mps2: Total deceleration that the own brakes are controlled to.
        plan: Own planned motion; None: the trainset ahead sends none.
        plan_number: Number of that plan, which rises with every new one.
        off_m: Departure of the trainset ahead from its plan at the time of its message: of its position.
        off_mps: The same of its speed.
        off_mps2: The same of its acceleration.
    """

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    command: Array
    vehicle: Any
    track: Any
    gap_m: Array
    desired_gap_m: Array
    wanted_gap_m: Array
    needs: NeededGaps
    speed_error_mps: Array
    held_mps2: Array
    ahead_mps: Array
    ahead_mps2: Array
    ahead_loses_mps: Array
    age_s: Array
    alarm: Array
    permitted_mps: Array
    most_rise_mps2: Array
    most_share: Array
    period_s: Array
    most_mps2: Array
    plan: MotionPlan | None
    plan_number: Array
    off_m: Array
    off_mps: Array
    off_mps2: Array


class Plans(NamedTuple):
    """Planned motions that a follower knows.

    Attributes:
        ahead: That of the trainset ahead, of its rear.
        own: Its own.
        number: Number of its own plan.
        number_ahead: Number of that of the trainset ahead.
    """

    ahead: MotionPlan
    own: MotionPlan
    number: Array
    number_ahead: Array


def make_message(member: Member, state: MemberState, now_s: Array) -> Message:
    """Make the message that a trainset sends now."""
    plant = state.plant
    xp = namespace(plant.position_m, now_s)
    return Message(
        stamp_s=now_s,
        rear_m=plant.position_m - member.length_m,
        speed_mps=state.measured_mps,
        acceleration_mps2=plant.acceleration_mps2,
        command=state.command,
        emergency=xp.where(state.emergency, 1.0, 0.0),
    )


def at_departure(
    member: Member,
    ahead: Member | None,
    dt: float,
    position_m: float | None = None,
    speed_mps: float = 0.0,
    delay_s: float = 0.0,
) -> MemberState:
    """State of a trainset at departure, or at the same steady speed as the one ahead (NumPy).

    Args:
        member: The trainset.
        ahead: The one ahead; None for the head.
        dt: Control period.
        position_m: Position of its front; None: that at departure.
        speed_mps: Speed of both.
        delay_s: Largest dead time in addition to the vehicle's that a batch may draw.
    """
    at = float(member.start_m) if position_m is None else position_m
    kind = member.start_m.dtype.type
    slots = delay_steps(float(member.vehicle.delay_s) + delay_s, dt)
    plant = at_rest(member.vehicle, delay_steps=slots, position_m=at, speed_mps=speed_mps)
    rear = kind(FAR_M) if ahead is None else kind(at + member.start_m * 0.0)
    if ahead is not None:
        rear = kind(at - member.start_m + ahead.start_m - ahead.length_m)
    zero = kind(0.0)
    first = Message(zero, rear, kind(0.0 if ahead is None else speed_mps), zero, zero, zero)
    watched = None if member.protection is None else at_start(member.protection)
    return MemberState(
        plant,
        plant.speed_mps,
        watched,
        open_channel(first),
        zero,
        zero,
        member.is_head & False,
        zero,
        NeededGaps(zero, zero, zero, zero),
    )


def receive_message(member: Member, state: MemberState, message: Message, luck: Array) -> MemberState:
    """Send ``message`` of the trainset ahead over the link and receive what has arrived."""
    return state._replace(channel=transmit(state.channel, member.link, message, luck))


def ahead_of(member: Member, state: MemberState, now_s: Array) -> TrainAhead:
    """Last message of the trainset ahead, for protection."""
    message = state.channel.heard
    return TrainAhead(
        rear_m=message.rear_m,
        speed_mps=message.speed_mps,
        acceleration_mps2=message.acceleration_mps2,
        age_s=now_s - message.stamp_s,
        bounds=member.bounds,
    )


class Extrapolated(NamedTuple):
    """Motion of the trainset ahead now, as its last message has it. All 0-d."""

    rear_m: Array
    speed_mps: Array
    acceleration_mps2: Array


@no_type_check
def extrapolate(message: Message, now_s: Array) -> Extrapolated:
    """Extrapolate a message to now at a constant acceleration, no further than to the standstill."""
    a, v, age = message.acceleration_mps2, message.speed_mps, now_s - message.stamp_s
    xp = namespace(message.rear_m, now_s)
    # A trainset that brakes does not roll back.
    stands = xp.where(a < 0.0, v / xp.maximum(-a, 1e-6), 1e9)
    t = xp.minimum(age, stands)
    return Extrapolated(
        message.rear_m + t * (v + 0.5 * a * t), xp.maximum(v + a * t, 0.0), xp.where(age < stands, a, 0.0)
    )


@no_type_check
def update_needed_gap(member: Member, state: MemberState, now_s: Array, period_s: Array) -> MemberState:
    """Update the gap that protection needs to pass the last command again: rises at once, decays slowly."""
    if member.protection is None:
        return state
    plant, ahead = state.plant, ahead_of(member, state, now_s)
    xp = namespace(plant.position_m, now_s)
    unsure = (member.link.loss > 0.0) | (member.link.jitter_s > 0.0)
    ahead = ahead._replace(age_s=ahead.age_s + xp.where(unsure, SILENT_S, 0.0))
    rear = extrapolate(state.channel.heard, now_s).rear_m
    zero = 0.0 * state.command

    @no_type_check
    def gap_needed_for(share: Array) -> Array:
        spare = spare_gap(
            member.protection, state.watched, plant.position_m, state.measured_mps, share, ahead
        )
        return xp.clip(rear - plant.position_m - spare + SPARE_M, 0.0, FAR_M)

    recent = state.watched.recent
    on_its_way = zero if recent.shape[0] == 1 else xp.clip(recent[:-1].max(), 0.0, 1.0)
    # The gap needed grows with a command, and more and more: between two it is no more than their mean.
    coasting_m, pulling_m, half_m = (gap_needed_for(zero + part) for part in (0.0, 1.0, HALF))
    share = xp.clip(state.command + SPARE_SHARE, 0.0, 1.0)
    now_m = coasting_m + share / HALF * (half_m - coasting_m)
    now_m = xp.maximum(now_m, pulling_m - (1.0 - share) / (1.0 - HALF) * (pulling_m - half_m))
    now_m = xp.where(member.is_head, 0.0, now_m)
    rate = FADING_MPS + xp.maximum(state.needed_gap_m - LONG_M, 0.0) / FADING_S
    faded_m = state.needed_gap_m - rate * period_s
    return state._replace(
        needed_gap_m=xp.maximum(now_m, faded_m),
        needs=NeededGaps(on_its_way, coasting_m, half_m, pulling_m),
    )


@no_type_check
def gap_per_mps(speed_mps: Array, held_mps2: Array) -> Array:
    """Growth of the gap that protection needs with the own speed, m for each m/s."""
    return speed_mps / held_mps2 + REACTION_S


@no_type_check
def most_within(gap_m: Array, gaps_m: tuple[Array, ...], values: tuple[Array, ...]) -> Array:
    """Largest value for which a gap is enough, by chords between the gaps that three values need."""
    xp = namespace(gap_m, gaps_m[0])
    (low_m, middle_m, high_m), (low, middle, high) = gaps_m, values
    below = low + (middle - low) * (gap_m - low_m) / xp.maximum(middle_m - low_m, 1e-3)
    above = middle + (high - middle) * (gap_m - middle_m) / xp.maximum(high_m - middle_m, 1e-3)
    return xp.where(gap_m < middle_m, below, above)


@no_type_check
def most_share(needs: NeededGaps, gap_m: Array) -> Array:
    """Largest command that protection passes at a gap, by the gaps that a few commands need.

    The chord from 0 to 1 alone lies up to metres above what a command between them needs.
    """
    xp = namespace(gap_m, needs.coasting_m)
    first, coasting_m, half_m = needs.on_its_way, needs.coasting_m, needs.half_m
    gaps_m = coasting_m, half_m, needs.pulling_m
    passed = most_within(gap_m, gaps_m, (first, xp.maximum(HALF, first), 1.0))
    passed = xp.where(gap_m < coasting_m, (gap_m - coasting_m) / EASE_M, passed)
    return xp.where(needs.pulling_m <= 0.0, 1.0, xp.clip(passed, -1.0, 1.0))


@no_type_check
def rise_under(member: Member, room_mps: Array) -> Array:
    """Largest acceleration at a distance below the permitted speed that protection passes.

    Above the permitted speed it is negative. What accelerates goes on until a brake acts: it inverts
    :func:`metropilot.protection.approach_margin`, with the own dead time, lag and jerk limit.
    """
    believed = member.believed
    xp = namespace(room_mps, believed.delay_s)
    late_s, quadratic = believed.delay_s + believed.lag_s, 0.5 / xp.minimum(believed.jerk_mps3, 1e6)
    if member.protection is None:
        reaction_s = LIMIT_S + late_s
    else:
        rates, usual = member.protection.rates, member.protection.service_rates
        ratio = rates.mass_high / rates.mass_low
        reaction_s = ratio * (xp.maximum(rates.reaction_s, usual.reaction_s) + late_s)
        quadratic = quadratic + 0.5 * ratio * ratio / xp.minimum(rates.jerk_mps3, usual.jerk_mps3)
    room = room_mps - UNDER_MPS
    above = xp.maximum(room, 0.0)
    rise = 2.0 * above / (reaction_s + (reaction_s * reaction_s + 4.0 * quadratic * above) ** 0.5)
    return xp.where(room < 0.0, room / LIMIT_S, rise)


@no_type_check
def share_under(member: Member, state: MemberState, permitted_mps: Array) -> Array:
    """Largest traction of a trainset that protection passes for the limits of the line, 0 to 1."""
    believed, plant = member.believed, state.plant
    if member.protection is None:
        return 1.0 + 0.0 * permitted_mps
    forces_n = resistance_and_gradient(believed, member.track, plant.position_m, state.measured_mps)
    return passing_share(
        member.protection,
        plant.position_m,
        state.measured_mps,
        permitted_mps,
        believed.delay_s + believed.lag_s,
        sum(forces_n) / believed.effective_mass_kg,
    )


@no_type_check
def observe_member(
    member: Member,
    state: MemberState,
    now_s: Array,
    period_s: Array,
    permitted_mps: Array,
    plans: Plans | None = None,
) -> FollowerObservation:
    """Observation of the driver of a trainset; for the head, with a trainset far ahead.

    Args:
        member: The trainset.
        state: Its state.
        now_s: Time since departure.
        period_s: Control period.
        permitted_mps: Speed that protection permits.
        plans: Planned motions that it knows; None: none.
    """
    plant, message = state.plant, state.channel.heard
    xp = namespace(plant.position_m, message.rear_m)
    now = extrapolate(message, now_s)
    rear = now.rear_m
    apart = plant.position_m >= member.uncouple_at_m
    desired_m, zero = xp.where(apart, member.apart_m, member.gap_m), 0.0 * rear
    off, loses_mps = (zero, zero, zero), zero
    if plans is not None:
        planned = plan_at(plans.ahead, message.stamp_s)
        then = plan_at(plans.ahead, now_s + member.believed.delay_s + SHOWS_LAGS * member.believed.lag_s)
        loses_mps = xp.maximum(plan_at(plans.ahead, now_s).speed_mps - then.speed_mps, 0.0)
        before = plan_at(plans.ahead, message.stamp_s - period_s)
        off = (
            message.rear_m - planned.position_m,
            message.speed_mps - planned.speed_mps,
            message.acceleration_mps2 - before.acceleration_mps2,
        )
    return FollowerObservation(
        time_s=now_s,
        position_m=plant.position_m,
        speed_mps=state.measured_mps,
        acceleration_mps2=plant.acceleration_mps2,
        command=state.command,
        vehicle=member.believed,
        track=member.track,
        gap_m=rear - plant.position_m,
        desired_gap_m=desired_m,
        wanted_gap_m=xp.maximum(desired_m, state.needed_gap_m),
        needs=state.needs,
        speed_error_mps=zero if member.protection is None else member.protection.rates.speed_error_mps,
        held_mps2=member.bounds.held_mps2,
        ahead_mps=now.speed_mps,
        ahead_mps2=now.acceleration_mps2,
        ahead_loses_mps=loses_mps,
        age_s=now_s - message.stamp_s,
        alarm=message.emergency,
        permitted_mps=permitted_mps,
        most_rise_mps2=rise_under(member, permitted_mps - state.measured_mps),
        most_share=share_under(member, state, permitted_mps),
        period_s=period_s,
        most_mps2=member.most_mps2,
        plan=None if plans is None else plans.own,
        plan_number=zero if plans is None else plans.number,
        off_m=off[0],
        off_mps=off[1],
        off_mps2=off[2],
    )


@no_type_check
def drive_period(
    member: Member, state: MemberState, command: Command, now_s: Array, period_s: Array, noise: Array = 0.0
) -> tuple[MemberState, PeriodRecord]:
    """One control period of one trainset of the convoy (:func:`metropilot.sim.control_period`).

    Args:
        member: The trainset.
        state: Its state.
        command: Command of its driver, who may ask for the emergency brake.
        now_s: Time since departure.
        period_s: Control period.
        noise: Error of the speed measured at the end, in standard deviations.
    """
    params = RunParams(
        vehicle=member.vehicle,
        track=member.track,
        protection=member.protection,
        length_m=member.track.length_m,
        scheduled_s=now_s,
        speed_noise_mps=member.speed_noise_mps,
        dt=period_s,
        most_mps2=member.most_mps2,
    )
    ahead = None if member.protection is None else ahead_of(member, state, now_s)
    run, _, record = control_period(
        params,
        first_state(state.plant, state.watched)._replace(measured_mps=state.measured_mps),
        None,
        lambda _, __: (command, None),
        rule=NEVER_ENDS,
        noise=noise,
        ahead=ahead,
    )
    reached = state._replace(
        plant=run.plant,
        measured_mps=run.measured_mps,
        watched=run.supervision,
        wanted=command.share,
        command=record.command.share,
        emergency=record.command.emergency,
    )
    return reached, record
