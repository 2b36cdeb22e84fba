"""Gymnasium environments of the driving tasks, for any library that learns on Gymnasium.

``import metropilot.env.adapters`` registers an id for every task; ``gymnasium.make("metropilot/Drive-v0")``
is the task ``drive``. Needs the extra ``rl``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, cast

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from metropilot._schema import Range, check_number
from metropilot._typing import Array
from metropilot.env.driving import DriveState, DrivingTask, episode_of
from metropilot.env.interface import Transition
from metropilot.env.randomization import StartDistribution
from metropilot.env.registry import TASKS, make_task
from metropilot.errors import InputError
from metropilot.protection import Memory
from metropilot.sim import CODES, RUNNING

OBSERVATION_LIMIT = 100.0
HIGHEST_SEED = 2**32 - 1
"""Of one environment of a vector: keys are made of 32 bits."""
LIMITS = {
    "case": (0.0, 0.0),
    "position_m": (0.0, 0.0),
    "speed_mps": (0.0, 60.0),
    "time_s": (0.0, 3600.0),
    "scheduled_s": (1.0, 3600.0),
    "mass_factor": (0.5, 2.0),
    "resistance_factor": (0.0, 5.0),
}
"""Quantities that ``options={"initial_state": {...}}`` may set, with their ranges; others are drawn. The task
determines the highest case, the case the last position."""

shared_task = cache(make_task)
"""Cached :func:`make_task`: a registered task is built and compiled once for all its environments."""


def observation_space(task: DrivingTask) -> spaces.Box:
    """Observation space of scaled features."""
    return spaces.Box(-OBSERVATION_LIMIT, OBSERVATION_LIMIT, (task.observation_size,), np.float32)


def action_space(task: DrivingTask) -> spaces.Box | spaces.Discrete:
    """Action space of numbers in [-1, 1], or of choices."""
    space = task.action_space
    if space.discrete:
        return spaces.Discrete(space.count)
    return spaces.Box(-1.0, 1.0, (space.size,), np.float32)


def place_start(
    task: DrivingTask,
    draw: Callable[[int | None], StartDistribution],
    options: object,
) -> StartDistribution:
    """Draw a start, with what ``options["initial_state"]`` says of it.

    Args:
        task: The task.
        draw: Draws an episode, in a case if one is given: timetable and restrictions are those of the case.
        options: Options of a reset.

    Raises:
        InputError: An unknown option, or a number that is not finite or out of range.
    """
    options = _table("options", options)
    given = _table("initial_state", options.get("initial_state"))
    unknown = (set(options) - {"initial_state"}) | (set(given) - set(LIMITS))
    if unknown:
        allowed, names = "initial_state: " + ", ".join(LIMITS), ", ".join(sorted(map(str, unknown)))
        raise InputError("unknown option", field="options", value=names, allowed=allowed)
    case = given.pop("case", None)
    if case is not None:
        case = int(number("case", case, 0, task.minimum_s.size - 1))
    start = draw(case)
    for name in (name for name in LIMITS if name in given):
        low, high = LIMITS[name]
        if name == "position_m":
            high = float(task.rows.case(start.case).length_m)
        value = number(name, given[name], low, high)
        start = start._replace(**{name: jnp.asarray(value, getattr(start, name).dtype)})
    return start


def _table(name: str, value: object) -> dict[Any, Any]:
    """Copy of a table of options; empty where there is none."""
    if not isinstance(value, Mapping | None):
        raise InputError("wrong kind of value", field=name, value=str(value), allowed="a table")
    return dict(value or {})


def number(name: str, value: Any, low: int | float, high: int | float) -> float:  # noqa: ANN401 (as a user gives it)
    """Convert a value to a number in a range, a whole one where the range is of whole numbers.

    Raises:
        InputError: The value is not a number, or out of range.
    """
    if getattr(value, "shape", None) == ():  # of an array of one number
        value = value.item()
    check_number(name, value, type(low), Range(low, high))
    return float(value)


class DriveEnv(gymnasium.Env[np.ndarray, Any]):
    """Gymnasium environment of one episode at a time.

    Args:
        task: A registered task's name, or a task.
        render_mode: None; rendering is not supported.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's way)

    def __init__(self, task: str | DrivingTask = "drive", render_mode: str | None = None) -> None:
        self.task = shared_task(task) if isinstance(task, str) else task
        self.render_mode = render_mode
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self._draw, self._begin, self._step = _compile(self.task)
        self._key, self._state = jax.random.key(0), None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode; ``options={"initial_state": {"position_m": 300.0}}`` places it (see ``LIMITS``)."""
        super().reset(seed=seed)
        self._key = jax.random.key(int(self.np_random.integers(2**31)))
        key = self._key
        start = place_start(self.task, lambda case: self._draw(key, case), options)
        self._state, observation = self._begin(start)
        return np.asarray(observation), self._info(self._state)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Take one decision.

        Raises:
            InputError: The action is none of the space, but numbers beyond [-1, 1] are clipped.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        self.task.action_space.check(action)
        self._key, key = _next_keys(self._key)
        self._state, transition = self._step(key, self._state, jnp.asarray(action))
        terms = {name: float(value) for name, value in transition.terms.items()}
        info = self._info(self._state) | {"terms": terms}
        return (
            np.asarray(transition.observation),
            float(transition.reward),
            bool(transition.terminated),
            bool(transition.truncated),
            info,
        )

    def _info(self, state: DriveState) -> dict[str, Any]:
        plant, outcome = state.plant, int(state.outcome)
        return {
            "time_s": float(plant.time_s),
            "position_m": float(plant.position_m),
            "speed_mps": float(plant.speed_mps),
            "energy_wheel_j": float(plant.traction_j),
            "interventions": int(cast("Memory", state.run.supervision).interventions),
            "outcome": "running" if outcome == RUNNING else CODES[outcome].value,
        }


class DriveVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, Any, np.ndarray]):
    """Vector environment in one compiled program; an episode that ended is reset in the next step.

    Args:
        task: A registered task's name, or a task.
        num_envs: Number of environments.

    Raises:
        InputError: No such task, or no environment.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, task: str | DrivingTask = "drive", num_envs: int = 1) -> None:
        check_number("num_envs", num_envs, int, Range(low=1))
        self.task = shared_task(task) if isinstance(task, str) else task
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._reset, self._step = _compile_batch(self.task)
        self._state = self._key = None
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin all episodes; one seed is counted up from the first environment, a list has one for each.

        Raises:
            InputError: Options, a list of seeds of another length, or a seed out of range.
        """
        if options:
            raise InputError("the vector environment takes no options", field="options", value=str(options))
        seeds = self._seeds(seed)
        super().reset(seed=seeds[0])
        drawn = self.np_random.integers(2**31, size=self.num_envs + 1)
        told = [int(drawn[k]) if s is None else s for k, s in enumerate(seeds)]
        self._key = jax.random.key(int(drawn[-1]))
        self._state, observation = self._reset(jax.vmap(jax.random.key)(np.asarray(told, np.uint32)))
        self._over[:] = False
        return np.asarray(observation), {}

    def _seeds(self, seed: Any) -> list[int | None]:  # noqa: ANN401 (as a user gives it)
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, Sequence | np.ndarray):
            check_number("seed", seed, int, Range(0, HIGHEST_SEED - self.num_envs + 1))
            return [seed + k for k in range(self.num_envs)]
        seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(
                "as many seeds as environments", field="seed", value=len(seeds), allowed=str(self.num_envs)
            )
        for own in seeds:
            if own is not None:
                check_number("seed", own, int, Range(0, HIGHEST_SEED))
        return seeds

    def step(
        self,
        actions: Any,  # noqa: ANN401 (whatever the space holds)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one decision in each environment; an episode that had ended is reset instead.

        Where episodes end, ``info["kpis"]`` has their KPIs, one array each, and ``info["_kpis"]`` is True.

        Raises:
            InputError: The actions are none of the space, but numbers beyond [-1, 1] are clipped.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        self.task.action_space.check(actions, (self.num_envs,))
        self._key, key = _next_keys(self._key)
        keys = jax.random.split(key, self.num_envs)
        self._state, found = self._step(keys, self._state, jnp.asarray(actions), jnp.asarray(self._over))
        terminated, truncated = np.array(found.terminated), np.array(found.truncated)
        self._over = terminated | truncated
        info: dict[str, Any] = {}
        if self._over.any():
            episode = jax.vmap(lambda s: episode_of(self.task, s))(self._state)
            # "episode" belongs to Gymnasium's wrapper RecordEpisodeStatistics
            info = {"kpis": {name: np.asarray(v) for name, v in episode._asdict().items()}}
            info["_kpis"] = self._over.copy()
        observation = np.asarray(found.observation)
        return observation, np.asarray(found.reward, np.float64), terminated, truncated, info


@cache
def _compile(task: DrivingTask) -> tuple[Any, Any, Any]:
    return jax.jit(task.draw), jax.jit(task.begin), jax.jit(task.step)


@cache
def _compile_batch(task: DrivingTask) -> tuple[Any, Any]:
    def one(key: Array, state: DriveState, action: Array, over: Array) -> tuple[DriveState, Transition]:
        # Both are computed for every environment: under ``vmap`` a ``cond`` would do the same.
        after, found = task.step(key, state, action)
        fresh, observation = task.reset(key)
        nothing = jax.tree.map(jnp.zeros_like, found)._replace(observation=observation)
        return jax.tree.map(lambda a, b: jnp.where(over, a, b), (fresh, nothing), (after, found))

    return jax.jit(jax.vmap(task.reset)), jax.jit(jax.vmap(one))


_next_keys = jax.jit(jax.random.split)


def environment_id(name: str) -> str:
    """Gymnasium's id of a registered task: ``drive_jerk`` is ``metropilot/DriveJerk-v0``."""
    return f"metropilot/{''.join(part.capitalize() for part in name.split('_'))}-v0"


def register_all() -> None:
    """Register every task with Gymnasium."""
    for name in TASKS:
        gymnasium.register(
            id=environment_id(name),
            entry_point="metropilot.env.adapters:DriveEnv",
            vector_entry_point="metropilot.env.adapters:DriveVectorEnv",
            kwargs={"task": name},
        )


register_all()
