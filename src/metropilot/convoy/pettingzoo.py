"""PettingZoo environment of a convoy: every follower is an agent, behind one recorded head.

The task of :mod:`metropilot.convoy.env` with any number of followers: the same state, actions and reward for
each, the same plants and links, in NumPy float64 as ``metropilot convoy`` runs them. Needs the extra ``rl``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from metropilot._schema import Range, check_number
from metropilot.control import Errors, incremental_pid
from metropilot.convoy.drivers.follow_pid import STATE, chen2023b_state, gains_of
from metropilot.convoy.env import MAX_PERIODS, ConvoyTaskConfig, follow_terms
from metropilot.convoy.leaders import recordings
from metropilot.convoy.model import TRAINSETS, Convoy, LinkQuality, Member, convoy_members
from metropilot.convoy.step import (
    UNLIMITED_MPS,
    FollowerObservation,
    MemberState,
    at_departure,
    drive_period,
    make_message,
    observe_member,
    receive_message,
    update_needed_gap,
)
from metropilot.env import NOMINAL, ActionSpace, draw_disturbance
from metropilot.errors import InputError
from metropilot.physics import Command
from metropilot.railway import load_line, load_trainset
from metropilot.sim import true_vehicle

OBSERVATION_LIMIT = 100.0
STANDS_S = 8.0
GAINS = ActionSpace(size=3)


class ConvoyParallelEnv(ParallelEnv[str, np.ndarray, np.ndarray]):
    """A convoy from standstill to standstill; episodes end for all agents at once.

    An episode terminates on a contact; it is truncated when all stand or at the end of the recording.

    Args:
        config: Plant, reward and disturbances; only the first of ``trainsets`` is used, and every episode
            begins at the station (``on_the_way`` is not used).
        count: Trainsets, the head included.
        protected: True for followers under protection; as published they have none.
        render_mode: Must be None: there is no rendering.

    Raises:
        InputError: Unknown line, station or trainset, or a number of trainsets out of range.
    """

    metadata = {"name": "metropilot_convoy_v0", "render_modes": []}  # noqa: RUF012 (API of PettingZoo)

    def __init__(
        self,
        config: ConvoyTaskConfig | None = None,
        count: int = 2,
        *,
        protected: bool = False,
        render_mode: str | None = None,
    ) -> None:
        check_number("count", count, int, TRAINSETS.range)
        self.config = config or ConvoyTaskConfig()
        self.render_mode = render_mode
        section = load_line(self.config.line).section(self.config.origin, self.config.destination)
        trainsets = (load_trainset(self.config.trainsets[0]),) * count
        worst = self.config.disturbances
        convoy = Convoy(
            section,
            trainsets,
            gap_m=self.config.gap_m,
            allowed=(worst.extreme(0), worst.extreme(1)),
            dt=self.config.dt,
        )
        rows = convoy_members(convoy)
        self.nominal = rows if protected else tuple(row._replace(protection=None) for row in rows)
        self.heads = recordings(
            *convoy.leader(), self.config.dt, self.config.heads, self.config.seed, MAX_PERIODS
        )
        self.possible_agents = [f"trainset_{k + 1}" for k in range(1, count)]
        self.agents: list[str] = []
        low, high = np.full(len(STATE), -OBSERVATION_LIMIT), np.full(len(STATE), OBSERVATION_LIMIT)
        self.observation_spaces = {
            agent: spaces.Box(low.astype(np.float32), high.astype(np.float32))
            for agent in self.possible_agents
        }
        self.action_spaces = {
            agent: spaces.Box(-1.0, 1.0, (GAINS.size,), np.float32) for agent in self.possible_agents
        }
        self.random = np.random.default_rng(self.config.seed)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The six state variables of Chen23b, scaled."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Three gains in [-1, 1], from the lower to the upper bounds of Chen23b table 1."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode with a random head, masses and links.

        Args:
            seed: Seed of this and the following episodes; None: continue the random stream.
            options: ``head``: number of the recorded head; everything else is ignored.

        Raises:
            InputError: A seed below zero.
        """
        if seed is not None:
            check_number("seed", seed, int, Range(low=0))
            self.random = np.random.default_rng(seed)
        config, draw = self.config, self.random
        row = int(draw.integers(len(self.heads)))
        self.head = self.heads[int((options or {}).get("head", row)) % len(self.heads)]
        off = float(draw.random() < config.disturbed)
        self.members = tuple(self._draw(k, own, off) for k, own in enumerate(self.nominal))
        late = draw.random() < config.emergency
        self.emergency_s = 1.0 + self.config.dt * self.head.command.size * draw.random() if late else np.inf
        ahead = (None, *self.members[:-1])
        self.states = [at_departure(own, a, config.dt) for own, a in zip(self.members, ahead, strict=True)]
        self.errors = [Errors(np.float64(0.0), np.float64(0.0)) for _ in self.members]
        self.period = 0
        self.agents = list(self.possible_agents)
        seen = self._listen()
        return self._observations(seen), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Apply the gains for one control period, then exchange messages.

        Raises:
            InputError: An agent has no action, or one that is not three finite numbers; beyond [-1, 1] they
                are clipped.
        """
        if not self.agents:
            raise gymnasium.error.ResetNeeded("call reset before step")
        for agent in self.agents:
            if agent not in actions:
                raise InputError("an agent without an action", field=agent, allowed=", ".join(self.agents))
            GAINS.check(actions[agent], field=agent)
        now, agents = self._now(), self.agents
        shares = [np.float64(self.head.command[min(self.period, MAX_PERIODS - 1)])]
        for k, agent in enumerate(agents, 1):
            seen, gains = (
                self.seen[k - 1],
                gains_of(np.clip(np.asarray(actions[agent], np.float64), -1.0, 1.0)),
            )
            closing = seen.ahead_mps - seen.speed_mps
            share, self.errors[k] = incremental_pid(seen.command, gains, closing, self.errors[k])
            shares.append(np.float64(share))
        late = now >= self.emergency_s
        for k, (own, state, share) in enumerate(zip(self.members, self.states, shares, strict=True)):
            noise = self.random.standard_normal() if own.speed_noise_mps > 0.0 else 0.0
            command = Command(share, bool(k == 0 and late))
            self.states[k] = drive_period(own, state, command, now, self._dt(), np.float64(noise))[0]
        changes = [share - seen.command for share, seen in zip(shares[1:], self.seen, strict=True)]
        wanted = [float(seen.wanted_gap_m) for seen in self.seen]
        self.period += 1
        seen = self._listen()
        infos = {agent: self._info(k) for k, agent in enumerate(agents, 1)}
        for agent, gap_m, change in zip(agents, wanted, changes, strict=True):
            found = infos[agent]
            terms = follow_terms(self.config, found["gap_m"], found["speed_difference_mps"], change, gap_m)
            found["terms"] = {name: float(value) for name, value in terms.items()}
        contact = any(found["gap_m"] < 0.0 for found in infos.values())
        still = all(float(state.plant.speed_mps) <= 0.0 for state in self.states)
        over = not contact and (self.period >= MAX_PERIODS or (still and float(self._now()) > STANDS_S))
        rewards = {agent: float(sum(found["terms"].values())) for agent, found in infos.items()}
        observations = self._observations(seen)
        if contact or over:
            self.agents = []
        return (
            observations,
            rewards,
            dict.fromkeys(agents, contact),
            dict.fromkeys(agents, over),
            infos,
        )

    def _draw(self, k: int, own: Member, off: float) -> Member:
        """Draw plant and link of a trainset for this episode; the head is nominal."""
        config, u = self.config, self.random.random(3)
        more = self.random.random(max(config.disturbances.quantities_drawn - 1, 0))
        drawn = draw_disturbance(config.disturbances, iter((u[0], *more)))
        if not (off and k):
            drawn = {name: np.float64(nominal) for name, (nominal, _) in NOMINAL.items()}
        numbers = (off * config.delay_s * u[1], 0.0, off * config.loss * u[2], np.inf)
        link = LinkQuality(*(np.float64(value) for value in numbers))
        mismatch = {name: np.float64(drawn[name]) for name in config.disturbances.mismatches}
        return own._replace(
            vehicle=true_vehicle(own.believed, **mismatch),
            speed_noise_mps=np.float64(drawn["speed_noise_mps"]),
            link=link,
        )

    def _now(self) -> np.float64:
        return np.float64(self.period * self.config.dt)

    def _dt(self) -> np.float64:
        return np.float64(self.config.dt)

    def _listen(self) -> list[FollowerObservation]:
        """Exchange messages along the convoy; returns the observations of the followers."""
        now, dt, before = self._now(), self._dt(), list(self.states)
        self.seen: list[FollowerObservation] = []
        for k in range(1, len(self.members)):
            own, message = self.members[k], make_message(self.members[k - 1], before[k - 1], now)
            state = receive_message(own, before[k], message, self.random.random(2))
            self.states[k] = update_needed_gap(own, state, now, dt)
            self.seen.append(observe_member(own, self.states[k], now, dt, np.float64(UNLIMITED_MPS)))
        return self.seen

    def _observations(self, seen: list[FollowerObservation]) -> dict[str, np.ndarray]:
        return {
            agent: np.asarray(chen2023b_state(each), np.float32)
            for agent, each in zip(self.possible_agents, seen, strict=True)
        }

    def _info(self, k: int) -> dict[str, Any]:
        """True gap and speed difference of a follower, and the command after protection."""
        ahead: MemberState = self.states[k - 1]
        own = self.states[k]
        rear = ahead.plant.position_m - self.members[k - 1].length_m
        return {
            "time_s": float(self._now()),
            "gap_m": float(rear - own.plant.position_m),
            "speed_difference_mps": float(ahead.plant.speed_mps - own.plant.speed_mps),
            "command": float(own.command),
        }
