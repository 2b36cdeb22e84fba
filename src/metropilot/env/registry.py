"""Tasks by name: what learners, benchmarks and Gymnasium ids ask for; those of a paper are in its study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
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
from metropilot.railway import Section, Trainset, load_line, load_trainset


def _loads(trainset: str = "dkz32") -> tuple[Trainset, ...]:
    loaded = load_trainset(trainset)
    return tuple(loaded.with_load(load) for load in loaded.loads)


def _one() -> tuple[Section, ...]:
    return (load_line("yizhuang").section("RJ", "WYJ"),)


def _all() -> tuple[Section, ...]:
    line = load_line("yizhuang")
    return (*line.sections(), *line.sections(backward=True))


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


def _drive() -> DrivingConfig:
    return DrivingConfig(_one(), _loads(), TIMES)


def _drive_jerk() -> DrivingConfig:
    return DrivingConfig(_one(), _loads(), TIMES, ideal=False)


def _drive_both() -> DrivingConfig:
    loads = _loads()
    both = (*(load.ideal() for load in loads), *loads)
    return DrivingConfig(_one(), both, WIDER_TIMES, ideal=False, observer="section_jerk")


def _drive_line() -> DrivingConfig:
    return DrivingConfig(_all(), _loads(), LINE_TIMES, observer="route")


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


def _drive_disturbed() -> DrivingConfig:
    return DrivingConfig(_one(), _loads(), DISTURBED, ideal=False)


def _drive_increment() -> DrivingConfig:
    return DrivingConfig(_one(), _loads(), TIMES, action=IncrementAction())


def _drive_notches() -> DrivingConfig:
    return DrivingConfig(_one(), _loads(), TIMES, action=NotchAction())


def _drive_unassisted() -> DrivingConfig:
    rewards = (*REWARDS, StopError(per_m=0.5))
    none = Assists(stop=False, ceiling=False)
    return DrivingConfig(_one(), _loads(), TIMES, action=CommandAction(), assists=none, rewards=rewards)


TASKS: Registry[Callable[[], DrivingConfig]] = Registry(
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
)
"""Every task: a function that makes its configuration; it reads the catalogue, so only when asked for."""


def task_config(name: str) -> DrivingConfig:
    """The configuration of a registered task.

    Raises:
        InputError: No such task (the nearest is named).
    """
    return TASKS.make(name)


def make_task(name: str, **changes: Any) -> DrivingTask:  # noqa: ANN401 (fields of the configuration)
    """A registered task, with some fields of its configuration changed.

    Raises:
        InputError: No such task or field (the nearest is named), or a value that a field cannot have.
    """
    config = task_config(name)
    for field in changes:
        check_name(field, (each.name for each in fields(config)), "field", field=field)
    return DrivingTask(replace(config, **changes))
