"""One control period of one trainset of a convoy: hear, be supervised, move. NumPy and JAX alike."""

from __future__ import annotations

from typing import Any, NamedTuple, no_type_check

from metropilot.convoy.link import Channel, Message, opened, passed_on
from metropilot.convoy.model import FAR_M, Member
from metropilot.physics import Command, State, at_rest, delay_steps, namespace
from metropilot.protection import Memory as Watched
from metropilot.protection import TrainAhead, at_start, spare_gap
from metropilot.sim import NEVER_ENDS, PeriodRecord, RunParams, control_period, first_state

Array = Any
SPARE_M, SPARE_SHARE, SILENT_S = 0.2, 0.1, 0.4
"""What a follower keeps beyond the gap that protection needs: distance, command, time without a message where
the link loses some."""
FADING_MPS, LONG_M, FADING_S = 0.1, 10.0, 2.0
"""How fast it forgets that it needed more: slowly, but what is beyond a long gap soon."""


class MemberState(NamedTuple):
    """Where one trainset of a convoy is.

    Attributes:
        plant: State of the plant.
        watched: Protection's memory; None: no protection.
        channel: Link from the trainset ahead.
        wanted: Command its driver asked for last.
        command: Command that reached it last.
        emergency: Whether its emergency brake was demanded last.
        needed_gap_m: Gap that protection needs behind the trainset ahead: the most of late, fading.
    """

    plant: State
    watched: Watched | None
    channel: Channel
    wanted: Array
    command: Array
    emergency: Array
    needed_gap_m: Array


class FollowerObservation(NamedTuple):
    """What a follower sees, the trainset ahead brought forward from its last message. All 0-d but the tuples.

    Attributes:
        time_s: Time since departure.
        position_m: Own front.
        speed_mps: Own speed.
        acceleration_mps2: Own acceleration over the last period.
        command: Own last command, as protection let it pass.
        vehicle: The trainset as its driver knows it.
        track: The section.
        gap_m: Gap to the trainset ahead, as it should be by now.
        wanted_gap_m: Gap wanted now, or what protection needs if that is more.
        ahead_mps: Speed of the trainset ahead, as it should be by now.
        ahead_mps2: Its acceleration as last heard.
        age_s: Age of the last message.
        alarm: 1 if the trainset ahead said that its emergency brake was on, else 0.
        permitted_mps: Speed that protection permits for line limits.
        period_s: Control period.
    """

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    command: Array
    vehicle: Any
    track: Any
    gap_m: Array
    wanted_gap_m: Array
    ahead_mps: Array
    ahead_mps2: Array
    age_s: Array
    alarm: Array
    permitted_mps: Array
    period_s: Array


def pipeline_slots(vehicle: Any, dt: float) -> int:  # noqa: ANN401 (a vehicle)
    """Slots for commands in the dead time (a shape: decide it outside ``jit``)."""
    return delay_steps(float(vehicle.delay_s), dt)


def told(member: Member, state: MemberState, now_s: Array) -> Message:
    """The message a trainset sends now."""
    plant = state.plant
    xp = namespace(plant.position_m, now_s)
    return Message(
        stamp_s=now_s,
        rear_m=plant.position_m - member.length_m,
        speed_mps=plant.speed_mps,
        acceleration_mps2=plant.acceleration_mps2,
        command=state.command,
        emergency=xp.where(state.emergency, 1.0, 0.0),
    )


def at_departure(
    member: Member, ahead: Member | None, dt: float, position_m: float | None = None, speed_mps: float = 0.0
) -> MemberState:
    """A trainset about to depart, or under way at the same steady speed as the one ahead (NumPy).

    Args:
        member: The trainset.
        ahead: The one ahead; None for the head.
        dt: Control period.
        position_m: Where its front is; None: where it departs.
        speed_mps: Speed of both.
    """
    at = float(member.start_m) if position_m is None else position_m
    kind = member.start_m.dtype.type
    slots = pipeline_slots(member.vehicle, dt)
    plant = at_rest(member.vehicle, delay_steps=slots, position_m=at, speed_mps=speed_mps)
    rear = kind(FAR_M) if ahead is None else kind(at + member.start_m * 0.0)
    if ahead is not None:
        rear = kind(at - member.start_m + ahead.start_m - ahead.length_m)
    zero = kind(0.0)
    first = Message(zero, rear, kind(0.0 if ahead is None else speed_mps), zero, zero, zero)
    watched = None if member.protection is None else at_start(member.protection)
    return MemberState(plant, watched, opened(first), zero, zero, member.is_head & False, zero)


def heard(member: Member, state: MemberState, message: Message, luck: Array) -> MemberState:
    """Take in what the link delivers, the trainset ahead having sent ``message`` now."""
    return state._replace(channel=passed_on(state.channel, member.link, message, luck))


def ahead_of(member: Member, state: MemberState, now_s: Array) -> TrainAhead:
    """The trainset ahead as protection is told of it."""
    message = state.channel.heard
    return TrainAhead(
        rear_m=message.rear_m,
        speed_mps=message.speed_mps,
        acceleration_mps2=message.acceleration_mps2,
        age_s=now_s - message.stamp_s,
        bounds=member.bounds,
    )


@no_type_check
def needed(member: Member, state: MemberState, now_s: Array, period_s: Array) -> MemberState:
    """Note the gap that protection needs for the last command to pass again: up at once, down slowly."""
    if member.protection is None:
        return state
    plant, ahead = state.plant, ahead_of(member, state, now_s)
    xp = namespace(plant.position_m, now_s)
    unsure = (member.link.loss > 0.0) | (member.link.jitter_s > 0.0)
    ahead = ahead._replace(age_s=ahead.age_s + xp.where(unsure, SILENT_S, 0.0))
    share = xp.minimum(state.command + SPARE_SHARE, 1.0)
    spare = spare_gap(member.protection, state.watched, plant.position_m, plant.speed_mps, share, ahead)
    now_m = xp.clip(ahead.rear_m - plant.position_m - spare + SPARE_M, 0.0, FAR_M)
    now_m = xp.where(member.is_head, 0.0, now_m)
    rate = FADING_MPS + xp.maximum(state.needed_gap_m - LONG_M, 0.0) / FADING_S
    return state._replace(needed_gap_m=xp.maximum(now_m, state.needed_gap_m - rate * period_s))


@no_type_check
def sight(
    member: Member, state: MemberState, now_s: Array, period_s: Array, permitted_mps: Array
) -> FollowerObservation:
    """What the driver of a trainset sees; for the head, a trainset far ahead."""
    plant, message = state.plant, state.channel.heard
    xp = namespace(plant.position_m, message.rear_m)
    age = now_s - message.stamp_s
    a, v = message.acceleration_mps2, message.speed_mps
    stands = xp.where(a < 0.0, v / xp.maximum(-a, 1e-6), 1e9)
    t = xp.minimum(age, stands)
    rear = message.rear_m + t * (v + 0.5 * a * t)
    apart = plant.position_m >= member.uncouple_at_m
    return FollowerObservation(
        time_s=now_s,
        position_m=plant.position_m,
        speed_mps=plant.speed_mps,
        acceleration_mps2=plant.acceleration_mps2,
        command=state.command,
        vehicle=member.believed,
        track=member.track,
        gap_m=rear - plant.position_m,
        wanted_gap_m=xp.maximum(xp.where(apart, member.apart_m, member.gap_m), state.needed_gap_m),
        ahead_mps=xp.maximum(v + a * t, 0.0),
        ahead_mps2=xp.where(age < stands, a, 0.0),
        age_s=age,
        alarm=message.emergency,
        permitted_mps=permitted_mps,
        period_s=period_s,
    )


@no_type_check
def drive_period(
    member: Member, state: MemberState, command: Command, now_s: Array, period_s: Array
) -> tuple[MemberState, PeriodRecord]:
    """One control period of one trainset of the convoy (:func:`metropilot.sim.control_period`).

    Args:
        member: The trainset.
        state: Its state.
        command: Command of its driver, who may ask for the emergency brake.
        now_s: Time since departure.
        period_s: Control period.
    """
    params = RunParams(
        vehicle=member.vehicle,
        track=member.track,
        protection=member.protection,
        length_m=member.track.length_m,
        scheduled_s=now_s,
        speed_noise_mps=0.0,
        dt=period_s,
        most_mps2=member.most_mps2,
    )
    ahead = None if member.protection is None else ahead_of(member, state, now_s)
    run, _, record = control_period(
        params,
        first_state(state.plant, state.watched),
        None,
        lambda _, __: (command, None),
        rule=NEVER_ENDS,
        ahead=ahead,
    )
    reached = state._replace(
        plant=run.plant,
        watched=run.supervision,
        wanted=command.share,
        command=record.command.share,
        emergency=record.command.emergency,
    )
    return reached, record
