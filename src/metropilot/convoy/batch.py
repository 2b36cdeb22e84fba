"""Compiled convoy: one row per trainset, messages pass from row to row (JAX)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from metropilot._typing import Array
from metropilot.convoy.model import FAR_M, Member, Message
from metropilot.convoy.step import (
    UNLIMITED_MPS,
    FollowerObservation,
    MemberState,
    Plans,
    drive_period,
    make_message,
    observe_member,
    receive_message,
    update_needed_gap,
)
from metropilot.physics import Command, stack
from metropilot.protection import Protection, permitted_speed


def stack_rows(rows: Sequence[Any]) -> Any:  # noqa: ANN401 (a tree of tuples)
    """Stack members or states of a convoy along a leading axis (NumPy), padded to common sizes."""
    first = rows[0]
    if first is None:
        return None
    if isinstance(first, Member):
        plain = [row._replace(vehicle=(), believed=(), track=(), protection=None) for row in rows]
        return _columns(plain)._replace(
            vehicle=stack([row.vehicle for row in rows]),
            believed=stack([row.believed for row in rows]),
            track=stack([row.track for row in rows]),
            protection=_protections([row.protection for row in rows]),
        )
    if isinstance(first, tuple):
        return _columns(rows)
    return np.stack([np.asarray(row) for row in rows])


def _columns(rows: Sequence[Any]) -> Any:  # noqa: ANN401 (a tree of tuples)
    columns = [stack_rows(column) for column in zip(*rows, strict=True)]
    return type(rows[0])(*columns) if hasattr(rows[0], "_fields") else tuple(columns)


def _protections(rows: Sequence[Protection | None]) -> Protection | None:
    """Stack protections, padded to one size; beyond the end of its map the permitted speed is 0."""
    found = [row for row in rows if row is not None]
    if not found:
        return None
    ahead = max((row.ahead for row in found), key=len)
    slots = max((row.slots for row in found), key=len)
    size = max(row.emergency.size for row in found) + ahead.size

    def widen(row: Protection) -> Protection:
        zero = {n: _wide(getattr(row, n), size, 0.0) for n in ("emergency", "service", "permitted_mps")}
        last = {n: _wide(getattr(row, n), size, None) for n in ("pull_mps2", "usual_pull_mps2")}
        return row._replace(vehicle=(), ahead=ahead, slots=slots, **zero, **last)

    plain = stack_rows([tuple(widen(row)) for row in found])
    return Protection(*plain)._replace(vehicle=stack([row.vehicle for row in found]))


def _wide(values: np.ndarray, size: int, fill: float | None) -> np.ndarray:
    extra = np.full(size - values.size, values[-1] if fill is None else fill, values.dtype)
    return np.concatenate([values, extra])


def exchange_messages(
    members: Member, states: MemberState, now_s: Array, dt: Array, luck: Array
) -> MemberState:
    """Send a message from each trainset to the one behind; the head receives a trainset far ahead.

    Args:
        members: Leading axis N.
        states: Leading axis N.
        now_s: Time.
        dt: Control period.
        luck: Random numbers, shape (N, 2), see :func:`metropilot.convoy.model.transmit`.
    """
    import jax
    import jax.numpy as jnp

    messages = jax.vmap(make_message, (0, 0, None))(members, states, now_s)
    nobody = Message(now_s, jnp.full_like(now_s, FAR_M), *(jnp.zeros_like(now_s),) * 4)
    down = Message(
        *(
            jnp.concatenate([jnp.expand_dims(none, 0), values[:-1]])
            for none, values in zip(nobody, messages, strict=True)
        )
    )
    states = jax.vmap(receive_message)(members, states, down, luck)
    if members.protection is None:
        return states
    return jax.vmap(update_needed_gap, (0, 0, None, None))(members, states, now_s, dt)


def observe_members(
    members: Member, states: MemberState, now_s: Array, dt: Array, plans: Plans | None = None
) -> FollowerObservation:
    """Observations of all drivers. Leading axis N.

    Args:
        members: Leading axis N.
        states: Leading axis N.
        now_s: Time.
        dt: Control period.
        plans: Planned motions that they know, leading axis N; None: none.
    """
    import jax
    import jax.numpy as jnp

    if members.protection is None:
        permitted = jnp.full_like(states.plant.position_m, UNLIMITED_MPS)
    else:
        permitted = jax.vmap(permitted_speed)(members.protection, states.plant.position_m)
    known = None if plans is None else 0
    return jax.vmap(observe_member, (0, 0, None, None, 0, known))(
        members, states, now_s, dt, permitted, plans
    )


def advance_members(
    members: Member,
    states: MemberState,
    shares: Array,
    emergency: Array,
    now_s: Array,
    dt: Array,
    noise: Array | None = None,
) -> MemberState:
    """Advance all trainsets by one control period, under protection.

    Args:
        members: Leading axis N.
        states: Leading axis N.
        shares: Commands of the drivers. Shape (N,).
        emergency: True where a driver demands the emergency brake. Shape (N,).
        now_s: Time.
        dt: Control period.
        noise: Errors of the measured speeds in standard deviations; None: none. Shape (N,).
    """
    import jax

    def one(member: Member, state: MemberState, share: Array, alarm: Array, error: Array) -> MemberState:
        return drive_period(member, state, Command(share, alarm), now_s, dt, error)[0]

    return jax.vmap(one)(members, states, shares, emergency, 0.0 * shares if noise is None else noise)


def gaps_m(members: Member, states: MemberState) -> Array:
    """True gaps, rear of one to front of the next. Shape (N - 1,)."""
    front = states.plant.position_m
    return front[:-1] - members.length_m[:-1] - front[1:]
