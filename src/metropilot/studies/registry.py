"""Studies by id; a study's module is imported on first use."""

from __future__ import annotations

import time
from dataclasses import replace

from metropilot._provenance import circumstances
from metropilot._registry import Registry, RegistryRow
from metropilot.errors import InputError
from metropilot.studies.report import StudyReport
from metropilot.studies.study import Order, Study

STUDIES: Registry[Study] = Registry(
    "study",
    {
        "chen2023a": RegistryRow(
            "metropilot.studies.chen2023a.study:STUDY",
            "Driving by position and speed: PPO with reward scaling against PPO and DDPG",
        ),
        "chen2023b": RegistryRow(
            "metropilot.studies.chen2023b.study:STUDY",
            "Following in virtual coupling: SAC-PID against DDPG-PID, and what keeps convoys apart",
        ),
        "cheng2023": RegistryRow(
            "metropilot.studies.cheng2023.study:STUDY",
            "Tracking a reference: DDPG-PID against PID, fuzzy and neural PID",
        ),
        "huang2025": RegistryRow(
            "metropilot.studies.huang2025.study:STUDY",
            "Driving by an expert system, and PPO inside it, against manual driving and STON",
        ),
        "lu2023": RegistryRow(
            "metropilot.studies.lu2023.study:STUDY",
            "Driving by twelve notches: improved DQN against DQN, ablation, optimum over the notches",
        ),
    },
)
"""Every study."""


def reproduce(study_id: str, order: Order) -> StudyReport:
    """Reproduce a paper.

    Args:
        study_id: Id of the study.
        order: Budget, seeds, options and folder.

    Returns:
        Its report, with the time it took and the circumstances.

    Raises:
        InputError: No such study or option, or a number of seeds below one.
    """
    study = STUDIES.get(study_id)
    if order.seeds is not None and order.seeds < 1:
        raise InputError("out of range", field="seeds", value=order.seeds, allowed=">= 1")
    order = replace(order, options=study.check_options(order.options))
    start = time.perf_counter()
    report = study.reproduce(order)
    return replace(report, seconds=time.perf_counter() - start, circumstances=circumstances())
