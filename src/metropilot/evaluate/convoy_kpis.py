"""KPIs of a convoy and of each of its trainsets."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from metropilot.evaluate import measures
from metropilot.evaluate.convoy_drive import ConvoyDrive
from metropilot.task import PUNCTUALITY_S, Outcome

J_PER_KWH = 3.6e6
OVERSPEED_MPS = 1e-6


@dataclass(frozen=True)
class MemberKpis:
    """What is known of one trainset of a convoy when the run is over.

    Attributes:
        number: 1 is the head.
        driver: Who drove it.
        outcome: Of its own run: a follower arrives behind a head that does.
        mass_kg: True mass.
        running_time_s: Until its last stand.
        stopping_error_m: Of the head: position less the stop; of a follower: wanted gap less gap.
        energy_wheel_kwh: Traction energy at the wheel.
        energy_regenerated_kwh: Given back to the line.
        energy_line_kwh: Net at the line.
        gap_min_m: Smallest gap to the trainset ahead; None for the head.
        gap_max_m: Largest.
        gap_end_m: At the end.
        speed_difference_max_mps: Largest speed difference to the trainset ahead; None for the head.
        interventions: Spells in which protection overruled the driver.
        emergency_brakes: How many of them came to the emergency brake.
        max_overspeed_mps: Largest excess over the limit.
        max_speed_mps: Highest speed.
        max_acceleration_mps2: Largest acceleration.
        max_deceleration_mps2: Largest deceleration.
        max_jerk_mps3: Largest jerk.
        comfort_huang2025: Sum of the changes of the command.
        decision_time_us_median: Median time of a decision; None for the head.
    """

    number: int
    driver: str
    outcome: str
    mass_kg: float
    running_time_s: float
    stopping_error_m: float
    energy_wheel_kwh: float
    energy_regenerated_kwh: float
    energy_line_kwh: float
    gap_min_m: float | None
    gap_max_m: float | None
    gap_end_m: float | None
    speed_difference_max_mps: float | None
    interventions: int
    emergency_brakes: int
    max_overspeed_mps: float
    max_speed_mps: float
    max_acceleration_mps2: float
    max_deceleration_mps2: float
    max_jerk_mps3: float
    comfort_huang2025: float
    decision_time_us_median: float | None


@dataclass(frozen=True)
class ConvoyKpis:
    """KPIs of a convoy.

    Attributes:
        outcome: How the head's run ended; ``overspeed`` if any trainset was too fast.
        punctual: Whether the head arrived within 3 s of the scheduled time.
        scheduled_time_s: Scheduled running time.
        gap_min_m: Smallest gap of all pairs.
        gap_max_m: Largest gap of all pairs.
        speed_difference_max_mps: Largest speed difference of all pairs.
        contacts: Pairs that touched.
        trainsets: Of each, the head first.
    """

    outcome: str
    punctual: bool
    scheduled_time_s: float
    gap_min_m: float
    gap_max_m: float
    speed_difference_max_mps: float
    contacts: int
    trainsets: tuple[MemberKpis, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, words and None, ready for JSON."""
        return asdict(self)

    @property
    def success(self) -> bool:
        """Whether all arrived safely and on time: what the exit code says."""
        return self.outcome == Outcome.ARRIVED.value and self.punctual and self.contacts == 0


def convoy_kpis(drive: ConvoyDrive, scheduled_time_s: float) -> ConvoyKpis:
    """Measure a convoy's run.

    Args:
        drive: The run.
        scheduled_time_s: The head's scheduled running time.
    """
    rows = tuple(_member(drive, k) for k in range(len(drive.trajectories)))
    head = rows[0]
    fast = max(drive.overspeed_mps) > OVERSPEED_MPS
    arrived = drive.outcome is Outcome.ARRIVED
    return ConvoyKpis(
        outcome=Outcome.OVERSPEED.value if fast else drive.outcome.value,
        punctual=bool(arrived and abs(head.running_time_s - scheduled_time_s) <= PUNCTUALITY_S),
        scheduled_time_s=scheduled_time_s,
        gap_min_m=float(drive.gap_m.min()),
        gap_max_m=float(drive.gap_m.max()),
        speed_difference_max_mps=float(np.abs(drive.speed_difference_mps).max()),
        contacts=drive.contacts,
        trainsets=rows,
    )


def _member(drive: ConvoyDrive, k: int) -> MemberKpis:
    """One trainset."""
    t, convoy = drive.trajectories[k], drive.convoy
    mass = convoy.trainsets[k].mass_kg * (convoy.mass_factors[k] if convoy.mass_factors else 1.0)
    moving = np.flatnonzero(t.speed_mps > 0)
    stands = float(t.time_s[min(int(moving[-1]) + 1, len(t) - 1)]) if moving.size else 0.0
    gaps = drive.gap_m[:, k - 1] if k else None
    apart = drive.speed_difference_mps[:, k - 1] if k else None
    apart_m = convoy.apart_m if float(t.position_m[-1]) >= convoy.uncouple_at_m + convoy.starts_m[k] else None
    error = float(t.position_m[-1]) - convoy.section.length_m
    if gaps is not None:
        error = (convoy.gap_m if apart_m is None else apart_m) - float(gaps[-1])
    touched = bool((drive.gap_m[:, max(k - 1, 0)] < 0).any()) if k else False
    return MemberKpis(
        number=k + 1,
        driver=drive.follower if k else drive.head,
        outcome="contact" if touched else drive.outcome.value,
        mass_kg=mass,
        running_time_s=stands,
        stopping_error_m=error,
        energy_wheel_kwh=float(t.energy_wheel_j[-1]) / J_PER_KWH,
        energy_regenerated_kwh=drive.recovered_j[k] / J_PER_KWH,
        energy_line_kwh=float(t.energy_line_j[-1]) / J_PER_KWH,
        gap_min_m=None if gaps is None else float(gaps.min()),
        gap_max_m=None if gaps is None else float(gaps.max()),
        gap_end_m=None if gaps is None else float(gaps[-1]),
        speed_difference_max_mps=None if apart is None else float(np.abs(apart).max()),
        interventions=drive.interventions[k],
        emergency_brakes=drive.emergencies[k],
        max_overspeed_mps=drive.overspeed_mps[k],
        max_speed_mps=float(t.speed_mps.max()),
        max_acceleration_mps2=float(max(t.acceleration_mps2.max(), 0.0)),
        max_deceleration_mps2=float(max(-t.acceleration_mps2.min(), 0.0)),
        max_jerk_mps3=measures.max_jerk(t),
        comfort_huang2025=measures.command_variation(t),
        decision_time_us_median=drive.decision_us[k] if k else None,
    )
