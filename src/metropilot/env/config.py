"""Configuration of a driving task, and of one with random sections and trainsets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from metropilot.env.actions import AbstractAction, RegimeAction
from metropilot.env.assists import Assists
from metropilot.env.features import FEATURES, OBSERVERS, check_features
from metropilot.env.policy_interface import PolicyInterface
from metropilot.env.randomization import DisturbanceDistribution
from metropilot.env.rewards import AbstractTerm, Energy, Failure, Intervention, Punctuality
from metropilot.env.tables import SectionTables, build_tables
from metropilot.errors import InputError
from metropilot.railway import Section, Trainset
from metropilot.sim import OutcomeRule

REWARDS = (Energy(), Punctuality(per_s=2.0), Failure(price=20.0, per_m=0.05), Intervention())
"""Default reward: a kWh costs 1, a second off time 2 (in a tight timetable the last second saves below 1)."""
DOMAIN_OBSERVER = "line"
DOMAIN_ASSISTS = Assists(margin_mps=0.05, stop_use=0.99, release=0.95, late=True)
"""Assists closer to the limits than the defaults, as the optimum uses the limits fully."""
DOMAIN_ACTION = RegimeAction(needed=True)
EPISODE_RULE = OutcomeRule(give_up_m=20.0, late_ratio=1.25, late_s=30.0)
"""Rule of episodes; stricter than that of reported drives, as the rest of a failed run is of no use."""


@dataclass(frozen=True)
class DrivingConfig:
    """Configuration of a driving task.

    Attributes:
        sections: Sections.
        trainsets: Trainsets, each with its load. Every section is combined with every one of them.
        scenarios: Distribution of the disturbance and start of an episode.
        ideal: Ideal actuation: no delay, lag or jerk limit except those of the disturbance.
        observer: A name in ``OBSERVERS``, or names of features.
        action: Kind of action.
        rewards: Terms of the reward, each name once.
        outcomes: Rule that ends an episode.
        assists: Assists of the policy.
        dt: Control period of plant and protection, s.
        periods: Control periods of one decision.
        most_decisions: Number of decisions after which an episode is truncated.
        spacing_m: Distance between protection's nodes; the host uses 1 m. A coarser grid is stricter and
            faster.
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
        check_features(self.features, FEATURES, "observer")
        names = [term.name for term in self.rewards]
        if len(set(names)) != len(names):
            raise InputError("a reward term given twice", field="rewards", value=", ".join(names))
        if self.periods < 1 or self.most_decisions < 1:
            raise InputError("out of range", field="periods", value=self.periods, allowed=">= 1")

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the observer's features."""
        return (
            OBSERVERS.get(self.observer, (self.observer,))
            if isinstance(self.observer, str)
            else self.observer
        )

    @property
    def cases(self) -> tuple[tuple[Section, Trainset], ...]:
        """Every section with every nominal trainset, sections varying slowest."""
        known = [trainset.ideal() if self.ideal else trainset for trainset in self.trainsets]
        return tuple((section, trainset) for section in self.sections for trainset in known)

    @property
    def interface(self) -> PolicyInterface:
        """Interface with which a driver runs a policy of this task on the host."""
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
        """Build the tables of the cases (NumPy) in a number of processes; about 0.1 s a case."""
        restricted = [
            (s, t) for section, t in self.cases for s in self.scenarios.restricted_sections(section)
        ]
        bounded = [(s, t, self.scenarios.bounds(s, t, self.dt)) for s, t in (*self.cases, *restricted)]
        return build_tables(bounded, self.spacing_m, dtype, jobs, fading=self.action.fading)


@dataclass(frozen=True)
class DomainRandomization(DrivingConfig):
    """Driving task of random domains: the sections and trainsets form pairs in the order of their lists."""

    @property
    def cases(self) -> tuple[tuple[Section, Trainset], ...]:
        """Each section with its trainset."""
        return tuple(zip(self.sections, self.trainsets, strict=True))
