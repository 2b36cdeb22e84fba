"""Tasks by name: what learners, benchmarks and Gymnasium ids ask for; those of a paper are in its study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from inspect import signature
from typing import Any

from metropilot._registry import Registry, RegistryRow
from metropilot._schema import check_name
from metropilot.env.actions import CommandAction, IncrementAction, NotchAction
from metropilot.env.assists import Assists
from metropilot.env.config import (
    DOMAIN_ACTION,
    DOMAIN_ASSISTS,
    DOMAIN_OBSERVER,
    REWARDS,
    DomainRandomization,
    DrivingConfig,
)
from metropilot.env.driving import DrivingTask
from metropilot.env.randomization import DisturbanceDistribution, domain_sample
from metropilot.env.rewards import StopError
from metropilot.env.site import LINE, TaskSite
from metropilot.errors import InputError

ON_THE_WAY = 0.7
"""Episodes that begin on the way: a learner sees every state from the start (evaluate from standstill)."""
TIMES = DisturbanceDistribution(time_ratio=(1.08, 1.5), longest_s=130.0, on_the_way=ON_THE_WAY)
WIDER_TIMES = DisturbanceDistribution(time_ratio=(1.06, 1.6), longest_s=136.0, on_the_way=ON_THE_WAY)
"""A learner is better inside the range of its times than at their ends."""
LINE_TIMES = DisturbanceDistribution(time_ratio=(1.05, 1.4), on_the_way=ON_THE_WAY)
DISTURBED = DisturbanceDistribution(
    time_ratio=(1.08, 1.4),
    mass_factor=(0.9, 1.1),
    resistance_factor=(0.8, 1.2),
    delay_s=(0.0, 0.6),
    lag_s=(0.0, 0.3),
    speed_noise_mps=(0.0, 0.05),
    news=0.3,
    on_the_way=ON_THE_WAY,
)


def _config(
    site: TaskSite | None,
    times: DisturbanceDistribution,
    *,
    both: bool = False,
    whole_line: bool = False,
    **more: Any,  # noqa: ANN401 (fields of the configuration)
) -> DrivingConfig:
    """Configuration of a task whose sections and trainsets may be others.

    Args:
        site: Its line and trainset; None: its own.
        times: Distribution of its episodes.
        both: Also learn with ideal actuation.
        whole_line: Its own sections are all of the line.
        more: Other fields of the configuration.
    """
    own = TaskSite(line=LINE) if whole_line else TaskSite()
    given = site or own
    sections, trainsets = (given if given.line else own).loaded_sections(), given.loaded_trainsets()
    if given != own:
        times = replace(times, longest_s=None)
        more["most_decisions"] = None
        more["observer"] = DOMAIN_OBSERVER  # the tasks' own observers were chosen for one section
    if both:
        trainsets = (*(trainset.ideal() for trainset in trainsets), *trainsets)
    return DrivingConfig(sections, trainsets, times, **more)


def _drive(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, TIMES)


def _drive_jerk(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, TIMES, ideal=False)


def _drive_both(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, WIDER_TIMES, both=True, ideal=False, observer="section_jerk")


def _drive_line(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, LINE_TIMES, whole_line=True, observer="route")


EVALUATION_SEED, EVALUATION_DOMAINS = 987_654, 24
"""Domains of the evaluation; demonstrations are drawn from other seeds."""


def _random_domains() -> DrivingConfig:
    domains = [domain_sample(EVALUATION_SEED, k) for k in range(EVALUATION_DOMAINS)]
    return DomainRandomization(
        tuple(domain.section for domain in domains),
        tuple(domain.trainset for domain in domains),
        DisturbanceDistribution(time_ratio=(1.05, 1.4)),
        ideal=False,
        observer=DOMAIN_OBSERVER,
        action=DOMAIN_ACTION,
        assists=DOMAIN_ASSISTS,
        dt=0.2,
        periods=2,
        most_decisions=3000,
        spacing_m=2.0,
    )


def _drive_disturbed(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, DISTURBED, ideal=False)


def _drive_increment(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, TIMES, action=IncrementAction())


def _drive_notches(site: TaskSite | None = None) -> DrivingConfig:
    return _config(site, TIMES, action=NotchAction())


def _drive_unassisted(site: TaskSite | None = None) -> DrivingConfig:
    rewards = (*REWARDS, StopError(per_m=0.5))
    none = Assists(stop=False, ceiling=False)
    return _config(site, TIMES, action=CommandAction(), assists=none, rewards=rewards)


TASKS: Registry[Callable[..., DrivingConfig]] = Registry(
    "task",
    {
        "drive": RegistryRow(_drive, "RJ to WYJ, every load and time up to 130 s, ideal actuation"),
        "drive_jerk": RegistryRow(_drive_jerk, "The same with the trainset's jerk limit"),
        "drive_both": RegistryRow(_drive_both, "RJ to WYJ, every load, with and without jerk limit"),
        "drive_line": RegistryRow(_drive_line, "All sections of the Yizhuang line, both ways, every load"),
        "worlds": RegistryRow(_random_domains, "Random sections and trainsets (domain randomisation)"),
        "drive_disturbed": RegistryRow(
            _drive_disturbed, "RJ to WYJ with scatter, delay, noise and new times"
        ),
        "drive_increment": RegistryRow(_drive_increment, "RJ to WYJ by changes of the command (Huang25)"),
        "drive_notches": RegistryRow(_drive_notches, "RJ to WYJ by a table of notches"),
        "drive_unassisted": RegistryRow(
            _drive_unassisted, "RJ to WYJ without assists: the policy brakes itself"
        ),
        "chen2023a": RegistryRow(
            "metropilot.studies.chen2023a.setting:task_config",
            "YZQ to WHY in 80 s from position and speed (Chen23a)",
        ),
        "huang2025": RegistryRow(
            "metropilot.studies.huang2025.setting:task_config",
            "Four sections inside Huang25's expert: the change of the rate, continuous",
        ),
        "huang2025_choices": RegistryRow(
            "metropilot.studies.huang2025.setting:choice_task_config",
            "The same with three discrete changes (its ITOR)",
        ),
        "lu2023": RegistryRow(
            "metropilot.studies.lu2023.setting:task_config",
            "WHY to WYJ by twelve notches every 3 s, rewards and filter of Lu23, 118 to 142 s",
        ),
    },
    group="metropilot.tasks",
)
"""Every task: a function that makes its configuration; it reads the catalogue, so only when asked for.

Those that take a :class:`TaskSite` can be learned on any line."""


def task_config(name: str, site: TaskSite | None = None) -> DrivingConfig:
    """The configuration of a registered task.

    Args:
        name: Name of the task.
        site: Line and trainset instead of its own; scheduled times are then up to the task's highest ratio,
            and the policy observes what the driver for every line does.

    Raises:
        InputError: No such task (the nearest is named), it has only its own sections, or the site has no such
            line, section, trainset or load.
    """
    make = TASKS.get(name)
    if site is None or site == TaskSite():
        return make()
    if not signature(make).parameters:
        others = ", ".join(task for task in TASKS if signature(TASKS.get(task)).parameters)
        raise InputError(
            "the task has sections and trainsets of its own", field="task", value=name, allowed=others
        )
    return make(site)


def make_task(name: str, site: TaskSite | None = None, **changes: Any) -> DrivingTask:  # noqa: ANN401 (fields of the configuration)
    """A registered task, with some fields of its configuration changed.

    Args:
        name: Name of the task.
        site: Line and trainset instead of its own.
        changes: Fields of its configuration.

    Raises:
        InputError: No such task or field (the nearest is named), a value that a field cannot have, or a task
            that cannot be learned on another line.
    """
    config = task_config(name, site)
    for field in changes:
        check_name(field, (each.name for each in fields(config)), "field", field=field)
    return DrivingTask(replace(config, **changes))
