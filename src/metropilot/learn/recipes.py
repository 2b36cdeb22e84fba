"""Recipes of the shipped drivers: task, learner and two budgets, one typed recipe a driver.

``metropilot learn`` and whoever ships a policy follow the same recipe; those of a paper are in its study.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot._registry import Registry, RegistryRow, did_you_mean
from metropilot._schema import field_specs
from metropilot.env import DrivingConfig, NotchAction, TaskSite, task_config
from metropilot.errors import InputError
from metropilot.learn import config as configs
from metropilot.learn.schedules import Schedule
from metropilot.policy import load_policy, shipped_policy

if TYPE_CHECKING:
    from metropilot.env import DrivingTask
    from metropilot.learn.loop import PolicyEvaluation
    from metropilot.learn.run_store import RunRecord
    from metropilot.learn.train import RunRequest

BUDGETS = ("quick", "paper")


@dataclass(frozen=True)
class Recipe:
    """Recipe by which a driver is learned.

    Attributes:
        task: Name of a registered task.
        paper: The learner's configuration that the shipped policy was learned with.
        shorter: Fields that the budget ``quick`` (about two minutes on two cores) sets otherwise.
        changes: Change of the task's configuration; None: none.
        evaluation: Evaluates a policy while it is learned; None: drives of the task from standstill.
    """

    task: str
    paper: configs.AbstractConfig
    shorter: Mapping[str, Any]
    changes: Callable[[DrivingConfig], DrivingConfig] | None = None
    evaluation: Callable[[configs.AbstractConfig, DrivingTask], PolicyEvaluation] | None = None

    @property
    def quick(self) -> configs.AbstractConfig:
        """The learner's configuration under the budget ``quick``."""
        return replace(self.paper, **self.shorter)

    @property
    def algorithm(self) -> str:
        """``ddpg dqn naf ppo sac tabular teacher``."""
        return self.paper.algorithm

    def configuration(self, budget: str = "paper", **values: Any) -> configs.AbstractConfig:
        """The learner's configuration.

        Args:
            budget: ``quick`` or ``paper``.
            values: Fields to set besides, as plain values.

        Raises:
            InputError: No such budget or field (the nearest is named), or a value out of range.
        """
        if budget not in BUDGETS:
            raise InputError("unknown budget", field="budget", value=budget, allowed=", ".join(BUDGETS))
        return configs.change_config(self.quick if budget == "quick" else self.paper, values)

    def task_configuration(self, name: str | None = None, site: TaskSite | None = None) -> DrivingConfig:
        """The task's configuration; another registered task than the recipe's is taken as it stands.

        Args:
            name: Name of a registered task; None: the recipe's.
            site: Line and trainset instead of the task's own.

        Raises:
            InputError: No such task (the nearest is named), or none that can be learned there.
        """
        config = task_config(name or self.task, site)
        return self.changes(config) if self.changes and name in (None, self.task) else config

    def make_task(self, name: str | None = None, site: TaskSite | None = None) -> DrivingTask:
        """The task itself.

        Args:
            name: Name of a registered task; None: the recipe's.
            site: Line and trainset instead of the task's own.

        Raises:
            InputError: No such task, or none that can be learned there.
        """
        from metropilot.env import DrivingTask

        return DrivingTask(self.task_configuration(name, site))


def new_request(
    driver: str,
    *,
    budget: str = "paper",
    task: str | None = None,
    site: TaskSite | None = None,
    seed: int = 0,
    command: str = "",
    **settings: Any,
) -> RunRequest:
    """Request of a new run of a recipe, for :func:`metropilot.learn.train.learn_run`.

    Args:
        driver: Id of the driver.
        budget: ``quick`` or ``paper``.
        task: Another registered task than the recipe's.
        site: Line and trainset to learn on instead of the task's own.
        seed: Of everything random.
        command: The command line that asks for it.
        settings: Fields of the learner's configuration to set, as plain values.

    Raises:
        InputError: No such driver, budget, task or field, a value out of range, or a task that cannot be
            learned on another line.
    """
    row, site = recipe(driver), site or TaskSite()
    config, name = row.configuration(budget, **settings), task or row.task
    return _request(config, row.make_task(name, site), name, seed, site=site, driver=driver, command=command)


def resume_request(record: RunRecord, folder: Path) -> RunRequest:
    """Request to go on with a run, for :func:`metropilot.learn.train.learn_run`.

    Args:
        record: Its record.
        folder: Its folder, which has copies of a line and a trainset that are no entries of the catalogue.

    Raises:
        InputError: The run is of no recipe, or its task is no more.
    """
    site = TaskSite(**{name: record.about[name] for name in field_specs(TaskSite) if name in record.about})
    made = recipe(record.driver).make_task(record.task, site.in_folder(folder))
    more: dict[str, Any] = {"site": site, "driver": record.driver, "command": record.command}
    return _request(record.configuration(), made, record.task, record.seed, **more)


def _request(config: configs.AbstractConfig, task: DrivingTask, *named: Any, **more: Any) -> RunRequest:
    from metropilot.learn.train import RunRequest

    return RunRequest(config, task, *named, interface=task.config.interface, **more)


def evaluation_of(request: RunRequest) -> PolicyEvaluation:
    """The early evaluation of a run: drives of its task from standstill.

    Raises:
        InputError: The learner does not take this kind of action, or not this task.
    """
    from metropilot.env import DrivingTask
    from metropilot.learn.imitation.train_state import imitation_spec
    from metropilot.learn.imitation.training import require_random_sections
    from metropilot.learn.loop import make_learner
    from metropilot.learn.policy_evaluation import DrivingEvaluation

    task = request.task
    if not isinstance(task, DrivingTask):
        raise InputError("only driving tasks are evaluated by driving", field="task", value=request.name)
    row = RECIPES.get(request.driver) if request.driver in RECIPES else None
    if row is not None and row.evaluation is not None and request.name == row.task:
        return row.evaluation(request.config, task)
    if isinstance(request.config, configs.TeacherConfig):
        require_random_sections(task)
        return DrivingEvaluation(task, imitation_spec(request.config, task.observation_size))
    return DrivingEvaluation(task, make_learner(request.config, task).spec)


def recipe(driver: str) -> Recipe:
    """The recipe of a driver.

    Raises:
        InputError: There is none (the nearest is named).
    """
    if driver not in RECIPES:
        words = f"no recipe for this driver{_learner_of(driver) or did_you_mean(driver, RECIPES)}"
        raise InputError(words, field="driver", value=driver, allowed=", ".join(RECIPES))
    return RECIPES.get(driver)


def _learner_of(driver: str) -> str:
    """Call that learns a driver without a recipe, as the file shipped with it says."""
    path = shipped_policy(driver)
    if not (driver.isidentifier() and path.is_file()):
        return ""
    provenance = load_policy(path)[1].get("provenance")
    return (
        f", it is learned by: {provenance['command']}"
        if isinstance(provenance, dict) and "command" in provenance
        else ""
    )


def _coarse(config: DrivingConfig) -> DrivingConfig:
    """One load, one scheduled time, three numbers to observe and five notches: what a table can hold."""
    return replace(
        config,
        trainsets=config.trainsets[:1],
        scenarios=replace(config.scenarios, time_ratio=(1.25, 1.25)),
        observer=("position", "speed", "time_left"),
        action=NotchAction((-0.5, 0.0, 0.3, 0.6, 1.0)),
    )


POWERS = 0.5
"""First action of an untrained policy: from standstill it would otherwise learn nothing at first."""
PPO_BASE = configs.PPOConfig(
    steps=20_000_000,
    environments=512,
    rollout=64,
    epochs=4,
    minibatches=16,
    gamma=1.0,
    lambda_=0.995,
    learning_rate=Schedule(1e-3, 1e-4),
    initial_bias=POWERS,
    min_std=Schedule(0.15, 0.01, shape="exponential"),
    normalise_observations=True,
    evaluations=10,
)
PPO_QUICK = {"steps": 4_000_000, "evaluations": 8}
REPLAY_BASE: dict[str, Any] = {
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
    "initial_bias": POWERS,
}
"""Of every learner with a replay memory and continuous actions."""
REPLAY_QUICK = {"steps": 100_000, "evaluations": 8}
TABLE_BASE = configs.TabularConfig(
    steps=20_000_000,
    environments=1024,
    rollout=32,
    gamma=1.0,
    bins=(40, 24, 24),
    low=(0.0, 0.0, 0.0),
    high=(1.0, 1.2, 1.2),
    learning_rate=Schedule(0.3, 0.02, shape="exponential"),
    epsilon=Schedule(0.5, 0.05),
    evaluations=16,
)

GENERALIST_QUICK = {
    "worlds": 200,
    "plans": 4,
    "states": 100,
    "batches": 4_000,
    "hidden": (64, 64),
    "decisions": 9_600,
    "steps": 480_000,
    "evaluations": 1,
}

RECIPES: Registry[Recipe] = Registry(
    "recipe",
    {
        "ppo": RegistryRow(Recipe("drive_both", PPO_BASE, PPO_QUICK), "PPO", "own, after Chen23a"),
        "ppo_scaled": RegistryRow(
            Recipe("drive_both", replace(PPO_BASE, reward_scaling=True), PPO_QUICK),
            "PPO with reward scaling",
            "own, after Chen23a",
        ),
        "ddpg": RegistryRow(
            Recipe("drive", configs.DDPGConfig(**REPLAY_BASE), REPLAY_QUICK), "DDPG", "Lillicrap16"
        ),
        "sac": RegistryRow(
            Recipe("drive", configs.SACConfig(**REPLAY_BASE), REPLAY_QUICK), "SAC", "Haarnoja18"
        ),
        "naf": RegistryRow(Recipe("drive", configs.NAFConfig(**REPLAY_BASE), REPLAY_QUICK), "NAF", "Gu16"),
        "eitop": RegistryRow(
            "metropilot.studies.huang2025.learning:EITOP_RECIPE", "PPO inside the expert", "Huang25"
        ),
        "itor": RegistryRow(
            "metropilot.studies.huang2025.learning:ITOR_RECIPE",
            "Q-learning in a table inside the expert",
            "Yin et al. 2014, compared in Huang25",
        ),
        "stod": RegistryRow(
            "metropilot.studies.huang2025.learning:STOD_RECIPE", "DDPG inside the expert", "Zhou et al. 2020"
        ),
        "ston": RegistryRow(
            "metropilot.studies.huang2025.learning:STON_RECIPE",
            "NAF inside the expert",
            "Zhou et al. 2020, compared in Huang25",
        ),
        "generalist": RegistryRow(
            Recipe("worlds", configs.TeacherConfig(), GENERALIST_QUICK),
            "imitation of the optimal plan, then closed-loop driving",
            "own",
        ),
        "dqn": RegistryRow("metropilot.studies.lu2023.learning:DQN_RECIPE", "DQN", "Lu23"),
        "improved_dqn": RegistryRow(
            "metropilot.studies.lu2023.learning:IMPROVED_DQN_RECIPE",
            "DQN, double, dueling, with prioritised replay",
            "Lu23",
        ),
        "tabular": RegistryRow(
            Recipe("drive_notches", TABLE_BASE, {"steps": 4_000_000, "evaluations": 8}, changes=_coarse),
            "Q-learning in a table, for one load and time",
            "own, after Huang25's ITOR",
        ),
    },
    field="driver",
    group="metropilot.recipes",
)
"""By id of the driver."""
