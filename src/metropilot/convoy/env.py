"""Learning task of a follower: gains of a PID on the speed difference, behind recorded heads (Chen23b)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from metropilot._schema import check_fields, declare
from metropilot._typing import Array
from metropilot.control import Errors, incremental_pid
from metropilot.convoy.batch import advance_members, exchange_messages, gaps_m, observe_members, stack_rows
from metropilot.convoy.drivers.follow_pid import chen2023b_state, gains_of
from metropilot.convoy.leaders import recordings
from metropilot.convoy.model import (
    CONVOY_PERIOD_S,
    FAR_M,
    GAP_M,
    Convoy,
    LinkQuality,
    Member,
    Message,
    convoy_members,
    open_channel,
)
from metropilot.convoy.step import MemberState, at_departure
from metropilot.env import (
    NOMINAL,
    AbstractTask,
    ActionSpace,
    DisturbanceDistribution,
    Transition,
    draw_disturbance,
)
from metropilot.errors import InputError
from metropilot.physics import namespace, to_jax
from metropilot.railway import load_line, load_trainset
from metropilot.sim import true_vehicle

MAX_PERIODS = 1200
OTHER_MASS = DisturbanceDistribution(mass_factor=(0.8, 1.2))


@dataclass(frozen=True)
class ConvoyTaskConfig:
    """Plant, reward and disturbances of :class:`ConvoyTask`.

    Attributes:
        line: Line.
        origin: Station of departure.
        destination: Station of arrival.
        trainsets: Trainsets, ``ID`` or ``ID:LOAD``; each forms a pair of its own.
        heads: Number of recorded heads of each.
        gap_m: Desired gap.
        eta_speed: eta_1 of Chen23b, 1/(m/s).
        eta_gap: eta_2 of Chen23b, 1/m.
        rewarded_gap_m: Gap that eq. 18 rewards most; None: the desired one (0, a contact, as printed).
        contact: C of Chen23b: cost of a contact.
        effort: Cost of a unit of change of the command (0 in the paper).
        disturbed: Share of episodes with a disturbance of the follower and of the link.
        disturbances: Distribution of the follower's in those.
        delay_s: Largest delay of messages in those.
        loss: Largest share of lost messages in those.
        on_the_way: Share of episodes that begin between the stations.
        emergency: Share of episodes in which the head makes an emergency brake.
        dt: Control period, s.
        seed: Seed of the heads.

    Raises:
        InputError: A value that a field cannot have.
    """

    line: str = "yizhuang"
    origin: str = "YZQ"
    destination: str = "WHY"
    trainsets: tuple[str, ...] = ("cheng2023",)
    heads: int = declare(24, low=1)
    gap_m: float = declare(GAP_M, unit="m", low=0.5, high=2000.0)
    eta_speed: float = declare(1000.0, low=0.0)
    eta_gap: float = declare(1000.0, low=0.0)
    rewarded_gap_m: float | None = declare(None, unit="m", low=0.0)
    contact: float = declare(100.0, low=0.0)
    effort: float = declare(0.0, low=0.0)
    disturbed: float = declare(0.0, low=0.0, high=1.0)
    disturbances: DisturbanceDistribution = OTHER_MASS
    delay_s: float = declare(0.4, unit="s", low=0.0, high=2.0)
    loss: float = declare(0.15, low=0.0, high=1.0)
    on_the_way: float = declare(0.7, low=0.0, high=1.0)
    emergency: float = declare(0.0, low=0.0, high=1.0)
    dt: float = declare(CONVOY_PERIOD_S, unit="s", low=0.01, high=1.0)
    seed: int = declare(0, low=0)

    def __post_init__(self) -> None:
        check_fields(self)
        if not isinstance(self.trainsets, tuple | list) or not self.trainsets:
            allowed = "one or more, ID or ID:LOAD"
            raise InputError(
                "not a tuple of trainsets", field="trainsets", value=str(self.trainsets), allowed=allowed
            )


def follow_terms(
    config: ConvoyTaskConfig, gap_m: Array, apart_mps: Array, change: Array, wanted_m: Array
) -> Mapping[str, Array]:
    """Reward terms of Chen23b eqs. 18 and 19, with the gap error from the desired gap (NumPy and JAX).

    Args:
        config: Weights.
        gap_m: Gap, rear to front.
        apart_mps: Speed ahead less own speed.
        change: Change of the command.
        wanted_m: Gap that is rewarded most.
    """
    xp = namespace(gap_m, apart_mps, change)
    return {
        "speed": 1.0 / (1.0 + config.eta_speed * xp.abs(apart_mps)),
        "gap": 1.0 / (1.0 + config.eta_gap * xp.abs(gap_m - wanted_m)),
        "contact": xp.where(gap_m < 0.0, -config.contact, 0.0),
        "effort": -config.effort * xp.abs(change),
    }


class FollowState(NamedTuple):
    """State of an episode.

    Attributes:
        row: Index of pair and head.
        period: Periods since the head's departure.
        disturbance: Disturbance of the follower, by name.
        quality: Quality of the link.
        emergency_s: Time at which the head makes an emergency brake (infinite: never).
        states: States of both trainsets. Leading axis 2.
        errors: Errors of the PID.
        contact: True after a contact.
    """

    row: Array
    period: Array
    disturbance: dict[str, Array]
    quality: LinkQuality
    emergency_s: Array
    states: MemberState
    errors: Errors
    contact: Array


class ConvoyTask(AbstractTask):
    """One follower behind a recorded head; actions are the gains of its PID. No protection, as published.

    Args:
        config: Plant, reward and disturbances.
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
            pairs += [stack_rows(bare)] * len(found)
            heads += found
        self.members: Member = to_jax(_rows(pairs))
        self.heads = to_jax(stack_rows(heads))
        longest_s = config.disturbances.delay_s[1]
        first = [at_departure(m, None, config.dt, delay_s=longest_s) for m in bare]
        self.fresh: MemberState = to_jax(stack_rows(first))
        self.count = len(heads)

    @cached_property
    def observation_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The six state variables of Chen23b."""
        return 6

    @property
    def action_space(self) -> ActionSpace:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Three gains."""
        return ActionSpace(size=3)

    def reset(self, key: Array) -> tuple[FollowState, Array]:
        """Begin an episode with a random head, disturbance and starting position."""
        import jax
        import jax.numpy as jnp

        config, f32 = self.config, jnp.float32
        keys = jax.random.split(key, 4)
        row = jax.random.randint(keys[0], (), 0, self.count)
        u = jax.random.uniform(keys[1], (8,), f32)
        off = (u[0] < config.disturbed).astype(f32)
        more = jax.random.uniform(keys[3], (max(config.disturbances.quantities_drawn - 1, 0),), f32)
        drawn = draw_disturbance(config.disturbances, iter((u[1], *more)))
        disturbance = {name: jnp.where(off > 0.0, value, NOMINAL[name][0]) for name, value in drawn.items()}
        quality = LinkQuality(
            off * config.delay_s * u[2], 0.0 * off, off * config.loss * u[3], jnp.asarray(jnp.inf, f32)
        )
        stop = jnp.sum((self.heads.speed_mps[row] > 0.0).astype(jnp.int32))
        way = u[4] < config.on_the_way
        period = jnp.where(way, (u[5] * 0.9 * stop).astype(jnp.int32), 0)
        begins = jnp.where(u[6] < config.emergency, period * config.dt + 1.0 + 30.0 * u[7], jnp.inf)
        aside = jax.random.normal(keys[2], (2,), f32) * jnp.where(way, 1.0, 0.0)
        states = self._place(row, period, aside)
        zero = jnp.zeros((), f32)
        state = FollowState(
            row,
            period,
            disturbance,
            quality,
            begins.astype(f32),
            states,
            Errors(zero, zero),
            jnp.zeros((), bool),
        )
        state = self._exchange(state, jnp.ones((2, 2), f32))
        return state, self._observe(state)

    def begin(self, row: Array) -> tuple[FollowState, Array]:
        """Begin an undisturbed episode from standstill behind one of the heads."""
        import jax.numpy as jnp

        f32, at = jnp.float32, jnp.asarray(row, jnp.int32)
        zero, never = jnp.zeros((), f32), jnp.asarray(jnp.inf, f32)
        state = FollowState(
            at,
            jnp.zeros((), jnp.int32),
            {name: jnp.asarray(low, f32) for name, (low, _) in NOMINAL.items()},
            LinkQuality(zero, zero, zero, never),
            never,
            self._place(at, jnp.zeros((), jnp.int32), jnp.zeros((2,), f32)),
            Errors(zero, zero),
            jnp.zeros((), bool),
        )
        state = self._exchange(state, jnp.ones((2, 2), f32))
        return state, self._observe(state)

    def step(self, key: Array, state: FollowState, action: Array) -> tuple[FollowState, Transition]:
        """Apply the gains for one control period, then exchange messages."""
        import jax
        import jax.numpy as jnp

        config = self.config
        pair, now, dt = self._pair(state), self._now(state), jnp.float32(config.dt)
        seen = jax.tree.map(lambda x: x[1], observe_members(pair, state.states, now, dt))
        share, errors = incremental_pid(
            seen.command, gains_of(action), seen.ahead_mps - seen.speed_mps, state.errors
        )
        row = jnp.minimum(state.period, MAX_PERIODS - 1)
        head = self.heads.command[state.row, row]
        alarm = jnp.stack([now >= state.emergency_s, jnp.zeros((), bool)])
        noise = None
        if config.disturbances.speed_noise_mps[1] > 0.0:
            noise = jax.random.normal(jax.random.fold_in(key, 1), (2,), jnp.float32)
        states = advance_members(pair, state.states, jnp.stack([head, share]), alarm, now, dt, noise)
        gap = gaps_m(pair, states)[0]
        apart = states.plant.speed_mps[0] - states.plant.speed_mps[1]
        rewarded = config.gap_m if config.rewarded_gap_m is None else config.rewarded_gap_m
        terms = follow_terms(config, gap, apart, share - seen.command, rewarded)
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
        """The pair of this episode, the follower with its true plant."""
        import jax
        import jax.numpy as jnp

        pair: Member = jax.tree.map(lambda x: x[state.row], self.members)
        both = {n: jnp.stack([jnp.float32(NOMINAL[n][0]), x]) for n, x in state.disturbance.items()}
        mismatch = {name: both[name] for name in self.config.disturbances.mismatches}
        quality = jax.tree.map(lambda x: jnp.stack([x, x]), state.quality)
        return pair._replace(
            vehicle=jax.vmap(lambda nominal, own: true_vehicle(nominal, **own))(pair.believed, mismatch),
            speed_noise_mps=both["speed_noise_mps"],
            link=quality,
        )

    def _place(self, row: Array, period: Array, aside: Array) -> MemberState:
        """States of both trainsets from the recording, the follower with an offset in gap and speed."""
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
        template = jax.tree.map(jnp.asarray, open_channel(Message(*(np.float32(0.0),) * 6)))
        channel = jax.tree.map(lambda t: jnp.stack([t, t]), template)._replace(heard=first)
        both = jnp.stack([share, share])
        return self.fresh._replace(
            plant=plant, measured_mps=plant.speed_mps, channel=channel, wanted=both, command=both
        )

    def _exchange(self, state: FollowState, luck: Array) -> FollowState:
        import jax.numpy as jnp

        dt = jnp.float32(self.config.dt)
        return state._replace(
            states=exchange_messages(self._pair(state), state.states, self._now(state), dt, luck)
        )

    def _observe(self, state: FollowState) -> Array:
        """The state of Chen23b eq. 16 of the follower. Shape (6,)."""
        import jax
        import jax.numpy as jnp

        seen = observe_members(self._pair(state), state.states, self._now(state), jnp.float32(self.config.dt))
        return chen2023b_state(jax.tree.map(lambda x: x[1], seen))


def _rows(pairs: list[Member]) -> Member:
    """Stack pairs of different trainsets along one more leading axis, padded to common sizes."""
    import jax

    flat = [jax.tree.map(lambda x, k=k: x[k], pair) for pair in pairs for k in range(2)]
    whole = stack_rows(flat)
    return jax.tree.map(lambda x: x.reshape(len(pairs), 2, *x.shape[1:]), whole)
