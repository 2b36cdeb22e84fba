"""Robustness tests of convoy protection: emergency brakes of the head, bad links, adversarial drivers.

Every case is a convoy in motion at a gap its protection accepts. Within seconds the head makes an emergency
brake; the case ends when all stand. Disturbances, link and the commands of the followers are drawn for each
case within the declared bounds. JAX, in single precision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Any, NamedTuple

import numpy as np

from metropilot._typing import Array
from metropilot.convoy.batch import advance_members, exchange_messages, gaps_m, observe_members, stack_rows
from metropilot.convoy.drivers import FOLLOWERS
from metropilot.convoy.leaders import recordings
from metropilot.convoy.model import (
    FAR_M,
    Channel,
    Convoy,
    ConvoyGuard,
    LinkQuality,
    Member,
    Message,
    convoy_members,
)
from metropilot.convoy.plan import MotionPlan
from metropilot.convoy.step import FollowerObservation, MemberState, Plans, ahead_of, at_departure
from metropilot.env import DisturbanceDistribution, draw_disturbance
from metropilot.physics import to_jax
from metropilot.protection import spare_gap
from metropilot.railway import Trainset, load_line, load_trainset
from metropilot.sim import NOISE_CUT, true_vehicle

HARMFUL = ("full traction", "random", "bang-bang", "stuck", "late brake", "follow_plan")
"""Behaviours of followers; each follower of a case draws one."""
ATTACKED_HEADS = 24
LONGEST_S = 34.0
LONGEST_EMERGENCY_S = 6.0
ROWS_S = 120.0


MASS_AND_RESISTANCE = DisturbanceDistribution(mass_factor=(0.8, 1.2), resistance_factor=(0.5, 1.5))
EVERY_DISTURBANCE = DisturbanceDistribution(
    mass_factor=(0.8, 1.2),
    resistance_factor=(0.5, 1.5),
    delay_s=(0.0, 0.6),
    lag_s=(0.0, 0.4),
    speed_noise_mps=(0.0, 0.05),
    headwind_mps=(-8.0, 8.0),
    adhesion=(0.06, 0.15),
    brake_factor=(0.7, 1.3),
)


@dataclass(frozen=True)
class AttackCampaign:
    """Convoy and ranges of a campaign of attacks.

    Attributes:
        line: Line.
        origin: Station of departure.
        destination: Station of arrival.
        trainsets: Trainsets or their ids, from the head on; fewer than the convoy has repeat.
        count: Trainsets of a convoy.
        guard: Assumption of protection.
        disturbances: Distribution of the disturbance of every trainset.
        delay_s: Largest delay of messages.
        jitter_s: Largest jitter.
        loss: Largest share of lost messages.
        silence: Share of cases in which the link falls silent at some moment.
        scatter_mps2: Largest shortfall of an emergency brake below its rate.
        dt: Control period.
        seed: Seed of all random draws.
    """

    line: str = "yizhuang"
    origin: str = "YZQ"
    destination: str = "WHY"
    trainsets: tuple[str | Trainset, ...] = ("cheng2023",)
    count: int = 2
    guard: ConvoyGuard = "coupled"
    disturbances: DisturbanceDistribution = MASS_AND_RESISTANCE
    delay_s: float = 0.6
    jitter_s: float = 0.4
    loss: float = 0.5
    silence: float = 0.1
    scatter_mps2: float = 0.01
    dt: float = 0.2
    seed: int = 0


class AttackCase(NamedTuple):
    """One attack. Fields of each trainset have the leading axis N."""

    row: Array
    period: Array
    emergency_s: Array
    disturbance: dict[str, Array]
    scatter: Array
    quality: LinkQuality
    manner: Array
    share: Array


Choice = tuple[Array, Callable[[FollowerObservation], tuple[Array, Array]]]
"""Random numbers of the link, and of the odometer where it errs, shape (N, 2 or 3); the function from
observations to commands and memory."""
Chosen = Callable[[Array, Array, Array], Choice]
"""The choice in a period, given its number, the memory and the last requested commands of the followers."""


class Tally(NamedTuple):
    """Results of a number of cases.

    Attributes:
        gap_min_m: Smallest gap of each case. Shape (cases,).
        start_gap_m: Gap that the first follower began with. Shape (cases,).
        speed_mps: Speed at the beginning. Shape (cases,).
        emergencies: Emergency brakes of followers in each. Shape (cases,).
        standing: True where all stood at the end. Shape (cases,).
    """

    gap_min_m: np.ndarray
    start_gap_m: np.ndarray
    speed_mps: np.ndarray
    emergencies: np.ndarray
    standing: np.ndarray

    @property
    def contacts(self) -> int:
        """Cases in which two trainsets touched."""
        return int((self.gap_min_m < 0.0).sum())


class AttackArena:
    """A campaign ready to run: one compiled program for any number of cases.

    Args:
        campaign: The campaign.
    """

    def __init__(self, campaign: AttackCampaign) -> None:
        import jax

        self.campaign = campaign
        section = load_line(campaign.line).section(campaign.origin, campaign.destination)
        known = [each if isinstance(each, Trainset) else load_trainset(each) for each in campaign.trainsets]
        convoy = Convoy(
            section,
            tuple(islice(cycle(known), campaign.count)),
            guard=campaign.guard,
            allowed=(campaign.disturbances.extreme(0), campaign.disturbances.extreme(1)),
            dt=campaign.dt,
        )
        self.dt, self.rows = convoy.dt, round(ROWS_S / convoy.dt)
        self.steps = round(LONGEST_S / convoy.dt)
        rows = convoy_members(convoy, np.float32)
        members: Member = stack_rows(rows)
        self.members: Member = to_jax(members)
        # All of them remember as many commands as the one with the longest dead time.
        alike = [_member(members, k) for k in range(campaign.count)]
        longest_s = float(members.vehicle.delay_s.max()) + campaign.disturbances.delay_s[1]
        first = [
            at_departure(m, a, self.dt, delay_s=longest_s - float(m.vehicle.delay_s))
            for m, a in zip(alike, (None, *alike[:-1]), strict=True)
        ]
        self.first: MemberState = to_jax(stack_rows(first))
        heads = recordings(
            *replace(convoy, guard="coupled").leader(), self.dt, ATTACKED_HEADS, campaign.seed, self.rows
        )
        self.heads = to_jax(stack_rows(heads))
        self.follower = FOLLOWERS.make("follow_plan")
        longest = members.believed.delay_s.max()
        memory = [self.follower.init(m.believed._replace(delay_s=longest), self.dt) for m in rows]
        self.memory = to_jax(stack_rows(memory))
        self._run = jax.jit(jax.vmap(self._case))

    def run(self, cases: int, batch: int = 2000, first: int = 0) -> Tally:
        """Run a number of cases.

        Args:
            cases: Number of cases, rounded up to whole batches.
            batch: Cases in one batch.
            first: Number of the first batch; batches with other numbers have other cases.
        """
        import jax

        found = []
        for k in range(first, first - (-cases // batch)):
            keys = jax.random.split(jax.random.fold_in(jax.random.key(self.campaign.seed), k), batch)
            found.append([np.asarray(values) for values in self._run(keys)])
        return Tally(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def _draw(self, key: Array) -> AttackCase:
        import jax
        import jax.numpy as jnp

        c, n, f32 = self.campaign, self.campaign.count, jnp.float32
        keys = jax.random.split(key, 4)
        u = jax.random.uniform(keys[0], (8,), f32)
        each = jax.random.uniform(keys[1], (c.disturbances.quantities_drawn + 1, n), f32)
        row = jax.random.randint(keys[2], (), 0, ATTACKED_HEADS)
        stop = jnp.sum((self.heads.speed_mps[row] > 0.0).astype(jnp.int32))
        silent = jnp.where(u[4] < c.silence, u[5] * 2.0 * LONGEST_EMERGENCY_S, jnp.inf)
        quality = LinkQuality(c.delay_s * u[1], c.jitter_s * u[2], c.loss * u[3], silent.astype(f32))
        corner = jnp.round(each)
        each = jnp.where(u[6] < 0.5, corner, each)
        return AttackCase(
            row=row,
            period=(u[0] * 0.95 * stop.astype(f32)).astype(jnp.int32),
            emergency_s=LONGEST_EMERGENCY_S * u[7],
            disturbance=self.disturbance(each),
            scatter=c.scatter_mps2 * each[-1],
            quality=jax.tree.map(lambda x: jnp.broadcast_to(x, (n,)), quality),
            manner=jax.random.randint(keys[3], (n,), 0, len(HARMFUL)),
            share=jax.random.uniform(jax.random.fold_in(key, 9), (n,), f32, -1.0, 1.0),
        )

    def disturbance(self, shares: Array) -> dict[str, Array]:
        """The disturbance of every trainset from random numbers in [0, 1). Each of shape (N,).

        Args:
            shares: One row for each quantity that is no constant, and more. Shape (rows, N).
        """
        import jax.numpy as jnp

        drawn = draw_disturbance(self.campaign.disturbances, iter(shares))
        return {name: jnp.broadcast_to(value, (self.campaign.count,)) for name, value in drawn.items()}

    def _actual(self, case: AttackCase) -> Member:
        """The true plants of this case."""
        import jax
        import jax.numpy as jnp

        m, drawn = self.members, case.disturbance
        mismatch = {name: drawn[name] for name in self.campaign.disturbances.mismatches}
        vehicle = jax.vmap(lambda nominal, own: true_vehicle(nominal, **own))(m.believed, mismatch)
        weaker = jnp.where(m.is_head, 0.0, case.scatter)
        vehicle = vehicle._replace(
            emergency_n=vehicle.emergency_n
            - (0.0 if self.campaign.guard == "coupled" else weaker) * vehicle.effective_mass_kg
        )
        return m._replace(
            vehicle=vehicle,
            link=case.quality,
            most_mps2=m.most_mps2 - weaker,
            speed_noise_mps=drawn["speed_noise_mps"],
        )

    def _place(self, convoy: Member, case: AttackCase) -> MemberState:
        """States in motion behind the head, at the desired gap or the one that protection needs if larger."""
        import jax
        import jax.numpy as jnp

        x, v = self.heads.position_m[case.row, case.period], self.heads.speed_mps[case.row, case.period]
        share = jnp.clip(self.heads.command[case.row, jnp.maximum(case.period - 1, 0)], -1.0, 1.0)
        a = self.heads.acceleration_mps2[case.row, case.period]
        n = self.campaign.count
        zero, all_ = jnp.zeros((), jnp.float32), jnp.ones((n,), jnp.float32)
        first = self.first
        plant = first.plant._replace(
            speed_mps=v * all_,
            acceleration_mps2=a * all_,
            share=share * all_,
            pipeline=jnp.broadcast_to(share, first.plant.pipeline.shape).astype(jnp.float32),
        )

        def behind(gap: Array) -> MemberState:
            front = x - jnp.cumsum(jnp.concatenate([zero[None], convoy.length_m[:-1] + gap[1:]]))
            rear = jnp.concatenate([zero[None] + FAR_M, (front - convoy.length_m)[:-1]])
            head = convoy.is_head
            told = Message(
                zero * all_,
                rear,
                jnp.where(head, 0.0, v),
                jnp.where(head, 0.0, a),
                jnp.where(head, 0.0, share),
                zero * all_,
            )
            channel = Channel(first.channel.sent, first.channel.due_s, told)
            watched = first.watched
            if watched is not None:
                watched = watched._replace(
                    recent=jnp.broadcast_to(jnp.maximum(share, 0.0), watched.recent.shape),
                    share=jnp.maximum(share, 0.0) * all_,
                    acceleration_mps2=jnp.maximum(a, 0.0) * all_ + jnp.abs(a) * 0.5,
                )
            return first._replace(
                plant=plant._replace(position_m=front),
                measured_mps=plant.speed_mps,
                channel=channel,
                watched=watched,
                command=share * all_,
            )

        if first.watched is None or convoy.protection is None:
            return behind(convoy.gap_m)
        trial = behind(convoy.gap_m)
        watched: Any = trial.watched
        # The link may already be as late as it can get; the last message is taken to be fresh.
        ahead = jax.vmap(ahead_of, (0, 0, None))(convoy, trial, zero)
        spare = jax.vmap(spare_gap)(
            convoy.protection,
            watched,
            trial.plant.position_m,
            trial.plant.speed_mps,
            trial.command,
            ahead,
        )
        return behind(convoy.gap_m + jnp.maximum(-spare, 0.0) + 0.01)

    def _plans(self, convoy: Member, case: AttackCase, states: MemberState) -> Plans:
        """Planned motions: the recorded run of the head, at the gaps that the case begins with."""
        import jax.numpy as jnp

        front = states.plant.position_m
        rear = jnp.concatenate([front[:1], (front - convoy.length_m)[:-1]])
        each = jnp.ones_like(front)
        start_s = -case.period.astype(jnp.float32) * jnp.float32(self.dt) * each
        x, v = self.heads.position_m[case.row], self.heads.speed_mps[case.row]

        def motion_behind(at_m: Array) -> MotionPlan:
            behind_m = jnp.expand_dims(front[0] - at_m, 1)
            speed = jnp.broadcast_to(v, (front.shape[0], v.shape[0]))
            return MotionPlan(start_s, jnp.float32(self.dt) * each, jnp.expand_dims(x, 0) - behind_m, speed)

        return Plans(motion_behind(rear), motion_behind(front), each, each)

    def _case(self, key: Array) -> tuple[Array, ...]:
        """Draw one attack and run it."""
        import jax
        import jax.numpy as jnp

        case = self._draw(jax.random.fold_in(key, 0))

        def choose(k: Array, memory: Array, last: Array) -> Choice:
            mine = jax.random.fold_in(key, k + 1)
            draw = jax.random.uniform(mine, (self.campaign.count, 4), jnp.float32)
            luck = draw[:, :2]
            if self.campaign.disturbances.speed_noise_mps[1] > 0.0:
                error = jax.random.uniform(jax.random.fold_in(mine, 1), (self.campaign.count, 1), jnp.float32)
                luck = jnp.concatenate([luck, error], axis=1)
            return luck, lambda seen: self._shares(case, seen, memory, last, draw)

        return self.run_case(case, choose)

    def run_case(self, case: AttackCase, chosen: Chosen) -> tuple[Array, ...]:
        """Run one attack to its end (JAX); returns the fields of :class:`Tally`, 0-d.

        Args:
            case: The attack.
            chosen: Random numbers of the link and commands of the followers in each period.
        """
        import jax
        import jax.numpy as jnp

        convoy = self._actual(case)
        states = self._place(convoy, case)
        dt = jnp.float32(self.dt)
        plans = self._plans(convoy, case, states)
        start, speed = gaps_m(convoy, states)[0], states.plant.speed_mps[0]

        def body(carry: tuple[Any, ...], k: Array) -> tuple[Any, None]:
            states, memory, last, least = carry
            now = k.astype(jnp.float32) * dt
            luck, shares_of = chosen(k, memory, last)
            states = exchange_messages(convoy, states, now, dt, luck[:, :2])
            noise = NOISE_CUT * (2.0 * luck[:, 2] - 1.0) if luck.shape[1] > 2 else None
            shares, memory = shares_of(observe_members(convoy, states, now, dt, plans))
            head = self.heads.command[case.row, jnp.minimum(case.period + k, self.rows - 1)]
            wanted = jnp.where(convoy.is_head, head, shares)
            alarm = convoy.is_head & (now >= case.emergency_s)
            states = advance_members(convoy, states, wanted, alarm, now, dt, noise)
            return (states, memory, wanted, jnp.minimum(least, jnp.min(gaps_m(convoy, states)))), None

        begin = (states, self.memory, case.share, jnp.float32(jnp.inf))
        (states, _, _, least), _ = jax.lax.scan(body, begin, jnp.arange(self.steps, dtype=jnp.int32))
        braked = 0 if states.watched is None else jnp.sum(states.watched.emergencies[1:])
        return least, start, speed, jnp.asarray(braked), jnp.all(states.plant.speed_mps <= 0.0)

    def _shares(
        self,
        case: AttackCase,
        seen: FollowerObservation,
        memory: Array,
        last: Array,
        draw: Array,
    ) -> tuple[Array, Array]:
        """Commands of the followers, by their behaviour."""
        import jax
        import jax.numpy as jnp

        good, memory = jax.vmap(self.follower.act)(memory, seen)
        full = jnp.ones_like(last)
        noise = 2.0 * draw[:, 2] - 1.0
        bang = jnp.where(draw[:, 3] < 0.05, jnp.sign(noise), last)
        late = jnp.where(seen.gap_m < 3.0, -1.0, 1.0)
        ways = jnp.stack([full, noise, bang, case.share, late, good])
        return ways[case.manner, jnp.arange(full.shape[0])], memory


def _member(members: Member, k: int) -> Member:
    """One of the members stacked by :func:`stack_rows` (NumPy)."""
    import jax

    return jax.tree.map(lambda values: values[k], members)


def attack(campaign: AttackCampaign, cases: int, batch: int = 2000) -> Tally:
    """Run a campaign; see :class:`AttackArena`."""
    return AttackArena(campaign).run(cases, batch)
