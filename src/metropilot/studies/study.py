"""Studies: each a paper, and one function that reproduces it; listing them imports none of their files."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from metropilot._provenance import circumstances
from metropilot._registry import Registry, RegistryRow
from metropilot.errors import InputError
from metropilot.studies.report import StudyReport

if TYPE_CHECKING:
    from metropilot.learn import RunRecord
    from metropilot.studies.learning import LearnJob, SeedResult

Budget = Literal["quick", "paper"]
BUDGETS: tuple[Budget, ...] = ("quick", "paper")


def check_budget(text: str) -> Budget:
    """A budget by name.

    Raises:
        InputError: No such budget.
    """
    for budget in BUDGETS:
        if budget == text:
            return budget
    raise InputError("unknown budget", field="budget", value=text, allowed=", ".join(BUDGETS))


@dataclass(frozen=True)
class Order:
    """Budget, options and folder of one reproduction.

    Attributes:
        folder: Folder of the learning runs; a second call with the same folder resumes them.
        budget: quick (shipped policies, short learning) or paper (everything learned anew).
        seeds: Number of seeds; None: the study's own number for the budget.
        options: The study's own options, already checked.
        processes: Learning runs side by side.
        say: Called with one line when something is done.
        records: Records of the learning runs used so far.
    """

    folder: Path
    budget: Budget = "quick"
    seeds: int | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    processes: int = 2
    say: Callable[[str], object] = lambda line: None  # noqa: ARG005 (silent)
    records: list[RunRecord] = field(default_factory=list)

    def learn(self, jobs: Sequence[LearnJob], folder: Path | None = None) -> list[SeedResult]:
        """Do every learning run that is not there yet, and keep the records for the report.

        Args:
            jobs: The runs.
            folder: Parent of the runs' folders; None: the order's.
        """
        from metropilot.studies.learning import learn_seeds

        results = learn_seeds(jobs, folder or self.folder, self.processes, self.say)
        self.records.extend(result.record for result in results)
        return results

    def choose_seeds(self, *, quick: int, paper: int) -> range:
        """The seeds to run: those asked for, else the study's number for the budget."""
        return range(self.seeds or (quick if self.budget == "quick" else paper))


@dataclass(frozen=True)
class Study:
    """One paper.

    Attributes:
        id: Id on the command line: author and year.
        title: Heading of its page.
        citation: The paper.
        reproduce: From an order to a report; the rest of the report is set by :func:`reproduce`.
        options: Allowed values of each option (``--set``), the default first.
    """

    id: str
    title: str
    citation: str
    reproduce: Callable[[Order], StudyReport]
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def check_options(self, given: Mapping[str, str]) -> dict[str, str]:
        """Every option with its value, defaults filled in.

        Raises:
            InputError: Unknown option or value.
        """
        for name, value in given.items():
            if name not in self.options:
                allowed = ", ".join(self.options) or f"{self.id} has none"
                raise InputError("unknown option", field="set", value=name, allowed=allowed)
            if value not in self.options[name]:
                raise InputError(
                    "unknown choice", field=name, value=value, allowed=", ".join(self.options[name])
                )
        return {name: given.get(name, allowed[0]) for name, allowed in self.options.items()}


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


def register_study(study: Study) -> None:
    """Add a study of one's own to those of this process; one that is there already stays."""
    STUDIES.add({study.id: RegistryRow(study, study.title)})


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
    return replace(
        report,
        study=study.id,
        title=study.title,
        budget=order.budget,
        seconds=time.perf_counter() - start,
        circumstances=circumstances(),
        learning=tuple(order.records),
    )
