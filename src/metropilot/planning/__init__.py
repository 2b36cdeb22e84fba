"""Plans: flat out, energy-optimal with a certificate, journeys, and what a second costs."""

from metropilot.planning.front import Front, time_energy_front
from metropilot.planning.journey import (
    Call,
    JourneyPlan,
    Waypoint,
    journey_waypoints,
    plan_journey,
    timetable_waypoints,
)
from metropilot.planning.optimal import Plan, PlanOptions, minimum_running_time, optimal_plan, plan_arrays

__all__ = [
    "Call",
    "Front",
    "JourneyPlan",
    "Plan",
    "PlanOptions",
    "Waypoint",
    "journey_waypoints",
    "minimum_running_time",
    "optimal_plan",
    "plan_arrays",
    "plan_journey",
    "time_energy_front",
    "timetable_waypoints",
]
