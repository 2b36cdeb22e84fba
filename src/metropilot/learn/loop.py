"""The one loop: a whole learning run is one function of a key, compiled as one program.

The run is cut into equal chunks. In each the learner iterates, then its policy is evaluated on the same
episodes as always, and the best is kept. :func:`learn` scans over the chunks; :mod:`metropilot.learn.train`
calls the same chunk from Python, so that progress, checkpoints and interruption are possible.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn import config as configs
from metropilot.learn import environments as env
from metropilot.learn.ddpg import DDPG
from metropilot.learn.dqn import DQN
from metropilot.learn.learner import AbstractLearner, LearnerState
from metropilot.learn.naf import NAF
from metropilot.learn.ppo import PPO
from metropilot.learn.sac import SAC
from metropilot.learn.tabular import TabularQ
from metropilot.policy import Params, Policy, act

LEARNERS: dict[type[configs.AbstractConfig], Callable[[Any, AbstractTask], AbstractLearner[Any]]] = {
    configs.DDPGConfig: DDPG,
    configs.DQNConfig: DQN,
    configs.NAFConfig: NAF,
    configs.PPOConfig: PPO,
    configs.SACConfig: SAC,
    configs.TabularConfig: TabularQ,
}


def make_learner(config: configs.AbstractConfig, task: AbstractTask) -> AbstractLearner[Any]:
    """The learner of a configuration on a task.

    Raises:
        InputError: The learner does not take this kind of action.
    """
    return LEARNERS[type(config)](config, task)


# What evaluates a policy: its parameters and a key in; numbers of shape () out, among them "score".
PolicyEvaluation = Callable[[Params, Array], dict[str, Array]]
Row = dict[str, Array]

jax.tree_util.register_dataclass(Policy, data_fields=["params"], meta_fields=["spec"])


class LoopState(NamedTuple):
    """Everything a run consists of: one pytree of arrays, which a checkpoint holds.

    Attributes:
        learner: State of the learner.
        best: Parameters of the best policy so far.
        best_score: Its score. Shape ().
        evaluation_key: The same all along: every evaluation drives the same episodes.
        iteration: Iterations done. Shape (), int32.
    """

    learner: LearnerState
    best: Params
    best_score: Array
    evaluation_key: Array
    iteration: Array


class Loop(NamedTuple):
    """A run as two pure functions.

    Attributes:
        learner: The algorithm on its task.
        evaluate: Evaluates its policy.
        iterations: Of one chunk.
        chunks: Of the run.
    """

    learner: AbstractLearner[Any]
    evaluate: PolicyEvaluation
    iterations: int
    chunks: int

    @property
    def steps(self) -> int:
        """Environment steps of the whole run: the configured number rounded up to whole chunks."""
        return self.chunks * self.iterations * self.learner.iteration_steps

    def init(self, key: Array) -> LoopState:
        """A run about to begin."""
        learner_key, evaluation_key = jax.random.split(key)
        state = self.learner.init(learner_key)
        worst = jnp.full((), -jnp.inf, jnp.float32)
        return LoopState(state, self.learner.policy(state), worst, evaluation_key, jnp.zeros((), jnp.int32))

    def chunk(self, state: LoopState) -> tuple[LoopState, Row]:
        """Learn for one chunk, evaluate, keep the better policy.

        Returns:
            The new state and one row of the history: steps so far, episodes that ended with their mean
            return, length and terms, the mean of each loss, and ``evaluation.*``; each of shape ().
        """
        total = self.chunks * self.iterations

        def iterate(carry: tuple[Any, Array], _: None) -> tuple[Any, Any]:
            learner, iteration = carry
            learner, report = self.learner.iterate(learner, iteration.astype(jnp.float32) / total)
            return (learner, iteration + 1), report

        carry, report = jax.lax.scan(iterate, (state.learner, state.iteration), None, length=self.iterations)
        learner, iteration = carry
        params = self.learner.policy(learner)
        evaluated = self.evaluate(params, state.evaluation_key)
        better = evaluated["score"] > state.best_score
        if self.learner.config.keep == "last":
            better = jnp.ones((), bool)
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), params, state.best)
        best_score = jnp.where(better, evaluated["score"], state.best_score)
        row = {
            "steps": iteration.astype(jnp.float32) * self.learner.iteration_steps,
            **_summary(report.finished),
        }
        row |= {name: jnp.mean(value) for name, value in report.losses.items()}
        row |= {f"evaluation.{name}": value for name, value in evaluated.items()}
        return LoopState(learner, best, best_score, state.evaluation_key, iteration), row


def _summary(finished: env.Finished) -> Row:
    """Means over the episodes that ended in a chunk; NaN where none did."""
    total = jax.tree.map(jnp.sum, finished)
    count = jnp.where(total.count > 0.0, total.count, jnp.nan)
    row = {"episodes": total.count, "return": total.returned / count, "length": total.length / count}
    return row | {f"term.{name}": value / count for name, value in total.terms.items()}


def make_loop(
    config: configs.AbstractConfig, task: AbstractTask, evaluate: PolicyEvaluation | None = None
) -> Loop:
    """A run ready to begin.

    Args:
        config: Configuration; its type chooses the learner.
        task: Task to learn.
        evaluate: Parameters and a key to numbers, among them ``score``, the higher the better; by default the
            mean return of ``evaluation_episodes`` episodes.

    Raises:
        InputError: The learner does not take this kind of action.
    """
    learner = make_learner(config, task)
    iterations = math.ceil(config.steps / config.evaluations / learner.iteration_steps)
    return Loop(learner, evaluate or default_evaluation(learner), iterations, config.evaluations)


def default_evaluation(learner: AbstractLearner[Any]) -> PolicyEvaluation:
    """Whole episodes of the policy without exploration; ``score`` is their mean return."""
    config = learner.config

    def evaluate(params: Params, key: Array) -> dict[str, Array]:
        driver = partial(act, learner.spec, params)
        row = env.evaluate(learner.task, driver, key, config.evaluation_episodes, config.evaluation_steps)
        return row | {"score": row["return"]}

    return evaluate


def learn(
    config: configs.AbstractConfig, task: AbstractTask, key: Array, evaluate: PolicyEvaluation | None = None
) -> tuple[Policy, Row]:
    """Learn a policy: one pure function of a key.

    ``jit(vmap(partial(learn, config, task)))(keys)`` learns many seeds at once.

    Args:
        config: Configuration; its type chooses the learner.
        task: Task to learn.
        key: Of ``jax.random.key(seed)``: the same key, the same bits.
        evaluate: See :func:`make_loop`.

    Returns:
        The policy kept (see ``config.keep``), and the history: arrays with one entry a chunk.
    """
    loop = make_loop(config, task, evaluate)
    state, history = jax.lax.scan(lambda s, _: loop.chunk(s), loop.init(key), None, length=loop.chunks)
    return Policy(loop.learner.spec, state.best), history
