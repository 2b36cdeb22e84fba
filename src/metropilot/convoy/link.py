"""Radio link from a trainset to the one behind it: messages with delay, jitter and loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from metropilot._typing import Array
from metropilot.errors import InputError
from metropilot.physics import namespace

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
