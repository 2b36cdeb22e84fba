"""How each driver of ours is learned: algorithm, configuration, task and budgets, one row a driver."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from metropilot.env import TASKS, DrivingConfig, task_config
from metropilot.env.actions import NotchAction
from metropilot.env.expert_action import ExpertAction
from metropilot.errors import InputError
from metropilot.learn.config import TeacherConfig
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.config_reading import config_from_mapping
from metropilot.policy import load_policy, shipped_policy

if TYPE_CHECKING:
    from metropilot.env import DrivingTask
    from metropilot.learn.loop import Evaluate
    from metropilot.learn.run_store import RunRecord
    from metropilot.learn.train import RunRequest

BUDGETS = ("quick", "paper")


@dataclass(frozen=True)
class Recipe:
    """How a driver is learned.

    Attributes:
        summary: One line for ``metropilot learn --help`` and errors.
        source: Paper or "own".
        algorithm: ``ddpg dqn naf ppo sac tabular``.
        task: Name of a registered task.
        config: What the learner is told beyond its algorithm's defaults.
        quick: What is told otherwise under the budget ``quick`` (about two minutes on two cores).
        changes: What is changed of the task's configuration; None: nothing.
    """

    summary: str
    source: str
    algorithm: str
    task: str
    config: Mapping[str, Any] = field(default_factory=dict)
    quick: Mapping[str, Any] = field(default_factory=dict)
    changes: Callable[[DrivingConfig], DrivingConfig] | None = None

    def configuration(self, budget: str = "paper", **told: Any) -> AbstractConfig:
        """What the learner is told.

        Args:
            budget: ``quick`` or ``paper``.
            told: Fields to set besides, as plain values.

        Raises:
            InputError: No such budget or field (the nearest is named), or a value out of range.
        """
        if budget not in BUDGETS:
            raise InputError("unknown budget", field="budget", value=budget, allowed=", ".join(BUDGETS))
        quick = self.quick if budget == "quick" else {}
        return config_from_mapping(self.algorithm, {**self.config, **quick, **told})

    def task_configuration(self, name: str | None = None) -> DrivingConfig:
        """What the task is made of; another registered task than the recipe's is taken as it stands.

        Raises:
            InputError: No such task (the nearest is named).
        """
        if name is None or name == self.task:
            config = task_config(self.task)
            return self.changes(config) if self.changes else config
        if name not in TASKS:
            raise InputError(
                f"unknown task{nearest(name, TASKS)}", field="task", value=name, allowed=", ".join(TASKS)
            )
        return task_config(name)

    def make_task(self, name: str | None = None) -> DrivingTask:
        """The task itself.

        Raises:
            InputError: No such task.
        """
        from metropilot.env import DrivingTask

        return DrivingTask(self.task_configuration(name))


def new_request(
    driver: str,
    *,
    budget: str = "paper",
    task: str | None = None,
    seed: int = 0,
    command: str = "",
    **told: Any,
) -> RunRequest:
    """What to ask of :func:`metropilot.learn.train.learn_run` for a new run of a recipe.

    Args:
        driver: Id of the driver.
        budget: ``quick`` or ``paper``.
        task: Another registered task than the recipe's.
        seed: Of everything random.
        command: The command line that asks for it.
        told: Fields of the learner's configuration to set, as plain values.

    Raises:
        InputError: No such driver, budget, task or field, or a value out of range.
    """
    row = recipe(driver)
    return _request(driver, row.configuration(budget, **told), task or row.task, seed, command)


def resumed_request(record: RunRecord) -> RunRequest:
    """What to ask of :func:`metropilot.learn.train.learn_run` to go on with a run.

    Raises:
        InputError: The run is of no recipe, or its task is no more.
    """
    return _request(record.driver, record.configuration(), record.task, record.seed, record.command)


def _request(driver: str, config: AbstractConfig, task: str, seed: int, command: str) -> RunRequest:
    from metropilot.learn.train import RunRequest

    made = recipe(driver).make_task(task)
    perception = made.config.perception
    return RunRequest(config, made, task, seed, driver=driver, perception=perception, command=command)


def evaluation_of(request: RunRequest) -> Evaluate:
    """The early evaluation of a run: drives of its task from standstill.

    Raises:
        InputError: The learner does not take this kind of action, or not this task.
    """
    from metropilot.env import DrivingTask
    from metropilot.learn.imitation.course import only_worlds
    from metropilot.learn.imitation.pupil import pupil_spec
    from metropilot.learn.policy_evaluation import DrivingEvaluation
    from metropilot.learn.registry import make_learner

    task = request.task
    if not isinstance(task, DrivingTask):
        raise InputError("only driving tasks are evaluated by driving", field="task", value=request.name)
    if isinstance(request.config, TeacherConfig):
        only_worlds(task)
        return DrivingEvaluation(task, pupil_spec(request.config, task.observation_size))
    return DrivingEvaluation(task, make_learner(request.config, task).spec)


def nearest(name: str, names: Iterable[str]) -> str:
    """``, did you mean X?`` where something is like it."""
    near = get_close_matches(name, names, 1)
    return f", did you mean {near[0]}?" if near else ""


def recipe(driver: str) -> Recipe:
    """The recipe of a driver.

    Raises:
        InputError: There is none (the nearest is named).
    """
    if driver not in RECIPES:
        words = f"no recipe for this driver{_learned_by(driver) or nearest(driver, RECIPES)}"
        raise InputError(words, field="driver", value=driver, allowed=", ".join(RECIPES))
    return RECIPES[driver]


def _learned_by(driver: str) -> str:
    """What to call for a driver that is learned otherwise, as the file shipped with it says."""
    path = shipped_policy(driver)
    if not (driver.isidentifier() and path.is_file()):
        return ""
    told = load_policy(path)[1].get("provenance")
    return f", it is learned by: {told['command']}" if isinstance(told, dict) and "command" in told else ""


def _coarse(config: DrivingConfig) -> DrivingConfig:
    """One load, one scheduled time, three numbers to observe and five notches: what a table can hold."""
    return replace(
        config,
        trainsets=config.trainsets[:1],
        scenarios=replace(config.scenarios, time_ratio=(1.25, 1.25)),
        observer=("position", "speed", "time_left"),
        action=NotchAction((-0.5, 0.0, 0.3, 0.6, 1.0)),
    )


def _gentle(config: DrivingConfig) -> DrivingConfig:
    """The acceleration of the paper's second rule."""
    return replace(config, action=ExpertAction(start_mps2=0.6))


PPO: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 20_000_000,
        "environments": 512,
        "rollout": 64,
        "epochs": 4,
        "minibatches": 16,
        "gamma": 1.0,
        "lambda_": 0.995,
        "learning_rate": {"start": 1e-3, "end": 1e-4},
        "initial_bias": 0.5,
        "min_std": {"start": 0.15, "end": 0.01, "shape": "exponential"},
        "normalise_observations": True,
        "evaluations": 10,
    }
)
PPO_QUICK: Mapping[str, Any] = MappingProxyType({"steps": 4_000_000, "evaluations": 8})
EXPERT: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 3_000_000,
        "environments": 128,
        "minibatches": 8,
        "hidden": (32, 32),
        "normalise_observations": False,
        "evaluations": 12,
    }
)
EXPERT_QUICK: Mapping[str, Any] = MappingProxyType({"steps": 1_000_000, "evaluations": 6})
REPLAY: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 400_000,
        "environments": 32,
        "updates": 16,
        "batch_size": 256,
        "buffer_size": 131_072,
        "warmup": 8_000,
        "gamma": 0.995,
        "n_step": 5,
        "reward_factor": 0.1,
        "evaluations": 16,
    }
)
REPLAY_QUICK: Mapping[str, Any] = MappingProxyType({"steps": 100_000, "evaluations": 8})
BEGINS: Mapping[str, Any] = MappingProxyType({"initial_bias": 0.5})
"""An untrained policy that powers: from standstill it would otherwise learn nothing at first."""
NOTCHES: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 160_000,
        "environments": 8,
        "updates": 4,
        "buffer_size": 40_000,
        "gamma": 1.0,
        "reward_factor": 0.005,
        "hidden": (128, 256),
        "huber": 2.0,
        "normalise_observations": True,
        "learning_rate": {"start": 1e-3, "end": 3e-5, "shape": "exponential"},
        "epsilon": {"start": 0.5, "end": 0.05, "over": 0.3, "shape": "exponential"},
        "evaluations": 20,
    }
)
NOTCHES_QUICK: Mapping[str, Any] = MappingProxyType({"steps": 40_000, "evaluations": 10})
IMPROVED: Mapping[str, Any] = MappingProxyType({"double": True, "dueling": True, "prioritised": True})
TABLE: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 20_000_000,
        "environments": 1024,
        "rollout": 32,
        "gamma": 1.0,
        "bins": (40, 24, 24),
        "low": (0.0, 0.0, 0.0),
        "high": (1.0, 1.2, 1.2),
        "learning_rate": {"start": 0.3, "end": 0.02, "shape": "exponential"},
        "epsilon": {"start": 0.5, "end": 0.05},
        "evaluations": 16,
    }
)
EXPERT_TABLE: Mapping[str, Any] = MappingProxyType(
    {
        "steps": 8_000_000,
        "environments": 256,
        "bins": (40, 24, 1, 4, 1, 12, 1),
        "low": (0.0, 0.0, 0.0, -0.6, 0.0, -3.0, -1.0),
        "high": (2.0, 1.2, 2.0, 0.6, 1.2, 3.0, 1.0),
    }
)
"""Of what the expert's policies see, a table holds distance, speed, the rate, how late coasting would be."""
EXPERT_REPLAY: Mapping[str, Any] = MappingProxyType(
    {
        **BEGINS,
        "steps": 160_000,
        "updates": 8,
        "batch_size": 128,
        "hidden": (64, 64),
        "gamma": 0.999,
        "n_step": 10,
        "noise": {"start": 0.6, "end": 0.1},
        "evaluations": 16,
    }
)
TEACHER_QUICK: Mapping[str, Any] = MappingProxyType(
    {
        "worlds": 200,
        "plans": 4,
        "states": 100,
        "batches": 4_000,
        "hidden": (64, 64),
        "decisions": 9_600,
        "steps": 480_000,
        "evaluations": 1,
    }
)

RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        "ppo": Recipe("PPO", "own, after Chen23a", "ppo", "drive_both", PPO, PPO_QUICK),
        "ppo_scaled": Recipe(
            "PPO with reward scaling",
            "own, after Chen23a",
            "ppo",
            "drive_both",
            {**PPO, "reward_scaling": True},
            PPO_QUICK,
        ),
        "ddpg": Recipe("DDPG", "Lillicrap16", "ddpg", "drive", {**REPLAY, **BEGINS}, REPLAY_QUICK),
        "sac": Recipe("SAC", "Haarnoja18", "sac", "drive", {**REPLAY, **BEGINS}, REPLAY_QUICK),
        "naf": Recipe("NAF", "Gu16", "naf", "drive", {**REPLAY, **BEGINS}, REPLAY_QUICK),
        "eitop": Recipe(
            "PPO inside the expert", "Huang25", "ppo", "huang2025", {**PPO, **EXPERT}, EXPERT_QUICK
        ),
        "itor": Recipe(
            "Q-learning in a table inside the expert",
            "Yin et al. 2014, compared in Huang25",
            "tabular",
            "huang2025_choices",
            {**TABLE, **EXPERT_TABLE},
            {"steps": 2_000_000, "evaluations": 8},
        ),
        "stod": Recipe(
            "DDPG inside the expert",
            "Zhou et al. 2020",
            "ddpg",
            "huang2025",
            {**REPLAY, **EXPERT_REPLAY},
            REPLAY_QUICK,
            _gentle,
        ),
        "ston": Recipe(
            "NAF inside the expert",
            "Zhou et al. 2020, compared in Huang25",
            "naf",
            "huang2025",
            {**REPLAY, **EXPERT_REPLAY},
            REPLAY_QUICK,
            _gentle,
        ),
        "generalist": Recipe(
            "the optimal plan as a teacher, then drives in closed loop",
            "own",
            "teacher",
            "worlds",
            {},
            TEACHER_QUICK,
        ),
        "dqn": Recipe("DQN", "Lu23", "dqn", "lu2023", NOTCHES, NOTCHES_QUICK),
        "improved_dqn": Recipe(
            "DQN, double, dueling, with prioritised replay",
            "Lu23",
            "dqn",
            "lu2023",
            {**NOTCHES, **IMPROVED},
            NOTCHES_QUICK,
        ),
        "tabular": Recipe(
            "Q-learning in a table, for one load and time",
            "own, after Huang25's ITOR",
            "tabular",
            "drive_notches",
            TABLE,
            {"steps": 4_000_000, "evaluations": 8},
            _coarse,
        ),
    }
)
"""By id of the driver."""
