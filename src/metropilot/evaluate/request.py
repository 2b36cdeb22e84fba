"""A run as a user asks for it: resolved to a run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, get_args

from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, renamed
from metropilot.evaluate.driver_options import make_driver, named_driver, option_defaults
from metropilot.evaluate.optimum import Objective
from metropilot.planning import LONGEST_RATIO, check_running_time, minimum_running_time
from metropilot.railway import Restriction, Section, Trainset, load_line, load_trainset
from metropilot.sim import CONTROL_PERIOD_S, AbstractDriver, Disturbance, Run, TimetableUpdate

KMH = 1 / 3.6
NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
RESTRICTION = re.compile(rf"({NUMBER})-({NUMBER})@({NUMBER})(?:@({NUMBER}))?")
OUTER = {
    "scheduled_time_s": "time_s",
    "dt": "dt_s",
    "restriction": "restrictions",
}
"""Fields of a run and of its scenario, as a request calls them."""
ARRIVAL = re.compile(rf"({NUMBER})@({NUMBER})")


@dataclass(frozen=True)
class Request:
    """Everything that decides a run.

    Attributes:
        line: Catalogue id or path.
        origin: Code or name of the station of departure.
        destination: Code or name of the station of arrival.
        time_s: Scheduled running time; None takes the line's planned time.
        trainset: Catalogue id or path.
        load: Load aboard; None takes the trainset's first.
        driver: Driver id.
        options: Options of the driver.
        ideal: Ideal actuation: no delay, lag or jerk limit.
        mass_factor: True over believed mass.
        resistance_factor: True over believed Davis resistance.
        delay_s: Dead time in addition to the trainset's.
        lag_s: Lag in addition to the trainset's.
        speed_noise_mps: Standard deviation of the measured speed.
        headwind_mps: Wind from ahead; below 0 from behind.
        adhesion: Traction or electric braking over weight at which the driven wheels slip.
        restrictions: Temporary speed restrictions ``FROM-TO@KMH``; with ``@T`` announced at T s.
        arrivals: New scheduled running times announced on the way, ``S@T``.
        objective: Energy the optimum minimises.
        dt_s: Control period.
        seed: Seed of everything random.
    """

    line: str
    origin: str
    destination: str
    time_s: float | None = None
    trainset: str = "dkz32"
    load: str | None = None
    driver: str = "optimal"
    options: Mapping[str, Any] = field(default_factory=dict)
    ideal: bool = False
    mass_factor: float = 1.0
    resistance_factor: float = 1.0
    delay_s: float = 0.0
    lag_s: float = 0.0
    speed_noise_mps: float = 0.0
    headwind_mps: float = 0.0
    adhesion: float = float("inf")
    restrictions: tuple[str, ...] = ()
    arrivals: tuple[str, ...] = ()
    objective: Objective = "wheel"
    dt_s: float = CONTROL_PERIOD_S
    seed: int = 0

    def __post_init__(self) -> None:
        if self.objective not in get_args(Objective):
            allowed = ", ".join(get_args(Objective))
            raise InputError("unknown objective", field="objective", value=self.objective, allowed=allowed)
        if not 0 <= self.seed < 2**63:
            raise InputError("out of range", field="seed", value=self.seed, allowed="0 to 2^63 - 1")

    def loaded(self) -> Trainset:
        """The trainset with its load, as the driver knows it."""
        return load_trainset(self.trainset, self.load)

    def section(self) -> Section:
        """The section with every restriction known before departure."""
        section = line_section = self.open_section()
        for text in self.restrictions:
            restriction, at_s = parse_restriction(text, line_section)
            if at_s is None:
                section = section.restricted(restriction)
        return section

    def open_section(self) -> Section:
        """The section without temporary restrictions."""
        return load_line(self.line).section(self.origin, self.destination)

    def scenario(self) -> Disturbance:
        """What the driver is not told, and what it is told on the way."""
        section = self.open_section()
        announced = [parse_restriction(text, section) for text in self.restrictions]
        news = [TimetableUpdate(at_s, restriction=r) for r, at_s in announced if at_s is not None]
        news += [parse_arrival(text) for text in self.arrivals]
        return Disturbance(
            ideal=self.ideal,
            mass_factor=self.mass_factor,
            resistance_factor=self.resistance_factor,
            delay_s=self.delay_s,
            lag_s=self.lag_s,
            speed_noise_mps=self.speed_noise_mps,
            headwind_mps=self.headwind_mps,
            adhesion=self.adhesion,
            updates=tuple(sorted(news, key=lambda item: item.at_s)),
        )

    def run(self, fastest_s: float | None = None) -> Run:
        """The run.

        Args:
            fastest_s: Minimum running time of the open section, where it is known already.

        Raises:
            InputError: Something in the request cannot be used.
            Infeasible: The scheduled time is below the minimum running time, which the message names. A
                temporary restriction that costs more than the reserve is no such case: the run will be late.
        """
        with renamed(OUTER):
            section, trainset = self.section(), self.loaded()
            time_s = self.time_s if self.time_s is not None else section.planned_time_s
            if time_s is None:
                words = f"the line plans no running time for {section.name}; give one"
                raise InputError(words, field="time_s", allowed="> 0 s")
            run = Run(section, trainset, time_s, self.scenario(), self.dt_s, self.seed)
        fastest = fastest_s or minimum_running_time(self.open_section(), trainset)
        check_running_time(time_s, fastest)
        for news in run.scenario.updates:
            if news.scheduled_time_s is not None and news.scheduled_time_s > LONGEST_RATIO * fastest:
                check_running_time(news.scheduled_time_s, fastest, field="arrivals")
        return run

    def make_driver(self) -> AbstractDriver:
        """The driver; one that can choose what energy to save is told the objective.

        Raises:
            InputError: No such driver, or no such option of it.
        """
        told = dict(self.options)
        driver_id, _ = named_driver(self.driver)
        if driver_id in DRIVERS.ids() and "objective" in option_defaults(DRIVERS.get(driver_id)):
            told.setdefault("objective", self.objective)
        return make_driver(self.driver, told)

    def resolved(self) -> Request:
        """The same request with stations by code, the load named, driver and options apart, and a time."""
        section, trainset = self.section(), self.loaded()
        time_s = self.time_s if self.time_s is not None else section.planned_time_s
        origin, destination = section.origin.code, section.destination.code
        trainset_id = self.trainset.removesuffix(f":{trainset.load}")
        driver_id, named = named_driver(self.driver)
        return replace(
            self,
            driver=driver_id,
            options=named | dict(self.options),
            origin=origin,
            destination=destination,
            time_s=time_s,
            trainset=trainset_id,
            load=trainset.load,
        )


def parse_restriction(text: str, section: Section) -> tuple[Restriction, float | None]:
    """``FROM-TO@KMH`` or ``FROM-TO@KMH@T``: the restriction, and when it is told (None: before departure).

    Raises:
        InputError: Not of that form, not within the section, of a speed below 5 or above 400 km/h, or
            nowhere below the line's own limit.
    """
    match = RESTRICTION.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InputError(
            "not a restriction",
            field="restrictions",
            value=text,
            allowed="FROM-TO@KMH or FROM-TO@KMH@T, e.g. 400-600@40 or 400-600@40@30 (m, m, km/h, s)",
        )
    start, end, kmh = (float(x) for x in match.groups()[:3])
    at_s = None if match[4] is None else float(match[4])
    return section.check_restriction(Restriction(start, end, kmh * KMH)), at_s


def parse_arrival(text: str) -> TimetableUpdate:
    """``S@T``: from T s after departure the scheduled running time is S.

    Raises:
        InputError: Not of that form.
    """
    match = ARRIVAL.fullmatch(text.replace(" ", ""))
    if match is None or float(match[1]) <= float(match[2]):
        raise InputError(
            "not a new running time",
            field="arrivals",
            value=text,
            allowed="S@T with S later than T, e.g. 116@30: arrive after 116 s, sent after 30 s",
        )
    return TimetableUpdate(float(match[2]), scheduled_time_s=float(match[1]))
