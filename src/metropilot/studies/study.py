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
from metropilot.studies.report import (
    Figure,
    LiteralReport,
    PrintedSetting,
    ReportRow,
    StudyReport,
    compare_rows,
)

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
        as_printed: Run the paper's own settings as well.
        processes: Learning runs side by side.
        say: Called with one line when something is done.
        records: Records of the learning runs used so far.
    """

    folder: Path
    budget: Budget = "quick"
    seeds: int | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    as_printed: bool = False
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
class LiteralRun:
    """Numbers measured under the printed settings.

    Attributes:
        rows: The numbers; table, case, driver and quantity are those of the study's row to stand beside.
        remarks: What was cut short, and findings.
        figures: Figures of these runs, after those of the study.
    """

    rows: Sequence[ReportRow]
    remarks: Sequence[str] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True)
class AsPrinted:
    """The paper's own settings, and the function that runs them.

    Attributes:
        settings: Every setting that differs from the study's, or that the paper leaves open.
        measure: From an order to the numbers; its learning runs have names of their own.
    """

    settings: tuple[PrintedSetting, ...]
    measure: Callable[[Order], LiteralRun]


@dataclass(frozen=True)
class Study:
    """One paper.

    Attributes:
        id: Id on the command line: author and year.
        title: Heading of its page.
        citation: The paper.
        reproduce: From an order to a report; the rest of the report is set by :func:`reproduce`.
        options: Allowed values of each option (``--set``), the default first.
        as_printed: The paper's own settings; None: the study cannot run them.
        fixed_rows: Those rows of the report that neither learning nor chance enters, computed alone; None: a
            quick reproduction is short enough.
    """

    id: str
    title: str
    citation: str
    reproduce: Callable[[Order], StudyReport]
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    as_printed: AsPrinted | None = None
    fixed_rows: Callable[[], Sequence[ReportRow]] | None = None

    def check_as_printed(self) -> AsPrinted:
        """The paper's own settings.

        Raises:
            InputError: The study cannot run them.
        """
        if self.as_printed is None:
            able = ", ".join(name for name in STUDIES if STUDIES.get(name).as_printed is not None)
            raise InputError(
                "cannot run the printed settings", field="as-printed", value=self.id, allowed=able or "none"
            )
        return self.as_printed

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
    group="metropilot.studies",
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
        InputError: No such study or option, a number of seeds below one, or printed settings that it cannot
            run.
    """
    study = STUDIES.get(study_id)
    if order.seeds is not None and order.seeds < 1:
        raise InputError("out of range", field="seeds", value=order.seeds, allowed=">= 1")
    order = replace(order, options=study.check_options(order.options))
    literal = study.check_as_printed() if order.as_printed else None
    start = time.perf_counter()
    report = study.reproduce(order)
    if literal is not None:
        order.say("the paper's own settings")
        run = literal.measure(order)
        found = LiteralReport(literal.settings, compare_rows(run.rows, report.rows), run.remarks)
        deviations = [*report.deviations, *found.deviations()]
        figures = [*report.figures, *run.figures]
        report = replace(report, as_printed=found, deviations=deviations, figures=figures)
    return replace(
        report,
        study=study.id,
        title=study.title,
        budget=order.budget,
        seconds=time.perf_counter() - start,
        circumstances=circumstances(),
        learning=tuple(order.records),
    )
