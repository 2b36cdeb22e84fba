"""KPIs of a convoy and of each of its trainsets, and its folder of results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot._io import fill_folder, write_json
from metropilot._provenance import provenance
from metropilot.convoy.joint import joint_optimum
from metropilot.convoy.manoeuvre import Manoeuvre, find_manoeuvres, uncouples
from metropilot.convoy.request import ConvoyRequest
from metropilot.convoy.rollout import ConvoyDrive
from metropilot.evaluate import (
    INTERVENTION_CHECK,
    JERK_CHECK,
    OVERSPEED_CHECK,
    STOP_CHECK,
    TIME_CHECK,
    Check,
    checks,
    command_variation,
    copy_inputs,
    max_jerk,
    verdict_words,
)
from metropilot.planning import excess_percent
from metropilot.railway import copy_input
from metropilot.sim import PUNCTUALITY_S, STOP_TOLERANCE_M, Outcome
from metropilot.units import J_PER_KWH, KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


OVERSPEED_MPS = 1e-6
CONTACT, NO_CONTACT, LINK_SILENT = "contact", "no contact", "link_silent"
MANOEUVRES_CHECK = "couples and parts in time"
NAMED = 3
"""Largest number of failed trainsets that a headline names."""


@dataclass(frozen=True)
class MemberKpis:
    """KPIs of one trainset of a convoy.

    Attributes:
        number: 1 is the head.
        driver: Id of its driver.
        outcome: Outcome of its own run at its own mark; ``contact`` if it touched the trainset ahead;
            ``link_silent`` if it stands short of its mark and no message was sent to it since it stopped.
        mass_kg: True mass.
        running_time_s: Running time until its last standstill.
        time_error_s: Running time minus scheduled time; positive is late.
        stopping_error_m: Position of its front less its own mark; positive is beyond it. The head's mark is
            the stop; a follower's is where it stands at the wanted gap from a trainset ahead at its mark.
        energy_wheel_kwh: Traction energy at the wheel.
        energy_regenerated_kwh: Energy returned to the line.
        energy_line_kwh: Net energy at the line.
        joint_energy_kwh: Its part of the joint optimum, at the wheel; None where there is none.
        gap_min_m: Smallest gap to the trainset ahead; None for the head.
        gap_max_m: Largest gap; None for the head.
        gap_end_m: Gap at the end; None for the head.
        gap_error_m: Largest deviation of the gap from the planned one; None for the head.
        speed_difference_max_mps: Largest speed difference to the trainset ahead; None for the head.
        interventions: Number of interventions of protection.
        emergency_brakes: Number of those that used the emergency brake.
        max_overspeed_mps: Largest excess over the limit.
        max_speed_mps: Highest speed.
        max_acceleration_mps2: Largest acceleration.
        max_deceleration_mps2: Largest deceleration.
        max_jerk_mps3: Largest jerk.
        jerk_limit_mps3: Jerk limit of the trainset in service, None if it has none.
        comfort_huang2025: Sum of the changes of the command.
        decision_time_us_median: Median time of a decision; None for the head.
    """

    number: int
    driver: str
    outcome: str
    mass_kg: float
    running_time_s: float
    time_error_s: float
    stopping_error_m: float
    energy_wheel_kwh: float
    energy_regenerated_kwh: float
    energy_line_kwh: float
    joint_energy_kwh: float | None
    gap_min_m: float | None
    gap_max_m: float | None
    gap_end_m: float | None
    gap_error_m: float | None
    speed_difference_max_mps: float | None
    interventions: int
    emergency_brakes: int
    max_overspeed_mps: float
    max_speed_mps: float
    max_acceleration_mps2: float
    max_deceleration_mps2: float
    max_jerk_mps3: float
    jerk_limit_mps3: float | None
    comfort_huang2025: float
    decision_time_us_median: float | None

    @property
    def checks(self) -> tuple[Check, ...]:
        """The requirements of a run, and that there was no contact."""
        gap = "–" if self.gap_min_m is None else f"{self.gap_min_m:.2f} m"
        return (*checks(self), Check(NO_CONTACT, gap, "> 0 m", self.outcome != CONTACT))

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the requirements that it did not meet."""
        return tuple(check.name for check in self.checks if not check.passed)

    @property
    def verdict(self) -> str:
        """Outcome in words that name every requirement that is not met."""
        return verdict_words(self, self.checks)


@dataclass(frozen=True)
class ConvoyKpis:
    """KPIs of a convoy.

    Attributes:
        outcome: ``contact`` or ``overspeed`` if that is the outcome of any trainset; else the outcome of the
            first, from the head on, that did not arrive; ``arrived`` if all did.
        punctual: True if the head arrived within 3 s of the scheduled time.
        scheduled_time_s: Scheduled running time.
        gap_min_m: Smallest gap of all pairs.
        gap_max_m: Largest gap of all pairs.
        speed_difference_max_mps: Largest speed difference of all pairs.
        contacts: Pairs that touched.
        energy_wheel_kwh: Traction energy at the wheel, summed over the trainsets.
        joint_optimal_energy_kwh: Joint optimum of the convoy for the achieved running time; None where there
            is none (see :func:`metropilot.convoy.joint_optimum`) or the convoy did not arrive.
        joint_gap_percent: Energy above the joint optimum; None likewise, and where that is next to nothing.
        trainsets: KPIs of each trainset, the head first.
        manoeuvres: Couplings and uncouplings on the move.
    """

    outcome: str
    punctual: bool
    scheduled_time_s: float
    gap_min_m: float
    gap_max_m: float
    speed_difference_max_mps: float
    contacts: int
    energy_wheel_kwh: float
    joint_optimal_energy_kwh: float | None
    joint_gap_percent: float | None
    trainsets: tuple[MemberKpis, ...]
    manoeuvres: tuple[Manoeuvre, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, words and None, ready for JSON: the fields, and the verdicts on them."""
        found = asdict(self) | {
            "success": self.success,
            "failed": [c.name for c in self.checks if not c.passed],
        }
        rows = zip(found["trainsets"], self.trainsets, strict=True)
        found["trainsets"] = [row | {"success": not m.failed, "failed": list(m.failed)} for row, m in rows]
        return found

    @property
    def success(self) -> bool:
        """True if every trainset met every requirement; decides headline and exit code."""
        return not any(member.failed for member in self.trainsets) and not self._undone

    @property
    def checks(self) -> tuple[Check, ...]:
        """The requirements, each with the value of the worst trainset; passed if all trainsets passed."""
        found = tuple(self._worst(name) for name in (*WORST, NO_CONTACT))
        if not self.manoeuvres:
            return found
        count = len(self.manoeuvres)
        done = f"{count - len(self._undone)} of {count}"
        return (*found, Check(MANOEUVRES_CHECK, done, "all, before the stop or place", not self._undone))

    @property
    def _undone(self) -> tuple[Manoeuvre, ...]:
        """Manoeuvres that were not done in time."""
        return tuple(each for each in self.manoeuvres if not each.in_time)

    @property
    def verdict(self) -> str:
        """Outcome in words that name the trainsets that failed, and their requirements."""
        bad = [f"trainset {m.number} {m.verdict}" for m in self.trainsets if m.failed]
        bad += [f"{each.kind} of trainset {each.trainset} not done in time" for each in self._undone]
        more = [f"{len(bad) - NAMED} more failed"] if len(bad) > NAMED else []
        return "; ".join(bad[:NAMED] + more) or "arrived safely and on time"

    def _worst(self, name: str) -> Check:
        """One requirement over all trainsets."""
        if name == NO_CONTACT:
            return Check(name, f"{self.gap_min_m:.2f} m", "> 0 m", self.contacts == 0)
        size = WORST[name]
        rows = [(m, next(c for c in m.checks if c.name == name)) for m in self.trainsets]
        member, check = max(rows, key=lambda row: (not row[1].passed, size(row[0])))
        return check._replace(value=f"{check.value} (trainset {member.number})")


WORST: Mapping[str, Callable[[MemberKpis], float]] = {
    STOP_CHECK: lambda m: abs(m.stopping_error_m),
    TIME_CHECK: lambda m: abs(m.time_error_s),
    OVERSPEED_CHECK: lambda m: m.max_overspeed_mps,
    INTERVENTION_CHECK: lambda m: m.interventions,
    JERK_CHECK: lambda m: m.max_jerk_mps3,
}
"""Measure by which the worst trainset of a requirement is found."""


def convoy_kpis(drive: ConvoyDrive, scheduled_time_s: float) -> ConvoyKpis:
    """Measure a convoy's run.

    Args:
        drive: The run.
        scheduled_time_s: The head's scheduled running time.
    """
    marks, arrived = _marks(drive), Outcome.ARRIVED.value
    rows = tuple(_member(drive, k, scheduled_time_s, mark) for k, mark in enumerate(marks))
    head, optimal_j = rows[0], None
    ended = [member.outcome for member in rows]
    if all(word == arrived for word in ended):
        plan = joint_optimum(drive.convoy, max(member.running_time_s for member in rows))
        if plan is not None:
            optimal_j, parts = plan.energy_j, plan.trainset_energy_j
            rows = tuple(replace(m, joint_energy_kwh=j / J_PER_KWH) for m, j in zip(rows, parts, strict=True))
    energy_kwh = sum(member.energy_wheel_kwh for member in rows)
    bad = next((word for word in (CONTACT, Outcome.OVERSPEED.value) if word in ended), None)
    return ConvoyKpis(
        outcome=bad or next((word for word in ended if word != arrived), arrived),
        punctual=bool(drive.outcome is Outcome.ARRIVED and abs(head.time_error_s) <= PUNCTUALITY_S),
        scheduled_time_s=scheduled_time_s,
        gap_min_m=float(drive.gap_m.min()),
        gap_max_m=float(drive.gap_m.max()),
        speed_difference_max_mps=float(np.abs(drive.speed_difference_mps).max()),
        contacts=drive.contacts,
        energy_wheel_kwh=energy_kwh,
        joint_optimal_energy_kwh=None if optimal_j is None else optimal_j / J_PER_KWH,
        joint_gap_percent=None if optimal_j is None else excess_percent(energy_kwh * J_PER_KWH, optimal_j),
        trainsets=rows,
        manoeuvres=find_manoeuvres(drive),
    )


def _marks(drive: ConvoyDrive) -> list[float]:
    """Target position of the front of each trainset."""
    convoy, marks = drive.convoy, [drive.convoy.section.length_m]
    for k, ahead in enumerate(convoy.trainsets[:-1], 1):
        uncoupled = uncouples(drive, k)
        marks.append(marks[-1] - ahead.length_m - (convoy.apart_m if uncoupled else convoy.gap_m))
    return marks


def _member_outcome(drive: ConvoyDrive, k: int, error_m: float, stands_s: float) -> str:
    """Outcome of one trainset."""
    if k and bool((drive.gap_m[:, k - 1] < 0).any()):
        return CONTACT
    if drive.overspeed_mps[k] > OVERSPEED_MPS:
        return Outcome.OVERSPEED.value
    if k == 0 or drive.outcome is not Outcome.ARRIVED:
        return drive.outcome.value
    if drive.trajectories[k].speed_mps[-1] > 0:
        return Outcome.OUT_OF_TIME.value
    if abs(error_m) <= STOP_TOLERANCE_M:
        return Outcome.ARRIVED.value
    short = LINK_SILENT if drive.heard_s[k] <= stands_s else Outcome.STALLED.value
    return Outcome.OVERSHOT.value if error_m > 0 else short


def _member(drive: ConvoyDrive, k: int, scheduled_time_s: float, mark_m: float) -> MemberKpis:
    """One trainset."""
    t, convoy = drive.trajectories[k], drive.convoy
    disturbance = convoy.disturbance(k)
    known = disturbance.nominal(convoy.trainsets[k])
    moving = np.flatnonzero(t.speed_mps > 0)
    stands = float(t.time_s[min(int(moving[-1]) + 1, len(t) - 1)]) if moving.size else 0.0
    gaps = drive.gap_m[:, k - 1] if k else None
    apart = drive.speed_difference_mps[:, k - 1] if k else None
    error = float(t.position_m[-1]) - mark_m
    limit = known.actuation.jerk_limit_mps3
    return MemberKpis(
        number=k + 1,
        driver=drive.follower if k else drive.head,
        outcome=_member_outcome(drive, k, error, stands),
        mass_kg=known.mass_kg * disturbance.mass_factor,
        running_time_s=stands,
        time_error_s=stands - scheduled_time_s,
        stopping_error_m=error,
        energy_wheel_kwh=float(t.energy_wheel_j[-1]) / J_PER_KWH,
        energy_regenerated_kwh=drive.recovered_j[k] / J_PER_KWH,
        energy_line_kwh=float(t.energy_line_j[-1]) / J_PER_KWH,
        joint_energy_kwh=None,
        gap_min_m=None if gaps is None else float(gaps.min()),
        gap_max_m=None if gaps is None else float(gaps.max()),
        gap_end_m=None if gaps is None else float(gaps[-1]),
        gap_error_m=None if gaps is None else float(np.abs(gaps - drive.planned_gap_m[:, k - 1]).max()),
        speed_difference_max_mps=None if apart is None else float(np.abs(apart).max()),
        interventions=drive.interventions[k],
        emergency_brakes=drive.emergencies[k],
        max_overspeed_mps=drive.overspeed_mps[k],
        max_speed_mps=float(t.speed_mps.max()),
        max_acceleration_mps2=float(max(t.acceleration_mps2.max(), 0.0)),
        max_deceleration_mps2=float(max(-t.acceleration_mps2.min(), 0.0)),
        max_jerk_mps3=max_jerk(t),
        jerk_limit_mps3=limit if np.isfinite(limit) else None,
        comfort_huang2025=command_variation(t),
        decision_time_us_median=drive.decision_us[k] if k else None,
    )


WIDTH_IN, HEIGHT_IN = 8.4, 7.0


def write_convoy(folder: Path, request: ConvoyRequest, drive: ConvoyDrive, kpis: ConvoyKpis) -> None:
    """Write `trajectory-N.csv` of each trainset, `kpis.json`, `run.json`, `convoy.svg` and `convoy.png`.

    Also copies the line, trainset and policy files that `run.json` names.

    Args:
        folder: Folder; created if missing.
        request: Request of the run.
        drive: The run.
        kpis: Its KPIs.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate import save_figure

    with fill_folder(folder) as scratch:
        for k, trajectory in enumerate(drive.trajectories, 1):
            trajectory.write(scratch / f"trajectory-{k}.csv")
        write_json(scratch / "kpis.json", kpis.as_dict())
        behind = tuple(copy_input(scratch, key, f"behind-{k}") for k, key in enumerate(request.behind, 2))
        copied = replace(request, head=copy_inputs(scratch, request.head.resolve()), behind=behind)
        write_json(scratch / "run.json", {"run": copied.values(), "made_with": provenance()})
        save_figure(convoy_figure(drive, kpis), scratch / "convoy")


def convoy_figure(drive: ConvoyDrive, kpis: ConvoyKpis) -> Figure:
    """Speeds, gaps and speed differences over time, one above the other.

    Args:
        drive: The run.
        kpis: Its KPIs, for the line under the title.
    """
    from metropilot.evaluate import (
        BLACK,
        SERIES_STYLES,
        add_headline,
        house_style,
        label_panel,
        new_panels,
    )

    with house_style():
        figure, (speed, gap, apart) = new_panels(WIDTH_IN, HEIGHT_IN, (5.0, 4.0, 3.0))
        for k, t in enumerate(drive.trajectories):
            colour, dashes = (BLACK, "-") if k == 0 else SERIES_STYLES[(k - 1) % len(SERIES_STYLES)]
            name = f"head ({drive.head})" if k == 0 else f"{k + 1} ({drive.convoy.trainsets[k].id})"
            speed.plot(t.time_s, KMH_PER_MPS * t.speed_mps, color=colour, linestyle=dashes, label=name)
            if k:
                gap.plot(drive.time_s, drive.gap_m[:, k - 1], color=colour, linestyle=dashes)
                # So wide that it is seen behind a gap that is as planned.
                gap.plot(
                    drive.time_s, drive.planned_gap_m[:, k - 1], color="#D0D0D0", linewidth=5.0, zorder=1
                )
                apart.plot(drive.time_s, drive.speed_difference_mps[:, k - 1], color=colour, linestyle=dashes)
        gap.axhline(0.0, color="#B00020", linewidth=0.8, zorder=1)
        speed.set_ylabel("speed (km/h)")
        speed.set_xlim(0.0, float(drive.time_s[-1]))
        convoy, section = drive.convoy, drive.convoy.section
        wanted = f"{convoy.gap_m:g} m"
        if np.isfinite(convoy.uncouple_at_m):
            wanted += f", {convoy.apart_m:g} m from {convoy.uncouple_at_m:g} m on"
        label_panel(gap, f"gap to the trainset ahead (m); grey: planned (wanted {wanted}), red: contact")
        label_panel(apart, "speed ahead less own speed (m/s)")
        apart.set_xlabel("time since departure (s)")
        title = f"{section.origin.name} – {section.destination.name}, {len(drive.trajectories)} trainsets"
        below = (
            f"{drive.follower}, {convoy.guard}: gap {kpis.gap_min_m:.2f} to {kpis.gap_max_m:.2f} m, "
            f"speed difference at most {kpis.speed_difference_max_mps:.2f} m/s, {kpis.contacts} contacts"
        )
        add_headline(speed, title, below)
        return figure
