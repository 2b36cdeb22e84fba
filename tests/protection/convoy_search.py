"""Worst cases of a convoy: what an attack is made of; judged by how near two trainsets come to touching.

The head makes an emergency brake at a moment of a recorded run. An attack is that moment, every trainset's
disturbance and brake, the errors of its odometer, the link's quality, which of its messages are lost or late,
and a script of commands for every follower, all within what is declared.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tests.protection.optimiser import Worst, hunt, scatter, share

from metropilot.convoy import LONGEST_EMERGENCY_S, AttackArena, AttackCampaign, AttackCase, LinkQuality

HOLD = 5
LUCK_HOLD = 10
DIALS = 6


class Convoys:
    """A campaign's attacks as one compiled program; a place is one recorded run of the head.

    Args:
        campaign: What is attacked and what is declared.
    """

    def __init__(self, campaign: AttackCampaign) -> None:
        self.arena = AttackArena(campaign)
        self.count, self.steps = campaign.count, self.arena.steps
        self.script = -(-self.steps // HOLD)
        self.luck = -(-self.steps // LUCK_HOLD)
        self.drawn = campaign.disturbances.quantities_drawn + 1
        self.size = DIALS + self.drawn * self.count + self.script * (self.count - 1) + 3 * self.luck
        self._fly = jax.jit(jax.vmap(jax.vmap(self._one, in_axes=(None, 0))))

    def _one(self, row: Any, attack: Any) -> Any:
        """Minus the smallest gap of one attack."""
        c, n = self.arena.campaign, self.count
        u = share(attack.astype(jnp.float32))
        dials, each, rest = jnp.split(u, [DIALS, DIALS + self.drawn * n])
        each = each.reshape(self.drawn, n)
        scripts, luck = jnp.split(rest, [self.script * (n - 1)])
        scripts = 2.0 * scripts.reshape(n - 1, self.script) - 1.0
        luck = luck.reshape(3, self.luck)
        stop = jnp.sum((self.arena.heads.speed_mps[row] > 0.0).astype(jnp.int32))
        silent = jnp.where(dials[5] < 0.5, jnp.inf, 4.0 * (dials[5] - 0.5) * LONGEST_EMERGENCY_S)
        quality = LinkQuality(c.delay_s * dials[2], c.jitter_s * dials[3], c.loss * dials[4], silent)
        case = AttackCase(
            row=row,
            period=(dials[0] * 0.95 * stop.astype(jnp.float32)).astype(jnp.int32),
            emergency_s=LONGEST_EMERGENCY_S * dials[1],
            disturbance=self.arena.disturbance(each),
            scatter=c.scatter_mps2 * each[-1],
            quality=jax.tree.map(lambda x: jnp.broadcast_to(x, (n,)), quality),
            manner=jnp.zeros((n,), jnp.int32),
            share=jnp.concatenate([jnp.zeros((1,), jnp.float32), scripts[:, 0]]),
        )

        def chosen(k: Any, memory: Any, last: Any) -> Any:
            shares = jnp.concatenate([last[:1], scripts[:, k // HOLD]])
            return jnp.broadcast_to(luck[:, k // LUCK_HOLD], (n, 3)), lambda _: (shares, memory)

        return -self.arena.run_case(case, chosen)[0]

    def over(self, rows: np.ndarray) -> Any:
        """Value of every attack (P, population, D) behind these heads."""
        return lambda attacks: np.asarray(self._fly(rows.astype(np.int32), attacks.astype(np.float32)))

    def search(self, rows: np.ndarray, population: int, generations: int, seed: int) -> Worst:
        """CMA-ES, every second search begun with followers at full traction."""
        start = np.random.default_rng(seed).uniform(0.2, 0.8, (rows.size, self.size))
        first = DIALS + self.drawn * self.count
        start[::2, first : first + self.script * (self.count - 1)] = 0.9
        return hunt(self.over(rows), start, population, generations, seed)

    def scatter(self, rows: np.ndarray, population: int, generations: int, seed: int) -> Worst:
        """Random search with as many attacks."""
        return scatter(self.over(rows), rows.size, self.size, population, generations, seed)
