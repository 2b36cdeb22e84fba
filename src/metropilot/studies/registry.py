"""Studies by id; a study's module is imported when it is asked for."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType

from metropilot.errors import InputError
from metropilot.studies.circumstances import circumstances
from metropilot.studies.report import StudyReport
from metropilot.studies.study import Order, Study

STUDIES: Mapping[str, str] = MappingProxyType(
    {
        "chen2023a": "Driving by position and speed: PPO with reward scaling against PPO and DDPG",
        "chen2023b": "Following in virtual coupling: SAC-PID against DDPG-PID, and what keeps convoys apart",
        "cheng2023": "Tracking a reference: DDPG-PID against PID, fuzzy and neural PID",
        "huang2025": "Driving by an expert system, and PPO inside it, against manual driving and STON",
        "lu2023": "Driving by twelve notches: improved DQN against DQN, ablation, optimum over the notches",
    }
)
"""Id of each study, and what it is in one line. Its module ``metropilot.studies.ID`` offers ``STUDY``."""


def load_study(study_id: str) -> Study:
    """A study by id.

    Raises:
        InputError: No such study.
    """
    if study_id not in STUDIES:
        near = get_close_matches(study_id, STUDIES, 1)
        words = f"unknown study (did you mean {near[0]}?)" if near else "unknown study"
        raise InputError(words, field="study", value=study_id, allowed=", ".join(STUDIES))
    return import_module(f"metropilot.studies.{study_id}").STUDY


def reproduce(study_id: str, order: Order) -> StudyReport:
    """Do a study.

    Args:
        study_id: Which.
        order: How.

    Returns:
        Its report, with the time it took and the circumstances.

    Raises:
        InputError: No such study or option, or a number of seeds below one.
    """
    study = load_study(study_id)
    if order.seeds is not None and order.seeds < 1:
        raise InputError("out of range", field="seeds", value=order.seeds, allowed=">= 1")
    order = replace(order, options=study.check_options(order.options))
    start = time.perf_counter()
    report = study.reproduce(order)
    return replace(report, seconds=time.perf_counter() - start, circumstances=circumstances())
