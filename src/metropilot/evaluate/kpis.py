"""The KPIs of a drive, as `kpis.json` holds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.evaluate import measures
from metropilot.evaluate.measures import motion_energy_jpkg
from metropilot.evaluate.optimum import Optimum
from metropilot.planning import Objective, excess_percent, round_up_time
from metropilot.sim import OVERSPEED_MPS, PUNCTUALITY_S, STOP_TOLERANCE_M, Drive, Outcome
from metropilot.units import J_PER_KWH, KMH_PER_MPS

STEADY_MPS2 = 1e-9
"""Changes of the rate below this are rounding."""


class Indices(NamedTuple):
    """The indices of one drive.

    Attributes:
        safe: ``Is``, 1 when the speed never exceeded the limit (eq. 5).
        on_time: ``It``, 1 when the running time is within 3 s of the planned one (eqs. 6 and 7).
        energy_jpkg: ``Ie``, energy per unit mass (eqs. 8 and 9).
        comfort_mps2: ``Ic``, sum of the changes of the rate ``u`` (eqs. 10 and 11); smaller is better.
        parked: ``Ip``, 1 when the head stands within 0.3 m of the stop (eqs. 12 and 13).
    """

    safe: int
    on_time: int
    energy_jpkg: float
    comfort_mps2: float
    parked: int

    @property
    def met(self) -> bool:
        """True if the three binary indices are met."""
        return bool(self.safe and self.on_time and self.parked)


def indices_of(drive: Drive) -> Indices:
    """The five indices of a drive."""
    t = drive.trajectory
    arrived = drive.outcome in (Outcome.ARRIVED, Outcome.OVERSPEED)
    effort = t.traction_n - t.electric_brake_n - t.friction_brake_n
    return Indices(
        safe=safety_index(drive.max_overspeed_mps),
        on_time=punctuality_index(drive.running_time_s, drive.scheduled_time_s) if arrived else 0,
        energy_jpkg=motion_energy_jpkg(t),
        comfort_mps2=comfort_index(effort[:-1] / drive.trainset.mass_kg),
        parked=parking_index(float(t.position_m[-1]), drive.section.length_m),
    )


def safety_index(max_overspeed_mps: float) -> int:
    """``Is`` (Huang25 eq. 5): 1 when the largest excess over the limit is none, else 0."""
    return int(max_overspeed_mps <= OVERSPEED_MPS)


def punctuality_index(running_time_s: float, planned_time_s: float) -> int:
    """``It`` (Huang25 eqs. 6 and 7): 1 when ``|Ta - Tp|`` is at most 3 s, else 0."""
    return int(abs(running_time_s - planned_time_s) <= PUNCTUALITY_S)


def comfort_index(rate_mps2: Float[ndarray, " steps"], threshold_mps2: float = 0.0) -> float:
    """``Ic`` (Huang25 eqs. 10 and 11): the sum of ``|u(i+1) - u(i)|`` over the run, m/s^2.

    ``u`` is the rate of traction (above 0) and braking (below 0), which the paper keeps within 1 m/s^2: wheel
    effort over mass. It is 0 before departure and after the stop, so 0 -> 0.6 -> 0 -> -1 -> 0 measures 3.2.

    Args:
        rate_mps2: ``u`` of each control interval. Shape (steps,).
        threshold_mps2: Changes up to this size do not count.
    """
    change = np.abs(np.diff(rate_mps2, prepend=0.0, append=0.0))
    return float(change[change > max(threshold_mps2, STEADY_MPS2)].sum())


def parking_index(position_m: float, stop_m: float) -> int:
    """``Ip`` (Huang25 eqs. 12 and 13): 1 when the head stands at most 0.3 m from the stop, else 0."""
    return int(abs(position_m - stop_m) <= STOP_TOLERANCE_M)


ROUNDING = 1e-6


@dataclass(frozen=True)
class Kpis:
    """KPIs of a drive. A number that does not exist for the drive is None.

    Attributes:
        outcome: ``arrived``, ``overshot``, ``overspeed``, ``stalled`` or ``out_of_time``.
        safe: No speed above the limit in force and no overshoot.
        punctual: Within 3 s of the scheduled running time (Huang25 eq. 7).
        mass_kg: True mass of the trainset.
        effective_mass_kg: True mass with rotating masses.
        running_time_s: From departure to the stop.
        scheduled_time_s: Scheduled running time as it stood at the end.
        time_error_s: Running time minus scheduled time; positive is late.
        minimum_running_time_s: Flat-out running time under the same limits.
        protected_running_time_s: The same under protection's permitted speed, with the deceleration that it
            leaves: no drive that keeps the permitted speed takes less.
        stopping_error_m: Final position of the head minus the stop; positive is beyond it (Huang25 eq. 12).
        energy_wheel_kwh: Mechanical traction energy at the wheel.
        energy_regenerated_kwh: Energy the line took back.
        energy_line_kwh: Net energy at the line: traction over efficiency and auxiliaries, less regenerated.
        energy_effort_kwh: Work of traction and of brakes at the wheel (Lu23 eq. 16).
        energy_huang2025_jpkg: Energy index ``sum |a| v dt`` per kg (Huang25 eqs. 8 and 9).
        energy_objective: Which energy the optimum minimises: ``wheel`` or ``line``.
        optimal_energy_kwh: Least such energy for the achieved running time under the same limits.
        bound_energy_kwh: The certificate: no drive of the convex problem needs less.
        certificate_gap_percent: Largest possible excess of the optimal plan over the true optimum.
        optimality_gap_percent: Excess of this drive over the optimal plan; like the next two None where that
            needs next to nothing, as on a long fall.
        attainable_energy_kwh: Least such energy with the trainset's jerk limit, dead time and lag, under the
            permitted speed.
        attainable_bound_kwh: No drive within jerk limit and permitted speed needs less.
        trainset_gap_percent: Excess of the attainable energy over the optimal plan.
        driver_gap_percent: Excess of this drive over the attainable energy.
        max_overspeed_mps: Largest excess over the limit in force, 0 if none.
        interventions: Number of interventions of protection.
        max_speed_mps: Highest speed.
        max_acceleration_mps2: Highest acceleration.
        max_deceleration_mps2: Highest deceleration.
        rms_acceleration_mps2: Root mean square of the acceleration, not frequency-weighted.
        comfort_band: Band of the ISO 2631-1 scale (Lu23 Table 1) that holds it.
        max_jerk_mps3: Largest change of acceleration from one control period to the next; the stop counts.
        stopping_jerk_mps3: The same at the stop alone.
        jerk_limit_mps3: Jerk limit of the trainset in service, None if it has none.
        comfort_huang2025: Sum of the changes of the command (Huang25 eqs. 10 and 11).
        jerk_cheng2023_mps3: Largest change of acceleration within 2 s (Cheng23 Table 1, printed as m/s^3).
        coasting_distance_m: Distance without effort.
        regime_switches: Changes between power, cruise, coast and brake.
        decision_time_us_median: Median time the driver took for a decision.
    """

    outcome: str
    safe: bool
    punctual: bool
    mass_kg: float
    effective_mass_kg: float
    running_time_s: float
    scheduled_time_s: float
    time_error_s: float
    minimum_running_time_s: float | None
    protected_running_time_s: float | None
    stopping_error_m: float
    energy_wheel_kwh: float
    energy_regenerated_kwh: float
    energy_line_kwh: float
    energy_effort_kwh: float
    energy_huang2025_jpkg: float
    energy_objective: str
    optimal_energy_kwh: float | None
    bound_energy_kwh: float | None
    certificate_gap_percent: float | None
    optimality_gap_percent: float | None
    attainable_energy_kwh: float | None
    attainable_bound_kwh: float | None
    trainset_gap_percent: float | None
    driver_gap_percent: float | None
    max_overspeed_mps: float
    interventions: int
    max_speed_mps: float
    max_acceleration_mps2: float
    max_deceleration_mps2: float
    rms_acceleration_mps2: float
    comfort_band: str
    max_jerk_mps3: float
    stopping_jerk_mps3: float
    jerk_limit_mps3: float | None
    comfort_huang2025: float
    jerk_cheng2023_mps3: float
    coasting_distance_m: float
    regime_switches: int
    decision_time_us_median: float

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, words and None, ready for JSON: the fields, and the verdict on them."""
        return asdict(self) | {"success": self.success, "failed": list(self.failed)}

    @property
    def success(self) -> bool:
        """True if every requirement of :func:`checks` is met; decides headline and exit code."""
        return not self.failed

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the requirements that are not met."""
        return tuple(check.name for check in checks(self) if not check.passed)

    @property
    def on_time(self) -> bool:
        """True after a safe and punctual arrival, whatever jerk and interventions; campaigns count it."""
        return self.outcome == Outcome.ARRIVED.value and self.safe and self.punctual


def kpis_of(drive: Drive, optimum: Optimum | None, objective: Objective = "wheel") -> Kpis:
    """Measure a drive.

    Args:
        drive: The drive.
        optimum: Result of :func:`~metropilot.evaluate.optimum.optimum_of` under the same objective.
        objective: The energy that is compared with the optimum.
    """
    t, trainset = drive.trajectory, drive.trainset
    arrived = drive.outcome is Outcome.ARRIVED
    rms = measures.rms_acceleration(t)
    jerk_limit = drive.run.disturbance.nominal(drive.run.trainset).actuation.jerk_limit_mps3
    late = drive.running_time_s - drive.scheduled_time_s
    return Kpis(
        outcome=drive.outcome.value,
        safe=drive.outcome not in (Outcome.OVERSPEED, Outcome.OVERSHOT),
        punctual=arrived and abs(late) <= PUNCTUALITY_S,
        mass_kg=trainset.mass_kg,
        effective_mass_kg=trainset.effective_mass_kg,
        running_time_s=drive.running_time_s,
        scheduled_time_s=drive.scheduled_time_s,
        time_error_s=late,
        minimum_running_time_s=None if optimum is None else optimum.minimum_time_s,
        protected_running_time_s=None if optimum is None else optimum.protected_time_s,
        stopping_error_m=float(t.position_m[-1]) - drive.section.length_m,
        energy_wheel_kwh=float(t.energy_wheel_j[-1]) / J_PER_KWH,
        energy_regenerated_kwh=drive.recovered_j / J_PER_KWH,
        energy_line_kwh=float(t.energy_line_j[-1]) / J_PER_KWH,
        energy_effort_kwh=measures.effort_energy_j(t) / J_PER_KWH,
        energy_huang2025_jpkg=measures.motion_energy_jpkg(t),
        energy_objective=objective,
        **_against(drive, optimum, objective),
        max_overspeed_mps=drive.max_overspeed_mps,
        interventions=drive.interventions,
        max_speed_mps=float(t.speed_mps.max()),
        max_acceleration_mps2=float(max(t.acceleration_mps2.max(), 0.0)),
        max_deceleration_mps2=float(max(-t.acceleration_mps2.min(), 0.0)),
        rms_acceleration_mps2=rms,
        comfort_band=measures.comfort_band(rms),
        max_jerk_mps3=measures.max_jerk(t),
        stopping_jerk_mps3=measures.stopping_jerk(t),
        jerk_limit_mps3=jerk_limit if np.isfinite(jerk_limit) else None,
        comfort_huang2025=measures.command_variation(t),
        jerk_cheng2023_mps3=measures.window_jerk(t),
        coasting_distance_m=measures.coasting_distance_m(t),
        regime_switches=measures.regime_switches(t),
        decision_time_us_median=float(np.median(drive.decision_us)),
    )


AGAINST = (
    "optimal_energy_kwh",
    "bound_energy_kwh",
    "certificate_gap_percent",
    "optimality_gap_percent",
    "attainable_energy_kwh",
    "attainable_bound_kwh",
    "trainset_gap_percent",
    "driver_gap_percent",
)


def _against(drive: Drive, optimum: Optimum | None, objective: Objective) -> dict[str, float | None]:
    """The KPIs that need the optimum; None where the run did not arrive or has no plan."""
    found: dict[str, float | None] = dict.fromkeys(AGAINST)
    if optimum is None or drive.outcome is not Outcome.ARRIVED:
        return found
    t, plan, attainable = drive.trajectory, optimum.plan, optimum.attainable
    used = float((t.energy_line_j if objective == "line" else t.energy_wheel_j)[-1])
    found |= {
        "optimal_energy_kwh": plan.energy_j / J_PER_KWH,
        "bound_energy_kwh": plan.bound_j / J_PER_KWH,
        "certificate_gap_percent": 100.0 * plan.gap,
        "optimality_gap_percent": excess_percent(used, plan.energy_j),
    }
    if attainable is not None:
        found |= {
            "attainable_energy_kwh": attainable.energy_kwh,
            "attainable_bound_kwh": attainable.bound_j / J_PER_KWH,
            "trainset_gap_percent": excess_percent(attainable.energy_j, plan.energy_j),
            "driver_gap_percent": excess_percent(used, attainable.energy_j),
        }
    return found


ATTAINABLE = "with jerk limit, dead time, lag and protection"


class KpiRow(NamedTuple):
    """Row of the table of main KPIs.

    Attributes:
        name: KPI.
        value: Its value with its unit; a dash where it does not exist.
        remark: What it is measured against or by.
    """

    name: str
    value: str
    remark: str


def kpi_rows(kpis: Mapping[str, Any]) -> list[KpiRow]:
    """Rows of the main KPIs, as command line, console and reports show them.

    Args:
        kpis: Values of :meth:`Kpis.as_dict`, as ``kpis.json`` holds them; some are missing of an older run.
    """

    def value(name: str, digits: int, unit: str = "") -> str:
        found = kpis.get(name)
        # a bound of -1e-6 kWh is no negative one
        return "–" if found is None else f"{round(found, digits) + 0.0:.{digits}f} {unit}".rstrip()

    gap, bound = kpis.get("certificate_gap_percent"), value("attainable_bound_kwh", 2, "kWh")
    certificate = "" if gap is None else f"certified within {max(gap, 0.001):.3f} %"
    regenerated, rms = value("energy_regenerated_kwh", 2, "kWh"), value("rms_acceleration_mps2", 2, "m/s²")
    attained = [
        ("attainable", value("attainable_energy_kwh", 2, "kWh"), f"{ATTAINABLE}; at least {bound}"),
        ("lost by the trainset", value("trainset_gap_percent", 2, "%"), "attainable above the optimum"),
        ("lost by the driver", value("driver_gap_percent", 2, "%"), "this run above the attainable"),
    ]
    rows = [
        ("running time", value("running_time_s", 1, "s"), _times(kpis)),
        ("energy at the wheel", value("energy_wheel_kwh", 2, "kWh"), "traction"),
        ("energy at the line", value("energy_line_kwh", 2, "kWh"), f"net of {regenerated} regenerated"),
        (f"optimum at the {kpis['energy_objective']}", value("optimal_energy_kwh", 2, "kWh"), certificate),
        ("above the optimum", value("optimality_gap_percent", 2, "%"), "for the running time achieved"),
        *(attained if kpis.get("attainable_energy_kwh") is not None else ()),
        ("highest speed", f"{KMH_PER_MPS * kpis['max_speed_mps']:.1f} km/h", ""),
        (
            "acceleration",
            f"{kpis['max_acceleration_mps2']:+.2f} / {-kpis['max_deceleration_mps2']:+.2f} m/s²",
            f"r.m.s. {rms}: {kpis['comfort_band']}",
        ),
        ("largest jerk", value("max_jerk_mps3", 2, "m/s³"), "the stop included"),
        ("change within 2 s", value("jerk_cheng2023_mps3", 2, "m/s²"), "jerk as in Cheng23"),
        ("sum of command changes", value("comfort_huang2025", 2), "comfort as in Huang25"),
        ("coasting", value("coasting_distance_m", 0, "m"), f"{kpis['regime_switches']} changes of regime"),
        ("decision time", value("decision_time_us_median", 0, "µs"), "median"),
    ]
    return [KpiRow(*row) for row in rows]


def _times(kpis: Mapping[str, Any]) -> str:
    """Times that the running time is measured against."""
    least, protected = kpis.get("minimum_running_time_s"), kpis.get("protected_running_time_s")
    words = [f"scheduled {kpis['scheduled_time_s']:g} s"]
    if least is not None:
        words.append(f"minimum {round_up_time(least):.2f} s")
    if protected is not None and protected > kpis["scheduled_time_s"]:
        words.append(f"under protection {round_up_time(protected):.2f} s")
    return ", ".join(words)


class Check(NamedTuple):
    """Result of one requirement of a drive.

    Attributes:
        name: Requirement.
        value: Measured value with its unit.
        wanted: Allowed value with its unit.
        passed: True if it is met.
    """

    name: str
    value: str
    wanted: str
    passed: bool


@runtime_checkable
class Judged(Protocol):
    """KPIs that the requirements use: :class:`Kpis`, or the KPIs of one trainset of a convoy."""

    @property
    def outcome(self) -> str:
        """Outcome of the run."""
        ...

    @property
    def time_error_s(self) -> float:
        """Running time minus scheduled time."""
        ...

    @property
    def stopping_error_m(self) -> float:
        """Final position of the head minus its stop."""
        ...

    @property
    def max_overspeed_mps(self) -> float:
        """Largest excess over the limit."""
        ...

    @property
    def interventions(self) -> int:
        """Number of interventions of protection."""
        ...

    @property
    def max_jerk_mps3(self) -> float:
        """Largest jerk."""
        ...

    @property
    def jerk_limit_mps3(self) -> float | None:
        """Jerk limit, None if there is none."""
        ...


STOP_CHECK, TIME_CHECK, OVERSPEED_CHECK = "stops at the mark", "on time", "no overspeed"
INTERVENTION_CHECK, JERK_CHECK = "no intervention", "jerk"


def checks(kpis: Judged) -> tuple[Check, ...]:
    """The five requirements of a run, passed or failed."""
    arrived = kpis.outcome not in (Outcome.STALLED.value, Outcome.OUT_OF_TIME.value)
    stop, late, limit = kpis.stopping_error_m, kpis.time_error_s, kpis.jerk_limit_mps3
    jerk = kpis.max_jerk_mps3
    smooth = limit is None or jerk <= limit * (1 + ROUNDING) + ROUNDING
    return (
        Check(
            STOP_CHECK,
            f"{stop:+.3f} m",
            f"within {STOP_TOLERANCE_M:g} m",
            arrived and abs(stop) <= STOP_TOLERANCE_M,
        ),
        Check(
            TIME_CHECK,
            f"{late:+.2f} s" if arrived else kpis.outcome.replace("_", " "),
            f"within {PUNCTUALITY_S:g} s",
            arrived and abs(late) <= PUNCTUALITY_S,
        ),
        Check(
            OVERSPEED_CHECK,
            f"{KMH_PER_MPS * kpis.max_overspeed_mps:.2f} km/h",
            "0 km/h",
            kpis.outcome != Outcome.OVERSPEED.value,
        ),
        Check(INTERVENTION_CHECK, str(kpis.interventions), "0", kpis.interventions == 0),
        Check(
            JERK_CHECK,
            f"{jerk:.2f} m/s³" if smooth or round(jerk, 2) > (limit or 0.0) else f"{jerk:.7g} m/s³",
            "no limit" if limit is None else f"at most {limit:g} m/s³",
            smooth,
        ),
    )


def verdict(kpis: Judged) -> str:
    """Outcome in words that name every requirement that is not met."""
    return verdict_words(kpis, checks(kpis))


def outcome_words(kpis: Kpis) -> str:
    """The outcome in few words for a table: early or late, and other requirements that are not met."""
    said = kpis.outcome.replace("_", " ")
    if said == "arrived" and not kpis.punctual:
        said = "early" if kpis.time_error_s < 0 else "late"
    beside = {INTERVENTION_CHECK: "intervention", JERK_CHECK: "jerk"}
    return ", ".join([said, *(word for name, word in beside.items() if name in kpis.failed)])


def verdict_words(kpis: Judged, required: Sequence[Check]) -> str:
    """Outcome in words, for requirements that were checked before."""
    failed = {check.name: check.value for check in required if not check.passed}
    if not failed:
        return "arrived safely and on time"
    ended, late = kpis.outcome.replace("_", " "), kpis.time_error_s
    if kpis.outcome == Outcome.ARRIVED.value:
        ended = (
            f"arrived {abs(late):.1f} s {'early' if late < 0 else 'late'}"
            if TIME_CHECK in failed
            else "arrived on time"
        )
    count = kpis.interventions
    beside = [f"{count} intervention{'s' if count > 1 else ''}"] if INTERVENTION_CHECK in failed else []
    beside += [f"jerk {failed[JERK_CHECK]}"] if JERK_CHECK in failed else []
    joint = ", but " if ended == "arrived on time" else ", "
    return ended + (joint + ", ".join(beside) if beside else "")
