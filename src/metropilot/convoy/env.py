"""Following as a task to learn: gains of a PID on the speed difference, behind recorded heads (Chen23b)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from metropilot.control import Errors, incremental_pid
from metropilot.convoy.batch import advanced, exchanged, gaps_m, sights, stacked
from metropilot.convoy.gains import chen2023b_state, gains_of
from metropilot.convoy.leaders import recordings
from metropilot.convoy.link import LinkQuality, Message, opened
from metropilot.convoy.model import CONVOY_PERIOD_S, FAR_M, GAP_M, Convoy, Member, convoy_members
from metropilot.convoy.step import MemberState, at_departure
from metropilot.env import AbstractTask, ActionSpace, Transition
from metropilot.physics import namespace, to_jax
from metropilot.railway import load_line, load_trainset
from metropilot.sim import true_vehicle

Array = Any
MAX_PERIODS = 1200


@dataclass(frozen=True)
class ConvoyTaskConfig:
    """What is learned behind whom.

    Attributes:
        line: Line.
        origin: Station of departure.
        destination: Station of arrival.
        trainsets: Whose pairs; ``ID`` or ``ID:LOAD``.
        heads: Recorded heads of each.
        gap_m: Desired gap.
        eta_speed: Chen23b's eta_1, 1/(m/s).
        eta_gap: And eta_2, 1/m.
        contact: C: what a contact costs.
        effort: What a unit of change of the command costs (0 in the paper).
        disturbed: Share of episodes with another mass, resistance and link than nominal.
        mass: Range of the follower's mass factor in those.
        delay_s: Largest delay of messages in those.
        loss: Largest share of lost messages in those.
        on_the_way: Share of episodes that begin somewhere on the way.
        emergency: Share of episodes in which the head makes an emergency brake.
        dt: Control period, s.
        seed: Of the heads.
    """

    line: str = "yizhuang"
    origin: str = "YZQ"
    destination: str = "WHY"
    trainsets: tuple[str, ...] = ("cheng2023",)
    heads: int = 24
    gap_m: float = GAP_M
    eta_speed: float = 1000.0
    eta_gap: float = 1000.0
    contact: float = 100.0
    effort: float = 0.0
    disturbed: float = 0.0
    mass: tuple[float, float] = (0.8, 1.2)
    delay_s: float = 0.4
    loss: float = 0.15
    on_the_way: float = 0.7
    emergency: float = 0.0
    dt: float = CONVOY_PERIOD_S
    seed: int = 0


def follow_terms(
    config: ConvoyTaskConfig, gap_m: Array, apart_mps: Array, change: Array, wanted_m: Array
) -> Mapping[str, Array]:
    """Chen23b eqs. 18 and 19, the gap counted from the wanted one (NumPy and JAX).

    Args:
        config: Weights.
        gap_m: Gap, rear to front.
        apart_mps: Speed ahead less own speed.
        change: Of the command.
        wanted_m: Desired gap.
    """
    xp = namespace(gap_m, apart_mps, change)
    return {
        "speed": 1.0 / (1.0 + config.eta_speed * xp.abs(apart_mps)),
        "gap": 1.0 / (1.0 + config.eta_gap * xp.abs(gap_m - wanted_m)),
        "contact": xp.where(gap_m < 0.0, -config.contact, 0.0),
        "effort": -config.effort * xp.abs(change),
    }


class FollowState(NamedTuple):
    """Where an episode is.

    Attributes:
        row: Which pair and head.
        period: Periods since the head's departure.
        mass: The follower's mass factor.
        quality: Of the link.
        emergency_s: When the head makes an emergency brake (infinite: never).
        states: Of both trainsets. Leading axis 2.
        errors: Of the PID.
        contact: Whether they have touched.
    """

    row: Array
    period: Array
    mass: Array
    quality: LinkQuality
    emergency_s: Array
    states: MemberState
    errors: Errors
    contact: Array


class ConvoyTask(AbstractTask):
    """One follower behind a recorded head; actions are its PID's gains. No protection, as published.

    Args:
        config: What is learned behind whom.
    """

    def __init__(self, config: ConvoyTaskConfig) -> None:
        self.config = config
        section = load_line(config.line).section(config.origin, config.destination)
        pairs, heads, bare = [], [], []
        for name in config.trainsets:
            trainset = load_trainset(name)
            convoy = Convoy(section, (trainset, trainset), gap_m=config.gap_m, guard="coupled", dt=config.dt)
            pair = convoy_members(replace(convoy), np.float32)
            bare = [member._replace(protection=None) for member in pair]
            found = recordings(*convoy.leader(), config.dt, config.heads, config.seed, MAX_PERIODS)
            pairs += [stacked(bare)] * len(found)
            heads += found
        self.members: Member = to_jax(_rows(pairs))
        self.heads = to_jax(stacked(heads))
        first = [at_departure(m, None, config.dt) for m in bare]
        self.fresh: MemberState = to_jax(stacked(first))
        self.count = len(heads)

    @cached_property
    def observation_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Chen23b's six numbers."""
        return 6

    @property
    def action_space(self) -> ActionSpace:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Three gains."""
        return ActionSpace(size=3)

    def reset(self, key: Array) -> tuple[FollowState, Array]:
        """A new episode: which head, what is disturbed, and where it begins."""
        import jax
        import jax.numpy as jnp

        config, f32 = self.config, jnp.float32
        keys = jax.random.split(key, 4)
        row = jax.random.randint(keys[0], (), 0, self.count)
        u = jax.random.uniform(keys[1], (8,), f32)
        off = (u[0] < config.disturbed).astype(f32)
        low, high = config.mass
        mass = 1.0 + off * (low + (high - low) * u[1] - 1.0)
        quality = LinkQuality(
            off * config.delay_s * u[2], 0.0 * off, off * config.loss * u[3], jnp.asarray(jnp.inf, f32)
        )
        stop = jnp.sum((self.heads.speed_mps[row] > 0.0).astype(jnp.int32))
        way = u[4] < config.on_the_way
        period = jnp.where(way, (u[5] * 0.9 * stop).astype(jnp.int32), 0)
        begins = jnp.where(u[6] < config.emergency, period * config.dt + 1.0 + 30.0 * u[7], jnp.inf)
        aside = jax.random.normal(keys[2], (2,), f32) * jnp.where(way, 1.0, 0.0)
        states = self._placed(row, period, aside)
        zero = jnp.zeros((), f32)
        state = FollowState(
            row, period, mass, quality, begins.astype(f32), states, Errors(zero, zero), jnp.zeros((), bool)
        )
        state = self._exchange(state, jnp.ones((2, 2), f32))
        return state, self._observe(state)

    def begin(
        self, row: Array, mass: float = 1.0, quality: LinkQuality | None = None
    ) -> tuple[FollowState, Array]:
        """An undisturbed episode from standstill behind one of the heads."""
        import jax.numpy as jnp

        zero, f32 = jnp.zeros((), jnp.float32), jnp.float32
        quality = quality or LinkQuality(zero, zero, zero, jnp.asarray(jnp.inf, f32))
        at = jnp.asarray(row, jnp.int32)
        states = self._placed(at, jnp.zeros((), jnp.int32), jnp.zeros((2,), f32))
        state = FollowState(
            row=at,
            period=jnp.zeros((), jnp.int32),
            mass=jnp.asarray(mass, f32),
            quality=quality,
            emergency_s=jnp.asarray(jnp.inf, f32),
            states=states,
            errors=Errors(zero, zero),
            contact=jnp.zeros((), bool),
        )
        state = self._exchange(state, jnp.ones((2, 2), f32))
        return state, self._observe(state)

    def step(self, key: Array, state: FollowState, action: Array) -> tuple[FollowState, Transition]:
        """One period: gains, PID, both trainsets move, then messages."""
        import jax
        import jax.numpy as jnp

        config = self.config
        pair, now, dt = self._pair(state), self._now(state), jnp.float32(config.dt)
        seen = jax.tree.map(lambda x: x[1], sights(pair, state.states, now, dt))
        share, errors = incremental_pid(
            seen.command, gains_of(action), seen.ahead_mps - seen.speed_mps, state.errors
        )
        row = jnp.minimum(state.period, MAX_PERIODS - 1)
        head = self.heads.command[state.row, row]
        alarm = jnp.stack([now >= state.emergency_s, jnp.zeros((), bool)])
        states = advanced(pair, state.states, jnp.stack([head, share]), alarm, now, dt)
        gap = gaps_m(pair, states)[0]
        apart = states.plant.speed_mps[0] - states.plant.speed_mps[1]
        terms = follow_terms(config, gap, apart, share - seen.command, config.gap_m)
        contact = gap < 0.0
        after = state._replace(
            period=state.period + 1, states=states, errors=errors, contact=state.contact | contact
        )
        after = self._exchange(after, jax.random.uniform(key, (2, 2), jnp.float32))
        stand = jnp.all(states.plant.speed_mps <= 0.0) & (self._now(after) > 8.0)
        over = (after.period >= MAX_PERIODS) | stand
        reward = sum(terms.values(), jnp.zeros((), jnp.float32))
        return after, Transition(self._observe(after), reward, contact, over & ~contact, terms)

    def _now(self, state: FollowState) -> Array:
        import jax.numpy as jnp

        return state.period.astype(jnp.float32) * jnp.float32(self.config.dt)

    def _pair(self, state: FollowState) -> Member:
        """The pair of this episode, the follower with its true mass."""
        import jax
        import jax.numpy as jnp

        pair: Member = jax.tree.map(lambda x: x[state.row], self.members)
        mass = jnp.stack([jnp.ones_like(state.mass), state.mass])
        quality = jax.tree.map(lambda x: jnp.stack([x, x]), state.quality)
        return pair._replace(vehicle=true_vehicle(pair.vehicle, mass_factor=mass), link=quality)

    def _placed(self, row: Array, period: Array, aside: Array) -> MemberState:
        """Both trainsets as the head's recording says, the follower a little aside in gap and speed."""
        import jax
        import jax.numpy as jnp

        x = self.heads.position_m[row, period]
        v = self.heads.speed_mps[row, period]
        a = self.heads.acceleration_mps2[row, period]
        share = jnp.where(period > 0, self.heads.command[row, jnp.maximum(period - 1, 0)], 0.0)
        length = self.members.length_m[row, 0]
        behind = x - length - self.config.gap_m - 0.05 * aside[0]
        speed = jnp.maximum(v + 0.03 * aside[1] * (v > 0.5), 0.0)
        plant = self.fresh.plant._replace(
            position_m=jnp.stack([x, behind]),
            speed_mps=jnp.stack([v, speed]),
            acceleration_mps2=jnp.stack([a, a]),
            share=jnp.stack([share, share]),
            pipeline=jnp.broadcast_to(share, self.fresh.plant.pipeline.shape).astype(jnp.float32),
        )
        now = period.astype(jnp.float32) * jnp.float32(self.config.dt)
        zero = jnp.zeros((), jnp.float32)
        nobody = Message(now, zero + FAR_M, zero, zero, zero, zero)
        ahead = Message(now, x - length, v, a, share, zero)
        first = jax.tree.map(lambda p, q: jnp.stack([p, q]), nobody, ahead)
        template = jax.tree.map(jnp.asarray, opened(Message(*(np.float32(0.0),) * 6)))
        channel = jax.tree.map(lambda t: jnp.stack([t, t]), template)._replace(heard=first)
        both = jnp.stack([share, share])
        return self.fresh._replace(plant=plant, channel=channel, wanted=both, command=both)

    def _exchange(self, state: FollowState, luck: Array) -> FollowState:
        import jax.numpy as jnp

        dt = jnp.float32(self.config.dt)
        return state._replace(states=exchanged(self._pair(state), state.states, self._now(state), dt, luck))

    def _observe(self, state: FollowState) -> Array:
        """Chen23b's state of the follower. Shape (6,)."""
        import jax
        import jax.numpy as jnp

        seen = sights(self._pair(state), state.states, self._now(state), jnp.float32(self.config.dt))
        return chen2023b_state(jax.tree.map(lambda x: x[1], seen))


def _rows(pairs: list[Member]) -> Member:
    """Pairs of different trainsets with one more leading axis, padded alike."""
    import jax

    flat = [jax.tree.map(lambda x, k=k: x[k], pair) for pair in pairs for k in range(2)]
    whole = stacked(flat)
    return jax.tree.map(lambda x: x.reshape(len(pairs), 2, *x.shape[1:]), whole)
