"""Small tasks with known answers: probes for critics, and two control problems.

The probes follow Andy Jones, "Debugging RL, without the agonizing pain" (2021), extended by truncation.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from metropilot.env import AbstractTask, ActionSpace, Transition

CONTINUOUS = ActionSpace(size=1)
TWO_CHOICES = ActionSpace(count=2)
FIVE_CHOICES = ActionSpace(count=5)
NO = jnp.zeros((), bool)


class Spot(NamedTuple):
    observation: jax.Array
    time: jax.Array


def transition(observation, reward, terminated, truncated):
    return Transition(observation, reward, terminated, truncated, {"only": reward})


def sign(key):
    return jnp.where(jax.random.bernoulli(key), 1.0, -1.0)


KINDS = ("constant", "observed", "discounted", "action", "both", "cut_off", "terminated")


@dataclass(frozen=True)
class Probe(AbstractTask):
    """All probes as one task: ``kind`` is an index into KINDS and may be traced: one program for all.

    constant     one step, reward 1
    observed     one step, reward equals the observation, -1 or 1
    discounted   two steps, observation 0 then 1, reward 1 at the second
    action       one step, reward 1 - (u - 0.5)^2; with choices 1 for the second and -1 for the first
    both         one step, reward u times the observation, -1 or 1
    cut_off      reward 1 for ever, cut off after every third step: V = 1 / (1 - gamma)
    terminated   reward 1, over after the third step; observations 0, 1/3, 2/3: V = 1 + g + g^2, 1 + g, 1
    """

    kind: jax.Array
    action_space: ActionSpace = CONTINUOUS
    observation_size: int = 1

    def reset(self, key):
        random = (self.kind == 1) | (self.kind == 4)
        observation = jnp.where(random, sign(key), 0.0)[None]
        return Spot(observation, jnp.zeros((), jnp.int32)), observation

    def step(self, key, state, action):
        u = action[0] if self.action_space.size else jnp.where(action == 1, 1.0, -1.0)
        seen, time = state.observation[0], state.time + 1
        liked = 1.0 - (u - 0.5) ** 2 if self.action_space.size else u
        one = jnp.ones(())
        rewards = (one, seen, jnp.where(time == 2, 1.0, 0.0), liked, u * seen, one, one)
        over = (~NO, ~NO, time == 2, ~NO, ~NO, NO, time == 3)
        third = time.astype(jnp.float32) / 3.0
        after = (seen, seen, one, seen, seen, seen, third)
        observation = jnp.stack(after)[self.kind][None]
        cut = (self.kind == 5) & (time == 3)
        new = Spot(observation, time)
        return new, transition(observation, jnp.stack(rewards)[self.kind], jnp.stack(over)[self.kind], cut)


class Cart(NamedTuple):
    position: jax.Array
    speed: jax.Array
    time: jax.Array


@dataclass(frozen=True)
class DoubleIntegrator(AbstractTask):
    """Bring a mass to rest at the origin: reward -(x^2 + 0.1 v^2 + 0.05 u^2), 40 steps of 0.2 s."""

    action_space: ActionSpace = CONTINUOUS
    observation_size: int = 2
    last: int = 40

    def reset(self, key):
        position = jax.random.uniform(key, (), jnp.float32, -1.0, 1.0)
        state = Cart(position, jnp.zeros(()), jnp.zeros((), jnp.int32))
        return state, jnp.stack([state.position, state.speed])

    def step(self, key, state, action):
        if self.action_space.size:
            u = jnp.clip(action[0], -1.0, 1.0)
        else:
            u = jnp.linspace(-1.0, 1.0, self.action_space.count)[action]
        speed = jnp.clip(state.speed + 0.2 * u, -2.0, 2.0)
        position = jnp.clip(state.position + 0.2 * speed, -2.0, 2.0)
        cost = position**2 + 0.1 * speed**2 + 0.05 * u**2
        time = state.time + 1
        observation = jnp.stack([position, speed])
        return Cart(position, speed, time), transition(observation, -cost, NO, time >= self.last)


def best_return(positions, steps=40):
    """Mean return of the linear-quadratic regulator, its command clipped, from rest (NumPy)."""
    A, B = np.array([[1.0, 0.2], [0.0, 1.0]]), np.array([[0.04], [0.2]])
    Q, R = np.diag([1.0, 0.1]), 0.05
    value, gains = np.zeros((2, 2)), []
    for _ in range(steps):
        cost = Q + value
        gain = np.linalg.solve(R + B.T @ cost @ B, B.T @ cost @ A)
        gains.append(gain)
        value = R * gain.T @ gain + (A - B @ gain).T @ cost @ (A - B @ gain)
    x, total = np.stack([positions, np.zeros_like(positions)]), 0.0
    for gain in reversed(gains):
        u = np.clip(-gain @ x, -1.0, 1.0)
        x = A @ x + B @ u
        total = total - (x[0] ** 2 + 0.1 * x[1] ** 2 + R * u[0] ** 2)
    return float(np.mean(total))


@dataclass(frozen=True)
class Masked(AbstractTask):
    """Five choices; those of the time's parity are allowed, ``forbidden`` counts others."""

    action_space: ActionSpace = FIVE_CHOICES
    observation_size: int = 2

    def reset(self, key):
        del key
        return jnp.zeros((), jnp.int32), jnp.zeros((2,))

    def step(self, key, state, action):
        del key
        wrong = jnp.where(self.action_mask(state)[action], 0.0, 1.0)
        state = state + 1
        observation = jnp.stack([state.astype(jnp.float32) / 5.0, (state % 2).astype(jnp.float32)])
        reward = action.astype(jnp.float32) / 4.0
        return state, Transition(observation, reward, state >= 5, NO, {"choice": reward, "forbidden": wrong})

    def action_mask(self, state):
        return jnp.arange(5) % 2 == state % 2
