"""A whole convoy as one compiled program: every trainset a row, messages handed down the rows (JAX)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from metropilot.convoy.link import Message
from metropilot.convoy.model import FAR_M, Member
from metropilot.convoy.step import FollowerObservation, MemberState, drive_period, heard, needed, sight, told
from metropilot.physics import Command, stack
from metropilot.protection import Protection, permitted_speed

Array = Any
UNLIMITED_MPS = 1e3


def stacked(rows: Sequence[Any]) -> Any:  # noqa: ANN401 (a tree of tuples)
    """Members or states of a convoy with a leading axis (NumPy), padded to common sizes."""
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
    columns = [stacked(column) for column in zip(*rows, strict=True)]
    return type(rows[0])(*columns) if hasattr(rows[0], "_fields") else tuple(columns)


def _protections(rows: Sequence[Protection | None]) -> Protection | None:
    """Protections of one size: where a map ends, nothing may move."""
    found = [row for row in rows if row is not None]
    if not found:
        return None
    ahead = max((row.ahead for row in found), key=len)
    slots = max((row.slots for row in found), key=len)
    size = max(row.emergency.size for row in found) + ahead.size

    def widened(row: Protection) -> Protection:
        zero = {n: _wide(getattr(row, n), size, 0.0) for n in ("emergency", "service", "permitted_mps")}
        last = {n: _wide(getattr(row, n), size, None) for n in ("pull_mps2", "usual_pull_mps2")}
        return row._replace(vehicle=(), ahead=ahead, slots=slots, **zero, **last)

    plain = stacked([tuple(widened(row)) for row in found])
    return Protection(*plain)._replace(vehicle=stack([row.vehicle for row in found]))


def _wide(values: np.ndarray, size: int, fill: float | None) -> np.ndarray:
    extra = np.full(size - values.size, values[-1] if fill is None else fill, values.dtype)
    return np.concatenate([values, extra])


def exchanged(members: Member, states: MemberState, now_s: Array, dt: Array, luck: Array) -> MemberState:
    """Everybody tells the one behind, and hears what the link delivers; the head hears of nobody.

    Args:
        members: Leading axis N.
        states: Leading axis N.
        now_s: Time.
        dt: Control period.
        luck: Shape (N, 2), see :func:`metropilot.convoy.link.passed_on`.
    """
    import jax
    import jax.numpy as jnp

    messages = jax.vmap(told, (0, 0, None))(members, states, now_s)
    nobody = Message(now_s, jnp.full_like(now_s, FAR_M), *(jnp.zeros_like(now_s),) * 4)
    down = Message(
        *(
            jnp.concatenate([jnp.expand_dims(none, 0), values[:-1]])
            for none, values in zip(nobody, messages, strict=True)
        )
    )
    states = jax.vmap(heard)(members, states, down, luck)
    if members.protection is None:
        return states
    return jax.vmap(needed, (0, 0, None, None))(members, states, now_s, dt)


def sights(members: Member, states: MemberState, now_s: Array, dt: Array) -> FollowerObservation:
    """What every driver sees. Leading axis N."""
    import jax
    import jax.numpy as jnp

    if members.protection is None:
        permitted = jnp.full_like(states.plant.position_m, UNLIMITED_MPS)
    else:
        permitted = jax.vmap(permitted_speed)(members.protection, states.plant.position_m)
    return jax.vmap(sight, (0, 0, None, None, 0))(members, states, now_s, dt, permitted)


def advanced(
    members: Member, states: MemberState, shares: Array, emergency: Array, now_s: Array, dt: Array
) -> MemberState:
    """Everybody is supervised and moves for one period.

    Args:
        members: Leading axis N.
        states: Leading axis N.
        shares: What drivers ask for. Shape (N,).
        emergency: Who asks for the emergency brake. Shape (N,).
        now_s: Time.
        dt: Control period.
    """
    import jax

    def one(member: Member, state: MemberState, share: Array, alarm: Array) -> MemberState:
        return drive_period(member, state, Command(share, alarm), now_s, dt)[0]

    return jax.vmap(one)(members, states, shares, emergency)


def gaps_m(members: Member, states: MemberState) -> Array:
    """True gaps, rear of one to front of the next. Shape (N - 1,)."""
    front = states.plant.position_m
    return front[:-1] - members.length_m[:-1] - front[1:]
