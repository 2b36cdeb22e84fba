"""Declaration of a convoy, its link, and its trainsets as arrays: one row per trainset, the head first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from metropilot._typing import Array
from metropilot.errors import InputError
from metropilot.physics import Track, Vehicle, namespace, track_arrays, vehicle_arrays
from metropilot.protection import Bounds, PairBounds, Protection, Separation, protect, separate
from metropilot.railway import Section, Steps, Trainset
from metropilot.sim import MASS_SCATTER, true_vehicle

SLOTS = 32
"""Largest number of messages in flight: one per control period."""
EARLY_S = 1e-4


@dataclass(frozen=True)
class Link:
    """Quality of the link. Messages are sent once per control period.

    Attributes:
        delay_s: Constant delay of every message.
        jitter_s: Largest additional delay, uniformly distributed.
        loss: Share of messages that never arrive.
        silent_from_s: Time from which all messages are lost (infinite: never).
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    silent_from_s: float = float("inf")

    def __post_init__(self) -> None:
        for name, high, unit in (("delay_s", 2.0, "s"), ("jitter_s", 1.0, "s"), ("loss", 1.0, "")):
            value = getattr(self, name)
            if not 0.0 <= value <= high:
                allowed = f"0 to {high:g}"
                raise InputError("out of range", field=name, value=value, unit=unit, allowed=allowed)
        if not self.silent_from_s >= 0.0:
            raise InputError("out of range", field="silent_from_s", value=self.silent_from_s, allowed=">= 0")

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
HEAD_MPS2, TAIL_MPS2, STEP_MPS2 = 0.8, 1.15, 0.35
"""Brake rates of a coupled convoy at head and tail, and largest step between trainsets. Each rate is above
that of the trainset ahead, so that every trainset can brake harder than the one ahead. Our choice."""
MOST_TRAINSETS = 16
FAR_M = 1e6
LEADER_SHARE = 0.85
"""Share of its brake and of 1 m/s^2 that the head uses in service, so that the others can follow."""


@dataclass(frozen=True)
class Convoy:
    """Declaration of a convoy: trainsets, gaps, link, assumption of protection, and plant mismatch.

    Attributes:
        section: Section.
        trainsets: Nominal trainsets with their loads, head first.
        gap_m: Desired gap, rear of one to front of the next.
        start_gap_m: Gap at departure; None: the desired one.
        apart_m: Desired gap once uncoupled.
        uncouple_at_m: Position at which the head begins to uncouple (infinite: nowhere).
        link: Link from each trainset to the next.
        guard: Assumption of protection: ``coupled`` (brakes controlled to rates that rise along the
            convoy), ``independent`` (no brake is stronger than declared, gradients included),
            ``moving_block`` (the trainset ahead may stop instantly), ``none``.
        mass_factors: True over nominal mass of each; empty: all 1.
        resistance_factors: True over nominal Davis resistance of each; empty: all 1.
        adhesion: Largest wheel force over weight of each; empty: that of the trainset.
        mass_bounds: Mass factors that protection allows for at least.
        dt: Control period, s.
    """

    section: Section
    trainsets: tuple[Trainset, ...]
    gap_m: float = GAP_M
    start_gap_m: float | None = None
    apart_m: float = 100.0
    uncouple_at_m: float = float("inf")
    link: Link = field(default_factory=Link)
    guard: str = "coupled"
    mass_factors: tuple[float, ...] = ()
    resistance_factors: tuple[float, ...] = ()
    adhesion: tuple[float, ...] = ()
    mass_bounds: tuple[float, float] = MASS_SCATTER
    dt: float = CONVOY_PERIOD_S

    def __post_init__(self) -> None:
        count = len(self.trainsets)
        if not 2 <= count <= MOST_TRAINSETS:
            allowed = f"2 to {MOST_TRAINSETS}"
            raise InputError(
                "number of trainsets out of range", field="trainsets", value=count, allowed=allowed
            )
        if self.guard not in GUARDS:
            raise InputError("unknown guard", field="guard", value=self.guard, allowed=", ".join(GUARDS))
        for name, low, high in (
            ("gap_m", 0.5, 2000.0),
            ("first_gap_m", 0.5, 5000.0),
            ("apart_m", 0.5, 2000.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                allowed = f"{low:g} to {high:g} m"
                raise InputError(
                    "out of range",
                    field=name.replace("first", "start"),
                    value=value,
                    unit="m",
                    allowed=allowed,
                )
        if not self.uncouple_at_m >= 0.0:
            raise InputError(
                "out of range", field="uncouple_at_m", value=self.uncouple_at_m, unit="m", allowed=">= 0 m"
            )
        for name, low, high in (("mass", 0.5, 2.0), ("resistance", 0.0, 5.0), ("adhesion", 0.01, 1.0)):
            values = getattr(self, name if name == "adhesion" else f"{name}_factors")
            if len(values) not in {0, count}:
                raise InputError(
                    "one a trainset is wanted", field=name, value=len(values), allowed=str(count)
                )
            if not all(low <= value <= high for value in values):
                allowed = f"{low:g} to {high:g}"
                raise InputError("out of range", field=name, value=str(values), allowed=allowed)

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
        """Rate to which the brakes of each trainset are controlled; infinite where they are not."""
        count = len(self.trainsets)
        if self.guard != "coupled":
            return (float("inf"),) * count
        step = min(STEP_MPS2, (TAIL_MPS2 - HEAD_MPS2) / (count - 1))
        return tuple(HEAD_MPS2 + step * k for k in range(count))

    def leader(self) -> tuple[Section, Trainset]:
        """Section and trainset for the driver of the head.

        A limit holds until the tail of the last trainset has cleared it. In a coupled convoy the head uses
        only a part of its efforts, so that the others can follow.
        """
        behind = -self.starts_m[-1] + self.trainsets[-1].length_m - self.trainsets[0].length_m
        section, head = (
            extend_limits(self.section, behind if self.guard == "coupled" else 0.0),
            self.trainsets[0],
        )
        if self.guard != "coupled":
            return section, head
        rate = self.rates_mps2[0]
        safe = replace(
            head.safe_braking,
            emergency_deceleration_mps2=min(head.safe_braking.emergency_deceleration_mps2, rate),
            service_deceleration_mps2=min(head.safe_braking.service_deceleration_mps2, LEADER_SHARE * rate),
        )
        return section, replace(
            head,
            safe_braking=safe,
            max_acceleration_mps2=min(head.max_acceleration_mps2, LEADER_SHARE),
            max_deceleration_mps2=min(head.max_deceleration_mps2, LEADER_SHARE * rate),
        )


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
        link: The link from the trainset ahead.
        length_m: Length.
        start_m: Position of its front at departure.
        gap_m: Desired gap to the trainset ahead.
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
    link: LinkQuality
    length_m: Array
    start_m: Array
    gap_m: Array
    apart_m: Array
    uncouple_at_m: Array
    is_head: Array


def convoy_members(convoy: Convoy, dtype: type = np.float64) -> tuple[Member, ...]:
    """Make the arrays of every trainset of a convoy (NumPy), the head first.

    Raises:
        InputError: A trainset's emergency brake does not hold it on the section.
    """
    before = -convoy.starts_m[-1] + 50.0
    return tuple(_member(convoy, k, before, dtype) for k in range(len(convoy.trainsets)))


def _member(convoy: Convoy, k: int, before_m: float, dtype: type) -> Member:
    trainset, rates = convoy.trainsets[k], convoy.rates_mps2
    section = convoy.leader()[0] if k == 0 else convoy.section
    vehicle, believed = _actual(convoy, k, dtype), vehicle_arrays(trainset, dtype)
    bounds = member_bounds(convoy, k)
    guard = None
    if convoy.guard != "none":
        guard = protect(section, trainset, bounds, dtype=dtype, before_m=before_m)
    fall = 0.0 if guard is None else float(guard.pull_mps2.max())
    held = min(rates[k], trainset.safe_braking.emergency_deceleration_mps2 - max(fall, 0.0))
    return Member(
        vehicle=vehicle,
        believed=believed,
        track=track_arrays(section, trainset, dtype),
        protection=guard,
        bounds=separate(pair_bounds(convoy, k), convoy.dt, held, dtype),
        most_mps2=dtype(rates[k]),
        link=convoy.link.numbers(dtype),
        length_m=dtype(trainset.length_m),
        start_m=dtype(convoy.starts_m[k]),
        gap_m=dtype(convoy.gap_m),
        apart_m=dtype(convoy.apart_m),
        uncouple_at_m=dtype(convoy.uncouple_at_m + convoy.starts_m[k]),
        is_head=np.bool_(k == 0),
    )


def _factor(values: Sequence[float], k: int) -> float:
    return values[k] if values else 1.0


def _actual(convoy: Convoy, k: int, dtype: type) -> Vehicle:
    """The true plant of a trainset: mass, resistance and adhesion of this run."""
    vehicle = true_vehicle(
        vehicle_arrays(convoy.trainsets[k], dtype),
        mass_factor=dtype(_factor(convoy.mass_factors, k)),
        resistance_factor=dtype(_factor(convoy.resistance_factors, k)),
    )
    if convoy.adhesion:
        grip = dtype(convoy.adhesion[k]) * vehicle.mass_kg * vehicle.gravity_mps2
        vehicle = vehicle._replace(adhesion_n=np.minimum(grip, vehicle.adhesion_n))
    return vehicle


def member_bounds(convoy: Convoy, k: int) -> Bounds:
    """Deviations from the nominal plant of one trainset that protection allows for."""
    trainset, rate = convoy.trainsets[k], convoy.rates_mps2[k]
    usual = Bounds.of(trainset, convoy.dt)
    mass, drag = _factor(convoy.mass_factors, k), _factor(convoy.resistance_factors, k)
    return replace(
        usual,
        mass=(min(convoy.mass_bounds[0], mass), max(convoy.mass_bounds[1], mass)),
        resistance=(min(usual.resistance[0], drag), max(usual.resistance[1], drag)),
        emergency_mps2=min(usual.emergency_mps2, rate),
        controlled=np.isfinite(rate).item(),
    )


def pair_bounds(convoy: Convoy, k: int) -> PairBounds:
    """Bounds on the braking of the trainset ahead of number ``k``."""
    if k == 0 or convoy.guard in {"moving_block", "none"}:
        return PairBounds()
    ahead = convoy.trainsets[k - 1]
    jerk = max(Bounds.of(ahead, convoy.dt).emergency_jerk_mps3, ahead.actuation.jerk_limit_mps3)
    if convoy.guard == "coupled":
        return PairBounds(convoy.rates_mps2[k - 1], jerk)
    return PairBounds(strongest_mps2(convoy.section, ahead), jerk)


def strongest_mps2(section: Section, trainset: Trainset) -> float:
    """Largest deceleration of a trainset: the stronger brake, on the steepest climb, with all resistance."""
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    climb = 1e-3 * float(section.gradient_permil.value.max())
    curve = float(track.slope[:, 1].max())
    top = trainset.max_speed_mps
    davis = float(vehicle.davis_n[0] + top * (vehicle.davis_n[1] + top * vehicle.davis_n[2]))
    drag = 1.5 * davis / (0.8 * trainset.effective_mass_kg)
    hardest = max(
        trainset.safe_braking.emergency_deceleration_mps2,
        min(trainset.service_deceleration_mps2, _all_brakes(vehicle)),
    )
    return hardest + max(climb, 0.0) * trainset.gravity_mps2 + curve + drag


def _all_brakes(vehicle: Vehicle) -> float:
    """Deceleration under all brakes at once with the smallest mass within the bounds, m/s^2."""
    from metropilot.physics import effort_at

    strongest = float(np.max(effort_at(vehicle, np.linspace(0.0, float(vehicle.max_speed_mps), 64)).brake_n))
    return strongest / (0.8 * float(vehicle.effective_mass_kg))
