"""Published results, and the setting: the references and the five scenarios."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from metropilot import planning
from metropilot.errors import InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.railway import Section, Steps, Trainset, load_line, load_trainset
from metropilot.studies.cheng2023.tracking import ReferenceCourse, course_of
from metropilot.units import KMH_PER_MPS

CITATION = (
    "G. Cheng, D. Wang, M. Sun, Z. Fu, B. Yuan, L. Zhang, X. Xiao: Optimizing Subway Train Operation With "
    "Hierarchical Adaptive Control Approach. IEEE Access 11, 2023, doi 10.1109/ACCESS.2023.3341212."
)

KPIS = (
    ("speed_total_mps", "total speed error", "m/s"),
    ("speed_max_mps", "largest speed error", "m/s"),
    ("position_total_m", "total position error", "m"),
    ("position_max_m", "largest position error", "m"),
    ("parking_m", "parking error", "m"),
    ("energy_kwh", "energy at wheel", "kWh"),
    ("jerk_mps3", "jerk over 2 s", "m/s3"),
)
"""Columns of tables 1 and 3: field of ``TrackingKpis``, words, unit. Totals sum over periods of 0.2 s."""

TABLE_1 = {
    "pid": (24.29, 0.31, 48.96, 0.97, 0.17, 17.55, 0.93),
    "fuzzy_pid": (6.95, 0.28, 17.49, 0.56, 0.02, 17.40, 0.49),
    "neural_pid": (6.32, 0.27, 16.78, 0.47, 0.00, 17.16, 0.65),
    "ddpg_pid": (3.51, 0.17, 10.32, 0.34, 0.00, 17.04, 0.39),
}
TABLE_3 = {
    1: TABLE_1["ddpg_pid"],
    2: (9.48, 0.32, 25.80, 0.94, 0.00, 19.07, 0.40),
    3: (6.57, 0.25, 13.41, 0.65, 0.01, 14.98, 0.39),
}
TABLE_4 = {
    1: (0.01, 0.17, 0.02, 0.34, 0.00, 17.04, 0.39),
    4: (0.05, 0.60, 0.34, 2.92, 0.07, 19.36, 0.50),
    5: (0.01, 0.05, 0.00, 0.01, 0.02, 15.22, 0.44),
}
"""Results of DDPG-PID; the first and third columns are averages over the run."""


DT_S = 0.2
LENGTH_M = 1280.0
LIMIT_MPS = 80 / KMH_PER_MPS
SHAPE = planning.ReferenceShape(0.9, 0.8, 0.5)
GENTLE = planning.ReferenceShape(0.75, 0.75, 0.4)
EFFORT_SHARE = 0.9
CRUISE_MPS = {"base": 18.3, "fast": 19.7, "slow": 17.2}
"""Cruising speeds that give the published energies 17.04, 19.36 and 15.22 kWh."""
REFERENCES = {
    "s_curve": "S-curve 0.9/0.8 m/s2, 0.5 m/s3, within 90 % of the effort at hand",
    "gentle": "S-curve 0.75/0.75 m/s2, 0.4 m/s3, within 90 % of the effort at hand",
    "trapezoid": "trapezoid 0.9/0.8 m/s2, within 90 % of the effort at hand",
    "drawn": "S-curve 0.9/0.8 m/s2, 0.5 m/s3, as drawn: beyond the effort at hand",
    "optimal": "energy-optimal plan in the running time of the S-curve",
}
SCENARIOS = {
    1: ("base", 1.0),
    2: ("base", 1.5),
    3: ("base", 0.5),
    4: ("fast", 1.0),
    5: ("slow", 1.0),
}
"""Speed of the reference and factor on the running resistance (Cheng23 tables 2 to 4)."""
NAMES = {
    1: "scenario 1: base",
    2: "scenario 2: resistance x 1.5",
    3: "scenario 3: resistance x 0.5",
    4: "scenario 4: faster reference",
    5: "scenario 5: slower reference",
}


@cache
def trainset() -> Trainset:
    """The paper's trainset: a point mass with ideal actuation."""
    return load_trainset("cheng2023").ideal()


@cache
def section() -> Section:
    """1280 m of straight, level track, 80 km/h throughout."""
    like = load_line("yizhuang").section("RJ", "WYJ")
    level = Steps(np.array([0.0]), np.array([0.0]))
    limit = Steps(np.array([0.0]), np.array([LIMIT_MPS]))
    return replace(
        like,
        line_id="cheng2023",
        length_m=LENGTH_M,
        limit_mps=limit,
        gradient_permil=level,
        curves=(),
        tunnels=(),
    )


def reference_of(kind: str, speed: str = "base") -> planning.TimedReference:
    """Compute a reference, sampled at the paper's control period.

    Args:
        kind: Key of ``REFERENCES``.
        speed: ``base``, ``fast`` or ``slow``.

    Raises:
        InputError: No such reference.
    """
    if kind not in REFERENCES:
        raise InputError("unknown reference", field="reference", value=kind, allowed=", ".join(REFERENCES))
    cruise = CRUISE_MPS[speed]
    if kind == "drawn":
        return planning.sample_reference(planning.reference(LENGTH_M, cruise, SHAPE), DT_S)
    vehicle, track = vehicle_arrays(trainset()), track_arrays(section(), trainset())
    if kind == "optimal":
        time_s = reference_of("s_curve", speed).duration_s
        plan = planning.plan_arrays(vehicle, track, time_s, planning.PlanOptions())
        return planning.sample_profile(plan.position_m, plan.speed_mps, DT_S)
    shape = GENTLE if kind == "gentle" else SHAPE
    shape = replace(shape, jerk_mps3=math.inf) if kind == "trapezoid" else shape
    return planning.reference_under(
        planning.ReferenceTrack(vehicle, track, effort_share=EFFORT_SHARE), shape, cruise, DT_S
    )


def draw_courses(count: int, seed: int) -> tuple[ReferenceCourse, ...]:
    """Draw S-curves of other shapes and speeds than the study's, each with its own running resistance.

    Args:
        count: Number of courses.
        seed: Seed of the draw.
    """
    random = np.random.default_rng(seed)
    track = planning.ReferenceTrack(
        vehicle_arrays(trainset()), track_arrays(section(), trainset()), effort_share=EFFORT_SHARE
    )
    found = []
    for _ in range(count):
        shape = planning.ReferenceShape(*random.uniform((0.6, 0.6, 0.3), (0.95, 0.95, 0.8)))
        timed = planning.reference_under(track, shape, float(random.uniform(15.0, 20.5)), DT_S)
        found.append(course_of(trainset(), section(), timed, float(random.uniform(0.5, 1.5))))
    return tuple(found)


def course(kind: str = "s_curve", scenario: int = 1) -> ReferenceCourse:
    """Course to track in a scenario: reference, vehicle and track."""
    speed, factor = SCENARIOS[scenario]
    return course_of(trainset(), section(), reference_of(kind, speed), factor)


@cache
def optimal_kwh(scenario: int = 1) -> float:
    """Least traction energy at the wheel in the running time of a scenario's reference, kWh."""
    of, speed = course(scenario=scenario), SCENARIOS[scenario][0]
    time_s = reference_of("s_curve", speed).duration_s
    return planning.plan_arrays(of.vehicle, of.track, time_s, planning.PlanOptions(spacing_m=5.0)).energy_kwh
