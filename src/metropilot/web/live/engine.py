"""A run stepped in real time, with timetable updates and manual driving.

The same events before the same steps give the same bits, so that a journal is enough to resume a run.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from metropilot.errors import Infeasible, InputError, SolverError
from metropilot.evaluate import RunSpec, kpis_of, optimum_of, traction_work_j, write_run
from metropilot.physics import track_arrays
from metropilot.planning import Plan, PlanOptions, minimum_running_time, optimal_plan
from metropilot.protection import LEVELS, permitted_speed, protect
from metropilot.railway import Restriction
from metropilot.sim import PUNCTUALITY_S, STOP_TOLERANCE_M, Moment, Rollout, TimetableUpdate, declared_bounds
from metropilot.units import KMH_PER_MPS
from metropilot.web.errors import Refused
from metropilot.web.work.drives import drive_out, explain
from metropilot.web.work.plans import numbers, station, window

HAND_S = 3.0
"""Manual driving ends unless the holder of the lever renews it within this time."""
COLUMNS = (*Moment._fields, "plan_energy_wheel_j", "step")
"""Columns of a row; ``plan_energy_wheel_j`` is the energy of the reference plan at this position."""
NOBODY = "api"
"""Holder of the lever where a request names none."""
LATE_W = 500.0
"""Energy of a second of delay, W: a plan that cannot meet its time arrives late rather than not at all."""
SHORT = ("driver", "success", "kpis", "checks")
PERMITTED_STEP_M = 5.0
"""Resolution of the permitted speed that is drawn."""
NEAREST_STEP_M = 20.0
"""Resolution of the nearest possible begin of a restriction that a refusal names."""
Event = dict[str, Any]


class LeverlessEngine:
    """Base of live runs with neither a lever nor timetable updates."""

    def holds(self, event: Event) -> bool:
        """Tell whether an event changes nothing: it returns a lever that nobody holds."""
        return event["kind"] == "lever" and event["share"] is None

    def lever_expired(self) -> bool:
        """False: there is no lever."""
        return False

    def lever(self) -> None:
        """None: there is no lever."""

    def pop_updates(self) -> list[str]:
        """Empty: there are no timetable updates."""
        return []


class Engine:
    """A live run.

    There are two plans. ``plan`` leads from the state at the last event (departure, a new arrival time or
    restriction, the end of manual driving) to the stop: the best that is still possible. ``reference``
    leads from departure to the stop for the scheduled running time and the restrictions in force; the run
    is compared with it. Energy of the run and of the reference both count from departure. Where the
    scheduled time cannot be met from departure, the reference arrives late.

    Args:
        request: The run.

    Attributes:
        holder: Name of the holder of the lever, None while the driver drives.
        held_since_s: Time since departure at which the holder took the lever.
    """

    def __init__(self, request: RunSpec) -> None:
        self.request = request
        self.rollout = Rollout(request.run(), request.make_driver())
        self.open = request.open_section()
        self.steps = 0
        self.renewed = 0.0
        self.holder: str | None = None
        self.held_since_s = 0.0
        self.due: list[str] = []
        self.news: list[TimetableUpdate] = []
        self._plan_anew()

    @property
    def time_s(self) -> float:
        """Time since departure."""
        return float(self.rollout.state.plant.time_s)

    @property
    def dt_s(self) -> float:
        """Control period."""
        return self.rollout.run.dt

    @property
    def over(self) -> bool:
        """True when the run has ended."""
        return self.rollout.outcome is not None

    @property
    def position_m(self) -> float:
        """Position of the head of the trainset."""
        return float(self.rollout.state.plant.position_m)

    def advance(self) -> list[Any]:
        """Simulate one control period; return its row in the order of ``COLUMNS``."""
        scheduled_s, section = self.rollout.scheduled_time_s, self.rollout.section
        moment = self.rollout.advance()
        self.steps += 1
        if self.rollout.scheduled_time_s != scheduled_s or self.rollout.section is not section:
            self._plan_anew()
            if self.rollout.scheduled_time_s != scheduled_s:
                self.due.append(self._arrival_words(scheduled_s))
            self.due += [
                restriction_words(r)
                for r in self.rollout.section.restrictions
                if r not in section.restrictions
            ]
        return [*(round(x, 4) for x in moment), self._reference_j(moment.position_m), self.steps]

    def pop_updates(self) -> list[str]:
        """Descriptions of the timetable updates of the request since the last call."""
        words, self.due = self.due, []
        return words

    def apply(self, event: Event) -> str:
        """Send the driver a timetable update, or move the lever; return a description.

        Raises:
            InputError: The event is not possible; the message names the allowed values.
            Refused: The lever has another holder (409).
        """
        kind = event["kind"]
        if kind == "arrival":
            return self._arrival(float(event["scheduled_time_s"]))
        if kind == "restriction":
            return self._restrict(Restriction(event["from_m"], event["to_m"], event["limit_mps"]))
        if kind != "lever":
            raise InputError("unknown event of a run", field="kind", value=kind)
        take_over = bool(event.get("take_over"))
        return self._lever(event["share"], event.get("holder", NOBODY), take_over=take_over)

    def _lever(self, share: float | None, holder: str, *, take_over: bool) -> str:
        """Take the lever, move it, or (None) return it to the driver; it has one holder at a time."""
        held = self.holder
        if held not in {None, holder} and not take_over:
            raise Refused(
                f"the lever is held by {held} since {self.held_since_s:.1f} s after departure",
                409,
                field="holder",
                value=holder,
                allowed="take_over: true takes it over",
            )
        self.rollout.take(share)
        self.renewed = monotonic()
        self.holder = None if share is None else holder
        if self.holder == held:
            return ""
        if share is None:
            self._plan_anew()
            return "the lever is returned to the driver"
        self.held_since_s = self.time_s
        return f"the lever is taken {'by hand' if held is None else f'over from {held}'} by {holder}"

    def holds(self, event: Event) -> bool:
        """Tell whether an event leaves the lever where it is; if so, renew its holder's time."""
        if event["kind"] != "lever" or event["share"] != self.rollout.by_hand:
            return False
        if self.holder not in {None, event.get("holder", NOBODY)}:
            return False
        self.renewed = monotonic()
        return True

    def lever_expired(self) -> bool:
        """Tell whether the holder has not renewed the lever in time."""
        return self.holder is not None and monotonic() - self.renewed > HAND_S

    def lever(self) -> dict[str, Any] | None:
        """Holder of the lever and since when; None while the driver drives."""
        return None if self.holder is None else {"holder": self.holder, "since_s": self.held_since_s}

    def _arrival(self, scheduled_s: float) -> str:
        before_s = self.rollout.scheduled_time_s
        if scheduled_s <= self.time_s:
            raise InputError(
                "that time has passed",
                field="scheduled_time_s",
                value=scheduled_s,
                unit="s",
                allowed=f"> {self.time_s:.1f} s",
            )
        self._announce(TimetableUpdate(self.time_s, scheduled_time_s=scheduled_s))
        self.rollout.apply_updates()
        self._plan_anew()
        return self._arrival_words(before_s)

    def _arrival_words(self, before_s: float) -> str:
        scheduled_s = self.rollout.scheduled_time_s
        way = "earlier" if scheduled_s < before_s else "later"
        return f"new arrival time, {way}: after {scheduled_s:g} s{self._instead()}"

    def _announce(self, news: TimetableUpdate) -> None:
        self.news.append(news)
        self.rollout.tell(news)

    def _instead(self) -> str:
        """Words on the nearest arrival where the scheduled time cannot be met; else empty."""
        if self.plan is None:
            return "; no plan from here meets it"
        # A plan with time to spare creeps over the last centimetres; a driver stops.
        stands_m = self.plan.position_m[-1] - STOP_TOLERANCE_M
        arrives_s = self.time_s + float(np.interp(stands_m, self.plan.position_m, self.plan.time_s))
        if abs(arrives_s - self.rollout.scheduled_time_s) <= PUNCTUALITY_S:
            return ""
        which = "earliest" if arrives_s > self.rollout.scheduled_time_s else "latest"
        return f"; {which} possible arrival from here: after {arrives_s:.1f} s"

    def _restrict(self, restriction: Restriction) -> str:
        self.open.check_restriction(restriction)
        tail = float(self.rollout.state.plant.position_m) - self.rollout.trainset.length_m
        if restriction.to_m <= tail:
            raise InputError(
                "lies behind the trainset",
                field="from_m",
                value=restriction.from_m,
                unit="m",
                allowed="ahead",
            )
        if not self._in_time(restriction):
            nearest = self._nearest(restriction)
            raise InputError(
                "too near for this speed: no brake could keep it",
                field="from_m",
                value=restriction.from_m,
                unit="m",
                allowed=f"{nearest:.0f} m or further" if nearest is not None else "a higher speed",
            )
        self._announce(TimetableUpdate(self.time_s, restriction=restriction))
        self.rollout.apply_updates()
        self._plan_anew()
        return restriction_words(restriction)

    def _in_time(self, restriction: Restriction) -> bool:
        """Tell whether protection would permit the present speed with the restriction."""
        run = self.rollout.run
        section = self.rollout.section.with_restriction(restriction)
        guard = protect(section, run.disturbance.nominal(run.trainset), declared_bounds(run))
        state = self.rollout.state.plant
        seen = float(state.speed_mps) + max(float(state.acceleration_mps2), 0.0)
        return seen <= float(permitted_speed(guard, float(state.position_m)))

    def _nearest(self, restriction: Restriction) -> float | None:
        """Nearest possible begin of the restriction, m; None if there is none."""
        first = np.ceil(float(self.rollout.state.plant.position_m) / NEAREST_STEP_M) * NEAREST_STEP_M
        for at in np.arange(first, self.rollout.section.length_m - 1.0, NEAREST_STEP_M):
            if self._in_time(replace(restriction, from_m=float(at), to_m=float(at) + 1.0)):
                return float(at)
        return None

    def _plan_anew(self) -> None:
        """Compute both plans for the timetable and restrictions in force."""
        state = self.rollout.state.plant
        self.planned_s = self.time_s
        self.plan = self._plan(max(float(state.position_m), 0.0), float(state.speed_mps), self.time_s)
        force = (self.rollout.scheduled_time_s, self.rollout.section.restrictions)
        if self.steps == 0:
            self.force, self.reference = force, self.plan
        elif force != self.force:
            self.force, self.reference = force, self._plan(0.0, 0.0, 0.0)
        self.reference_used_j = None if self.reference is None else traction_work_j(self.reference)

    def _plan(self, start_m: float, start_mps: float, time_s: float) -> Plan | None:
        """Optimal plan from a state to the stop; late where the time cannot be met."""
        rollout = self.rollout
        left = max(rollout.scheduled_time_s - time_s, 1.0)
        options = PlanOptions(
            objective=self.request.objective, start_m=start_m, start_mps=start_mps, late_w=LATE_W
        )
        try:
            return optimal_plan(
                rollout.section, rollout.run.disturbance.nominal(rollout.run.trainset), left, options
            )
        except (Infeasible, SolverError):
            return None

    def _reference_j(self, position_m: float) -> float | None:
        """Traction energy the reference plan has used at a position."""
        if self.reference is None or self.reference_used_j is None:
            return None
        return round(float(np.interp(position_m, self.reference.position_m, self.reference_used_j)), 1)

    def scene(self) -> dict[str, Any]:
        """Values that are constant between events: track, permitted speed, plan."""
        rollout, plan, reference = self.rollout, self.plan, self.reference
        section, trainset = rollout.section, rollout.run.trainset
        track = track_arrays(section, trainset)
        at = np.append(np.arange(0.0, section.length_m, PERMITTED_STEP_M), section.length_m)
        guard = rollout.params.protection
        assert guard is not None  # a rollout is always supervised; only compiled runs may go without
        inside = (track.limit_from_m < section.length_m) & np.isfinite(track.limit_from_m)
        drawn = compared = None
        if plan is not None:
            drawn = {
                "position_m": numbers(plan.position_m, 2),
                "speed_mps": numbers(plan.speed_mps, 4),
                "time_s": numbers(self.planned_s + plan.time_s, 3),
            }
        if reference is not None and self.reference_used_j is not None:
            compared = {
                "position_m": numbers(reference.position_m, 2),
                "energy_wheel_j": numbers(self.reference_used_j, 0),
                "running_time_s": round(float(reference.time_s[-1]), 3),
            }
        return {
            "columns": list(COLUMNS),
            "levels": list(LEVELS),
            "name": section.name,
            "line": section.line_id,
            "origin": station(section.origin, 0.0),
            "destination": station(section.destination, section.length_m),
            "length_m": section.length_m,
            "trainset": trainset.name,
            "load": trainset.load,
            "trainset_length_m": trainset.length_m,
            "driver": self.request.driver,
            "dt_s": rollout.run.dt,
            "scheduled_time_s": rollout.scheduled_time_s,
            "minimum_running_time_s": self.minimum_s,
            "limit": {
                "from_m": numbers(track.limit_from_m[inside], 2),
                "limit_mps": numbers(track.limit_mps[inside], 4),
            },
            "gradient_permil": window(section, "gradient_permil"),
            "restrictions": [
                {"from_m": r.from_m, "to_m": r.to_m, "limit_mps": r.limit_mps} for r in section.restrictions
            ],
            "permitted": {
                "position_m": numbers(at, 2),
                "speed_mps": numbers(permitted_speed(guard, at), 4),
            },
            "plan": drawn,
            "reference": compared,
            "lever": self.lever(),
        }

    def report(self, folder: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
        """Write the files of the run; return the result in short and in full, and the outcome."""
        driven = self.rollout.drive()
        optimum = optimum_of(driven, self.request.objective)
        kpis = kpis_of(driven, optimum, self.request.objective)
        request = self.request_with_updates()
        explanation = explain(request, driven, optimum)
        full = drive_out(driven, kpis, optimum, explanation)
        write_run(folder, request, driven, kpis, optimum, explanation)
        return {name: full[name] for name in SHORT}, full, kpis.outcome

    def request_with_updates(self) -> RunSpec:
        """The request with the timetable updates sent during the run, without manual driving."""
        disturbance = self.request.disturbance
        updates = (*disturbance.updates, *self.news)
        return replace(self.request, disturbance=replace(disturbance, updates=updates))

    @property
    def minimum_s(self) -> float:
        """Minimum running time of the section as it was before departure."""
        return minimum_running_time(self.open, self.rollout.run.trainset)


def restriction_words(restriction: Restriction) -> str:
    """Description of a restriction that is announced."""
    where = f"{restriction.from_m:.0f} to {restriction.to_m:.0f} m"
    return f"restriction announced: {KMH_PER_MPS * restriction.limit_mps:.0f} km/h from {where}"
