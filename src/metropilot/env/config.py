"""What a driving task is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from metropilot.env.actions import AbstractAction, RegimeAction
from metropilot.env.assists import Assists
from metropilot.env.features import FEATURES, OBSERVERS
from metropilot.env.policy_interface import PolicyInterface
from metropilot.env.randomization import DisturbanceDistribution
from metropilot.env.rewards import AbstractTerm, Energy, Failure, Intervention, Punctuality
from metropilot.env.tables import SectionTables, build_tables
from metropilot.errors import InputError
from metropilot.railway import Section, Trainset
from metropilot.sim import OutcomeRule

REWARDS = (Energy(), Punctuality(per_s=2.0), Failure(price=20.0, per_m=0.05), Intervention())
"""A kWh costs 1, a second off time 2 (what the last second saves in a tight timetable is below 1)."""
EPISODE_RULE = OutcomeRule(give_up_m=20.0, late_ratio=1.25, late_s=30.0)
"""Episodes end sooner than drives that are reported: the rest of a lost run teaches nothing."""


@dataclass(frozen=True)
class DrivingConfig:
    """What a driving task is made of.

    Attributes:
        sections: Where.
        trainsets: With what; a load is a trainset. Every section is driven with every one of them.
        scenarios: What is drawn at the start of an episode.
        ideal: Ideal actuation: no delay, lag or jerk limit but what a scenario adds.
        observer: A name in ``OBSERVERS``, or names of features.
        action: What an action means.
        rewards: Terms of the reward, each name once.
        outcomes: When an episode is over.
        assists: What is done for the policy.
        dt: Control period of plant and protection, s.
        periods: Control periods to a decision.
        most_decisions: Episodes are cut off (truncated) after so many decisions.
        spacing_m: Distance between protection's nodes; the host uses 1 m. Coarser is stricter and faster.
    """

    sections: tuple[Section, ...]
    trainsets: tuple[Trainset, ...]
    scenarios: DisturbanceDistribution = field(default_factory=DisturbanceDistribution)
    ideal: bool = True
    observer: str | tuple[str, ...] = "section"
    action: AbstractAction = field(default_factory=RegimeAction)
    rewards: tuple[AbstractTerm, ...] = REWARDS
    outcomes: OutcomeRule = EPISODE_RULE
    assists: Assists = field(default_factory=Assists)
    dt: float = 0.5
    periods: int = 1
    most_decisions: int = 1000
    spacing_m: float = 4.0

    def __post_init__(self) -> None:
        if not self.sections or not self.trainsets:
            raise InputError("a task needs sections and trainsets", field="sections")
        unknown = set(self.features) - set(FEATURES)
        if unknown:
            raise InputError(
                "unknown feature",
                field="observer",
                value=", ".join(sorted(unknown)),
                allowed=", ".join(FEATURES),
            )
        names = [term.name for term in self.rewards]
        if len(set(names)) != len(names):
            raise InputError("a reward term given twice", field="rewards", value=", ".join(names))
        if self.periods < 1 or self.most_decisions < 1:
            raise InputError("out of range", field="periods", value=self.periods, allowed=">= 1")

    @property
    def features(self) -> tuple[str, ...]:
        """The names of the observer's features."""
        return (
            OBSERVERS.get(self.observer, (self.observer,))
            if isinstance(self.observer, str)
            else self.observer
        )

    @property
    def cases(self) -> tuple[tuple[Section, Trainset], ...]:
        """Every section with every trainset as the driver knows it, sections varying slowest."""
        known = [trainset.ideal() if self.ideal else trainset for trainset in self.trainsets]
        return tuple((section, trainset) for section in self.sections for trainset in known)

    @property
    def perception(self) -> PolicyInterface:
        """What a driver must know to run on the host what was learned here."""
        mean = float(np.mean([trainset.mass_kg for _, trainset in self.cases]))
        return PolicyInterface(
            features=self.features,
            action=self.action,
            assists=self.assists,
            period_s=self.dt * self.periods,
            spacing_m=self.spacing_m,
            mean_mass_kg=mean,
        )

    def tables(self, dtype: type = np.float32, jobs: int = 1) -> SectionTables:
        """The cases as arrays (NumPy; takes about a tenth of a second a case); by so many processes."""
        restricted = [(s, t) for section, t in self.cases for s in self.scenarios.restricted(section)]
        bounded = [(s, t, self.scenarios.bounds(s, t, self.dt)) for s, t in (*self.cases, *restricted)]
        return build_tables(bounded, self.spacing_m, dtype, jobs)
