"""Request of a convoy: the run of the head, and its followers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from metropilot.convoy.drivers import FOLLOWERS, AbstractFollower
from metropilot.convoy.model import GAP_M, Convoy, ConvoyGuard, Link
from metropilot.convoy.rollout import ConvoyDrive, HeadRun, drive_convoy
from metropilot.errors import InputError, rename_fields
from metropilot.evaluate import RunSpec, make_driver, with_options
from metropilot.planning import check_running_time, minimum_running_time
from metropilot.sim import Run, drive


@dataclass(frozen=True)
class ConvoyRequest:
    """All inputs of the run of a convoy.

    Attributes:
        head: Run of the head: line, stations, time, trainset and load, driver, period and seed. Its
            disturbance is not used.
        count: Number of trainsets.
        follower: Id of the driver of the followers.
        options: Its options.
        gap_m: Desired gap.
        start_gap_m: Gap at departure; None: the desired one.
        apart_m: Desired gap once uncoupled.
        uncouple_at_m: Position at which the head begins to uncouple; None: nowhere.
        link: Link from each trainset to the next.
        guard: Assumption of protection.
        masses: True over nominal mass of each trainset; empty: all 1.
        emergency_s: Time at which the head makes an emergency brake; None: never.
    """

    head: RunSpec
    count: int = 2
    follower: str = "follow_gap"
    options: Mapping[str, Any] = field(default_factory=dict)
    gap_m: float = GAP_M
    start_gap_m: float | None = None
    apart_m: float = 100.0
    uncouple_at_m: float | None = None
    link: Link = field(default_factory=Link)
    guard: ConvoyGuard = "coupled"
    masses: tuple[float, ...] = ()
    emergency_s: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("emergency_s", "s"), ("uncouple_at_m", "m")):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < float("inf"):
                allowed = f">= 0 {unit}, finite"
                raise InputError("out of range", field=name, value=value, unit=unit, allowed=allowed)

    def convoy(self) -> Convoy:
        """The convoy.

        Raises:
            InputError: Something in the request cannot be used.
        """
        if not 2 <= self.count <= 16:
            raise InputError(
                "number of trainsets out of range", field="trainsets", value=self.count, allowed="2 to 16"
            )
        with rename_fields({"mass": "masses"}):
            return self._convoy()

    def _convoy(self) -> Convoy:
        """Make the convoy; errors name the fields of :class:`Convoy`."""
        return Convoy(
            section=self.head.section(),
            trainsets=(self.head.loaded(),) * self.count,
            gap_m=self.gap_m,
            start_gap_m=self.start_gap_m,
            apart_m=self.apart_m,
            uncouple_at_m=float("inf") if self.uncouple_at_m is None else self.uncouple_at_m,
            link=self.link,
            guard=self.guard,
            mass_factors=self.masses,
            dt=self.head.dt_s,
        )

    def run(self, convoy: Convoy) -> Run:
        """The run of the head; limits hold until the last trainset has cleared them.

        Raises:
            Infeasible: The time is below the convoy's minimum running time, which the message names.
        """
        section, trainset = convoy.leader()
        time_s = self.head.time_s if self.head.time_s is not None else convoy.section.planned_time_s
        if time_s is None:
            words = f"the line plans no running time for {convoy.section.name}; give one"
            raise InputError(words, field="time_s", allowed="> 0 s")
        check_running_time(
            time_s, minimum_running_time(section, trainset), "minimum running time of the convoy"
        )
        return Run(section, trainset, time_s, dt=self.head.dt_s, seed=self.head.seed)

    def head_run(self, convoy: Convoy) -> HeadRun:
        """Drive the head alone.

        Raises:
            InputError: No such driver, no such option.
            Infeasible: The head's driver cannot meet the scheduled time.
        """
        found = drive(self.run(convoy), make_driver(self.head.driver, self.head.options))
        commands = np.asarray(found.trajectory.command[:-1])
        late = float("inf") if self.emergency_s is None else self.emergency_s
        return HeadRun(self.head.driver, commands, found.outcome, late)

    def make_follower(self) -> AbstractFollower:
        """Make the driver of the followers.

        Raises:
            InputError: No such follower, or no such option of it.
        """
        with rename_fields({"driver": "follower"}):
            return with_options(FOLLOWERS.get(self.follower), self.options)

    def drive(self, convoy: Convoy | None = None, follower: AbstractFollower | None = None) -> ConvoyDrive:
        """Drive the head, then the convoy behind it.

        Args:
            convoy: The convoy, if it exists already.
            follower: The driver of the followers, if it exists already.
        """
        convoy, follower = convoy or self.convoy(), follower or self.make_follower()
        return drive_convoy(convoy, self.head_run(convoy), follower, self.head.seed)

    def table(self) -> dict[str, Any]:
        """The request as plain values, without those that are None or infinite."""
        values = {k: v for k, v in asdict(replace(self, head=self.head.resolved())).items() if v is not None}
        values["head"] = {k: v for k, v in values["head"].items() if v is not None}
        values["link"] = {k: v for k, v in values["link"].items() if np.isfinite(v)}
        return values
