"""Declaration of a convoy, its link, and its trainsets as arrays: one row per trainset, the head first."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Literal, NamedTuple, get_args

import numpy as np

from metropilot._schema import CheckedFields, FieldSpec, Range, check_fields, declare
from metropilot._typing import Array
from metropilot.errors import InputError
from metropilot.physics import Track, Vehicle, effort_at, namespace, track_arrays, vehicle_arrays
from metropilot.protection import Bounds, PairBounds, Protection, Separation, protect, separate
from metropilot.railway import Section, Steps, Trainset
from metropilot.sim import Disturbance, Run, declared_bounds

SLOTS = 32
"""Largest number of messages in flight: one per control period."""
EARLY_S = 1e-4


@dataclass(frozen=True)
class Link(CheckedFields):
    """Quality of the link. Messages are sent once per control period.

    Command line and HTTP put ``link`` before the names: the disturbance of a trainset has a delay too.

    Attributes:
        delay_s: Constant delay of every message.
        jitter_s: Largest additional delay, uniformly distributed.
        loss: Share of messages that never arrive.
        silent_from_s: Time from which all messages are lost (infinite: never).
    """

    delay_s: float = declare(
        0.0,
        "Time a message takes.",
        unit="s",
        low=0.0,
        high=2.0,
        option="link-delay",
        label="Delay",
        step=0.1,
    )
    jitter_s: float = declare(
        0.0,
        "Largest additional time.",
        unit="s",
        low=0.0,
        high=1.0,
        option="link-jitter",
        label="Jitter",
        step=0.1,
    )
    loss: float = declare(
        0.0, "Share of messages lost.", low=0.0, high=1.0, option="link-loss", label="Lost", step=0.05
    )
    silent_from_s: float = declare(
        float("inf"),
        "Time from which all messages are lost.",
        unit="s",
        low=0.0,
        infinite=True,
        option="link-silent-from",
    )

    def numbers(self, dtype: type = np.float64) -> LinkQuality:
        """The link as numbers."""
        return LinkQuality(
            dtype(self.delay_s), dtype(self.jitter_s), dtype(self.loss), dtype(self.silent_from_s)
        )


class LinkQuality(NamedTuple):
    """A :class:`Link` as numbers. All 0-d."""

    delay_s: Array
    jitter_s: Array
    loss: Array
    silent_from_s: Array


class Message(NamedTuple):
    """Message of a trainset to the one behind it. All of one shape.

    Attributes:
        stamp_s: Time of measurement.
        rear_m: Position of the rear.
        speed_mps: Speed.
        acceleration_mps2: Acceleration over the period before.
        command: Command that reached the trainset in the period before.
        emergency: 1 while the emergency brake is demanded, else 0.
    """

    stamp_s: Array
    rear_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    command: Array
    emergency: Array


class Channel(NamedTuple):
    """One direction of the link, on its receiving side.

    Attributes:
        sent: Messages in flight, newest first. Shape (SLOTS,) each.
        due_s: Arrival time of each; infinite: never. Shape (SLOTS,).
        heard: The newest message that has arrived. Shape () each.
    """

    sent: Message
    due_s: Array
    heard: Message


def open_channel(first: Message) -> Channel:
    """Make a channel that has delivered one message (NumPy; shapes ())."""
    sent = Message(*(np.repeat(np.asarray(value)[None], SLOTS, axis=0) for value in first))
    return Channel(sent, np.full(SLOTS, np.inf, np.asarray(first.stamp_s).dtype), first)


def transmit(channel: Channel, quality: LinkQuality, message: Message, luck: Array) -> Channel:
    """Send one message and receive what has arrived by now.

    Args:
        channel: The channel.
        quality: Quality of the link.
        message: Message with measurements of now.
        luck: Two random numbers from [0, 1): for the loss and for the jitter of this message. Shape (2,).
    """
    xp = namespace(channel.due_s, message.stamp_s, luck)
    now = message.stamp_s
    lost = (luck[0] < quality.loss) | (now >= quality.silent_from_s)
    due = xp.where(lost, float("inf"), now + quality.delay_s + quality.jitter_s * luck[1])

    def push(values: Array, newest: Array) -> Array:
        first = xp.expand_dims(xp.asarray(newest, dtype=values.dtype), 0)
        return xp.concatenate([first, values[:-1]])

    sent = Message(*(push(values, newest) for values, newest in zip(channel.sent, message, strict=True)))
    due_s = push(channel.due_s, due)
    arrived = due_s <= now + EARLY_S
    newest = xp.argmax(arrived)
    fresh = xp.any(arrived) & (sent.stamp_s[newest] > channel.heard.stamp_s)
    heard = Message(
        *(xp.where(fresh, values[newest], old) for values, old in zip(sent, channel.heard, strict=True))
    )
    return Channel(sent, due_s, heard)


ConvoyGuard = Literal["coupled", "independent", "moving_block", "none"]
GUARDS: tuple[ConvoyGuard, ...] = get_args(ConvoyGuard)
CONVOY_PERIOD_S = 0.1
"""Control period of a convoy. The gap error that a PID on the speed difference leaves grows with it."""
GAP_M = 5.92
"""Chen23b table 1: initial gap."""
HEAD_MPS2, TAIL_MPS2, STEP_MPS2, LEAST_STEP_MPS2 = 0.8, 1.15, 0.35, 0.02
"""Brake rates of a coupled convoy at head and tail, largest and least step between trainsets. Each rate is
above that of the trainset ahead, so that every trainset can brake harder than the one ahead. Our choice."""
TRAINSETS = FieldSpec(
    "How many trainsets.", range=Range(2, 16), option="trainsets", label="Trainsets", step=1.0
)
FAR_M = 1e6
LEADER_SHARE = 0.95
"""Share that the head uses, so that the others can follow: of its traction, of the rate of its brake, and of
the least acceleration in the convoy, 1 m/s^2 at most."""
BRAKE_SHARE, STOPPING_MPS = 0.85, 5.0
"""Share of the weakest service brake of a convoy that the head uses; the speed at which it is asked for."""


@dataclass(frozen=True, kw_only=True)
class ConvoySettings:
    """Gaps, link, assumption of protection and disturbances: what a convoy and its request have in common.

    Attributes:
        gap_m: Desired gap, rear of one to front of the next.
        start_gap_m: Gap at departure; None: the desired one.
        apart_m: Desired gap once uncoupled.
        uncouple_at_m: Place of uncoupling: when the front of a trainset arrives there, a follower with a plan
            has opened its gap to ``apart_m``, and another begins to (infinite: nowhere).
        link: Link from each trainset to the next.
        guard: Assumption of protection: ``coupled`` (brakes controlled to rates that rise along the
            convoy), ``independent`` (no brake is stronger than declared, gradients included),
            ``moving_block`` (the trainset ahead may stop instantly), ``none``.
        disturbances: One of each trainset, or one for all; empty: none. Timetable updates are the head's.
    """

    gap_m: float = declare(
        GAP_M, "Desired gap.", unit="m", low=0.5, high=2000.0, label="Desired gap", step=1.0
    )
    start_gap_m: float | None = declare(
        None, "Gap at departure: the convoy couples on the move.", unit="m", low=0.5, high=5000.0
    )
    apart_m: float = declare(100.0, "Desired gap once uncoupled.", unit="m", low=0.5, high=2000.0)
    uncouple_at_m: float = declare(
        float("inf"),
        "Where the gap behind a trainset is open when it arrives; a follower without a plan begins then.",
        unit="m",
        low=0.0,
        infinite=True,
    )
    link: Link = field(default_factory=Link)
    guard: str = declare("coupled", f"What protection relies on: {', '.join(GUARDS)}.", choices=GUARDS)
    disturbances: tuple[Disturbance, ...] = ()


@dataclass(frozen=True)
class Convoy(ConvoySettings):
    """Declaration of a convoy.

    Attributes:
        section: Section; the movement authority of a convoy has no end, whatever the section's has.
        trainsets: Nominal trainsets with their loads, head first.
        allowed: Disturbances that protection allows for besides those that act.
        dt: Control period, s.
    """

    section: Section
    trainsets: tuple[Trainset, ...]
    allowed: tuple[Disturbance, ...] = ()
    dt: float = CONVOY_PERIOD_S

    def __post_init__(self) -> None:
        check_fields(self)
        # Coupled trainsets are guaranteed no harder brake than they stop with: an end of the authority
        # behind the stop would disturb the stop itself. Protection and driver of the head must agree on it.
        object.__setattr__(self, "section", replace(self.section, authority=None))
        count, given = len(self.trainsets), len(self.disturbances)
        TRAINSETS.check("trainsets", count)
        if given not in {0, 1, count}:
            raise InputError(
                "one for all, or one of each trainset",
                field="disturbances",
                value=given,
                allowed=f"1 or {count}",
            )
        if any(each.updates not in {(), self.disturbances[0].updates} for each in self.disturbances):
            raise InputError("timetable updates are those of the head", field="disturbances")
        if np.isfinite(self.uncouple_at_m) and self.uncouple_at_m >= self.section.length_m:
            raise InputError(
                "not before the stop",
                field="uncouple_at_m",
                value=f"{self.uncouple_at_m:g}",
                unit="m",
                allowed=f"below {self.section.length_m:g} m",
            )
        if np.isfinite(self.uncouple_at_m) and self.apart_m <= self.gap_m:
            raise InputError(
                "no wider than the gap while coupled",
                field="apart_m",
                value=self.apart_m,
                unit="m",
                allowed=f"above {self.gap_m:g} m",
            )

    def disturbance(self, k: int) -> Disturbance:
        """Disturbance of one trainset."""
        if not self.disturbances:
            return Disturbance()
        return self.disturbances[min(k, len(self.disturbances) - 1)]

    @property
    def first_gap_m(self) -> float:
        """Gap at departure."""
        return self.gap_m if self.start_gap_m is None else self.start_gap_m

    @property
    def starts_m(self) -> tuple[float, ...]:
        """Position of the front of each trainset at departure, the head at 0."""
        found = [0.0]
        for trainset in self.trainsets[:-1]:
            found.append(found[-1] - trainset.length_m - self.first_gap_m)
        return tuple(found)

    @property
    def rates_mps2(self) -> tuple[float, ...]:
        """Rate to which the brakes of each trainset are controlled; infinite where they are not.

        What the weakest emergency brake holds on the steepest fall is the most: behind a trainset that may
        brake harder than the own brake surely does, protection's gap grows with the speed squared.
        """
        count = len(self.trainsets)
        if self.guard != "coupled":
            return (float("inf"),) * count
        tail = min(TAIL_MPS2, *(self._held_mps2(k) for k in range(count)))
        head = min(HEAD_MPS2, max(tail - LEAST_STEP_MPS2 * (count - 1), 0.5 * tail))
        step = min(STEP_MPS2, (tail - head) / (count - 1))
        return tuple(head + step * k for k in range(count))

    def _held_mps2(self, k: int) -> float:
        """Deceleration that the emergency brake of a trainset gives on the steepest fall of the section."""
        trainset = self.disturbance(k).nominal(self.trainsets[k])
        fall = max(-1e-3 * float(self.section.gradient_permil.value.min()), 0.0)
        return trainset.safe_braking.emergency_deceleration_mps2 - fall * trainset.gravity_mps2

    @property
    def cleared_after_m(self) -> float:
        """Distance for which a limit still holds for the head, until the tail of the last has cleared it."""
        if self.guard != "coupled":
            return 0.0
        return -self.starts_m[-1] + self.trainsets[-1].length_m - self.trainsets[0].length_m

    def leader(self) -> tuple[Section, Trainset]:
        """Section and trainset for the driver of the head.

        A limit holds until the tail of the last trainset has cleared it. In a coupled convoy the head uses
        only a part of its efforts, so that the others can follow.
        """
        section, head = extend_limits(self.section, self.cleared_after_m), self.trainsets[0]
        if self.guard != "coupled":
            return section, head
        # Whoever follows needs more brake and more acceleration than the head uses, and may be heavier.
        rate = self.rates_mps2[0]
        brake = min(LEADER_SHARE * rate, BRAKE_SHARE * min(map(service_brake_mps2, self.trainsets)))
        pull = LEADER_SHARE * min(1.0, *(each.max_acceleration_mps2 for each in self.trainsets))
        safe = replace(
            head.safe_braking,
            emergency_deceleration_mps2=min(head.safe_braking.emergency_deceleration_mps2, rate),
            service_deceleration_mps2=min(head.safe_braking.service_deceleration_mps2, brake),
        )
        return section, replace(
            head, safe_braking=safe, max_acceleration_mps2=pull, max_deceleration_mps2=brake
        )

    def coupled_trainsets(self) -> tuple[tuple[Trainset, float], ...]:
        """Nominal trainsets that a coupled head plans for too, and their distances behind it."""
        if self.guard != "coupled":
            return ()
        known = [self.disturbance(k).nominal(each) for k, each in enumerate(self.trainsets)]
        return tuple((each, -start) for each, start in zip(known, self.starts_m, strict=True))[1:]


def service_brake_mps2(trainset: Trainset) -> float:
    """Deceleration of the full service brake on the level before a stop, without resistance."""
    vehicle = vehicle_arrays(trainset)
    brake_n = float(effort_at(vehicle, np.float64(STOPPING_MPS)).brake_n)
    return min(trainset.max_deceleration_mps2, brake_n / float(vehicle.effective_mass_kg))


def extend_limits(section: Section, extra_m: float) -> Section:
    """Extend every speed limit of a section forwards by a distance."""
    limit = section.limit_mps
    edges = np.unique(np.concatenate([limit.from_m, limit.from_m + extra_m]))
    first = np.maximum(np.searchsorted(limit.from_m, edges - extra_m, side="right") - 1, 0)
    last = np.maximum(np.searchsorted(limit.from_m, edges, side="right") - 1, 0)
    values = np.array([limit.value[a : b + 1].min() for a, b in zip(first, last, strict=True)])
    return replace(section, limit_mps=Steps(edges, values))


class Member(NamedTuple):
    """One trainset of a convoy as arrays. Fields are 0-d unless they are tuples of arrays.

    Attributes:
        vehicle: True plant.
        believed: Nominal plant.
        track: Track under it.
        protection: Its protection; None: it has none.
        bounds: Bounds on the trainset ahead and on its own emergency brake.
        most_mps2: Rate to which its brakes are controlled.
        speed_noise_mps: Standard deviation of its measured speed.
        link: The link from the trainset ahead.
        length_m: Length.
        start_m: Position of its front at departure.
        gap_m: Desired gap to the trainset ahead.
        first_gap_m: Gap at departure.
        apart_m: Desired gap once uncoupled.
        uncouple_at_m: Position of its front from which the uncoupled gap is desired.
        is_head: True for the head.
    """

    vehicle: Vehicle
    believed: Vehicle
    track: Track
    protection: Protection | None
    bounds: Separation
    most_mps2: Array
    speed_noise_mps: Array
    link: LinkQuality
    length_m: Array
    start_m: Array
    gap_m: Array
    first_gap_m: Array
    apart_m: Array
    uncouple_at_m: Array
    is_head: Array


def convoy_members(convoy: Convoy, dtype: type = np.float64) -> tuple[Member, ...]:
    """Make the arrays of every trainset of a convoy (NumPy), the head first.

    Raises:
        InputError: A trainset's emergency brake does not hold it on the section.
    """
    return tuple(convoy_member(convoy, k, dtype) for k in range(len(convoy.trainsets)))


def convoy_member(convoy: Convoy, k: int, dtype: type = np.float64) -> Member:
    """Make the arrays of one trainset of a convoy (NumPy), counted from the head.

    Raises:
        InputError: Its emergency brake does not hold it on the section.
    """
    before_m = -convoy.starts_m[-1] + 50.0
    disturbance, rates = convoy.disturbance(k), convoy.rates_mps2
    trainset = disturbance.nominal(convoy.trainsets[k])
    section = convoy.leader()[0] if k == 0 else convoy.section
    guard = None
    if convoy.guard != "none":
        guard = protect(section, trainset, member_bounds(convoy, k), dtype=dtype, before_m=before_m)
    fall = 0.0 if guard is None else float(guard.pull_mps2.max())
    held = min(rates[k], trainset.safe_braking.emergency_deceleration_mps2 - max(fall, 0.0))
    return Member(
        vehicle=vehicle_arrays(disturbance.true_plant(trainset), dtype),
        believed=vehicle_arrays(trainset, dtype),
        track=track_arrays(section, trainset, dtype),
        protection=guard,
        bounds=separate(pair_bounds(convoy, k), convoy.dt, held, dtype),
        most_mps2=dtype(rates[k]),
        speed_noise_mps=dtype(disturbance.speed_noise_mps),
        link=convoy.link.numbers(dtype),
        length_m=dtype(trainset.length_m),
        start_m=dtype(convoy.starts_m[k]),
        gap_m=dtype(convoy.gap_m),
        first_gap_m=dtype(convoy.first_gap_m),
        apart_m=dtype(convoy.apart_m),
        # where it is at the desired gap while the one ahead arrives at the place
        uncouple_at_m=dtype(convoy.uncouple_at_m - (k and convoy.trainsets[k - 1].length_m + convoy.gap_m)),
        is_head=np.bool_(k == 0),
    )


def _possible_disturbances(convoy: Convoy, k: int) -> tuple[Disturbance, ...]:
    return (convoy.disturbance(k), *convoy.allowed)


def member_bounds(convoy: Convoy, k: int) -> Bounds:
    """Deviations from the nominal plant of one trainset that protection allows for."""
    trainset, rate = convoy.trainsets[k], convoy.rates_mps2[k]
    runs = (Run(convoy.section, trainset, 1.0, each, convoy.dt) for each in _possible_disturbances(convoy, k))
    bounds = reduce(Bounds.hull, map(declared_bounds, runs))
    controlled = np.isfinite(rate).item()
    return replace(bounds, emergency_mps2=min(bounds.emergency_mps2, rate), controlled=controlled)


def pair_bounds(convoy: Convoy, k: int) -> PairBounds:
    """Bounds on the braking of the trainset ahead of number ``k``, and on what it says of its speed."""
    if k == 0 or convoy.guard in {"moving_block", "none"}:
        return PairBounds()
    ahead, bounds = convoy.trainsets[k - 1], member_bounds(convoy, k - 1)
    limits = [each.nominal(ahead).actuation.jerk_limit_mps3 for each in _possible_disturbances(convoy, k - 1)]
    # A brake that is controlled to a rate releases where gradient and resistance alone reach it, no further.
    rolling = resisting_mps2(convoy.section, ahead, bounds)
    rate = convoy.rates_mps2[k - 1]
    if convoy.guard == "coupled":
        strongest = max(rate, rolling)
    else:
        plants = [
            replace(each, mass_factor=1.0).true_plant(ahead) for each in _possible_disturbances(convoy, k - 1)
        ]
        strongest = rolling + max(strongest_brake_mps2(plant, bounds) for plant in plants)
    jerk = max(bounds.emergency_jerk_mps3, *limits)
    return PairBounds(strongest, jerk, speed_error_mps=bounds.speed_error_mps)


LIGHTEST, MOST_RESISTANCE = 0.8, 1.5
"""Mass and resistance over nominal that bounds on a trainset ahead allow for at least."""


def resisting_mps2(section: Section, trainset: Trainset, bounds: Bounds) -> float:
    """Largest deceleration without brakes: on the steepest climb and curve, with all resistance."""
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    climb = 1e-3 * float(section.gradient_permil.value.max())
    curve = float(track.slope[:, 1].max())
    top = trainset.max_speed_mps
    davis = float(vehicle.davis_n[0] + top * (vehicle.davis_n[1] + top * vehicle.davis_n[2]))
    light = min(LIGHTEST, bounds.mass[0]) * trainset.effective_mass_kg
    drag = max(MOST_RESISTANCE, bounds.resistance[1]) * davis / light
    return max(climb, 0.0) * trainset.gravity_mps2 + curve + drag


def strongest_brake_mps2(plant: Trainset, bounds: Bounds) -> float:
    """Deceleration under the stronger brake of a trainset as light as its bounds allow, m/s^2."""
    vehicle = vehicle_arrays(plant)
    brakes = effort_at(vehicle, np.linspace(0.0, float(vehicle.max_speed_mps), 64)).brake_n
    all_brakes = float(np.max(brakes)) / (min(LIGHTEST, bounds.mass[0]) * float(vehicle.effective_mass_kg))
    return max(
        plant.safe_braking.emergency_deceleration_mps2, min(plant.service_deceleration_mps2, all_brakes)
    )
