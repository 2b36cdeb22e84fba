"""Plans: flat out, energy-optimal with a certificate, journeys, and what a second costs."""

from metropilot.planning.fastest import LONGEST_RATIO, check_running_time, stated_s
from metropilot.planning.front import Front, time_energy_front
from metropilot.planning.journey import (
    Call,
    JourneyPlan,
    Waypoint,
    journey_waypoints,
    plan_journey,
    timetable_waypoints,
)
from metropilot.planning.notches import NotchOptions, NotchPlan, notch_plan
from metropilot.planning.optimal import Plan, PlanOptions, minimum_running_time, optimal_plan, plan_arrays
from metropilot.planning.references import (
    Reference,
    ReferenceShape,
    peak_speed,
    reference,
    reference_for_time,
)

__all__ = [
    "LONGEST_RATIO",
    "Call",
    "Front",
    "JourneyPlan",
    "NotchOptions",
    "NotchPlan",
    "Plan",
    "PlanOptions",
    "Reference",
    "ReferenceShape",
    "Waypoint",
    "check_running_time",
    "journey_waypoints",
    "minimum_running_time",
    "notch_plan",
    "optimal_plan",
    "peak_speed",
    "plan_arrays",
    "plan_journey",
    "reference",
    "reference_for_time",
    "stated_s",
    "time_energy_front",
    "timetable_waypoints",
]
