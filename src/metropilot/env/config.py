"""Configuration of a driving task, and of one with random sections and trainsets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from metropilot._schema import check_fields, declare
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
        most_decisions: Number of decisions after which an episode is truncated; None: those that the outcome
            rule leaves to the longest scheduled time.
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
    dt: float = declare(0.5, unit="s", low=0.01, high=1.0)
    periods: int = declare(1, low=1)
    most_decisions: int | None = declare(1000, low=1)
    spacing_m: float = declare(4.0, unit="m", low=0.0, above=True)

    def __post_init__(self) -> None:
        check_fields(self)
        for name, kind in (("sections", Section), ("trainsets", Trainset), ("rewards", AbstractTerm)):
            _check_each(name, getattr(self, name), kind)
        for name, kind in (
            ("scenarios", DisturbanceDistribution),
            ("action", AbstractAction),
            ("outcomes", OutcomeRule),
            ("assists", Assists),
        ):
            given = type(getattr(self, name))
            if not issubclass(given, kind):
                allowed = f"an object of {kind.__name__}"
                raise InputError("wrong kind of value", field=name, value=given.__name__, allowed=allowed)
        if not self.sections or not self.trainsets:
            raise InputError("a task needs sections and trainsets", field="sections")
        _check_each("observer", self.features, str)
        if not self.features:
            raise InputError("a policy needs features", field="observer", allowed=", ".join(OBSERVERS))
        check_features(self.features, FEATURES, "observer")
        names = [term.name for term in self.rewards]
        if len(set(names)) != len(names):
            raise InputError("a reward term given twice", field="rewards", value=", ".join(names))

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


def _check_each(name: str, values: object, kind: type) -> None:
    """Refuse a field that is no tuple or list of objects of a kind."""
    several = isinstance(values, tuple | list)
    wrong = [type(value) for value in values if not isinstance(value, kind)] if several else [type(values)]
    if wrong:
        allowed = f"a tuple of {kind.__name__}"
        raise InputError("wrong kind of value", field=name, value=wrong[0].__name__, allowed=allowed)


@dataclass(frozen=True)
class DomainRandomization(DrivingConfig):
    """Driving task of random domains: the sections and trainsets form pairs in the order of their lists."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sections, trainsets = len(self.sections), len(self.trainsets)
        if trainsets != sections:
            raise InputError(
                "as many trainsets as sections", field="trainsets", value=trainsets, allowed=str(sections)
            )

    @property
    def cases(self) -> tuple[tuple[Section, Trainset], ...]:
        """Each section with its trainset."""
        return tuple(zip(self.sections, self.trainsets, strict=True))
