"""Plans: flat out, energy-optimal with a certificate, journeys, and what a second costs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.planning.effort_table import STEP_MPS, Specific, specific
    from metropilot.planning.fastest import LONGEST_RATIO, check_running_time, fastest_profile, stated_s
    from metropilot.planning.journey import (
        Call,
        JourneyPlan,
        Waypoint,
        journey_waypoints,
        plan_journey,
        timetable_waypoints,
    )
    from metropilot.planning.mesh import Mesh, build_mesh, limit_at
    from metropilot.planning.notches import NotchOptions, NotchPlan, notch_plan
    from metropilot.planning.optimal import (
        START_STRETCH_M,
        Front,
        Plan,
        PlanOptions,
        fastest_time,
        minimum_running_time,
        optimal_plan,
        plan_arrays,
        plan_speed,
        plan_time,
        pull_away,
        ramped_acceleration,
        time_energy_front,
    )
    from metropilot.planning.prices import Objective
    from metropilot.planning.references import (
        Reference,
        ReferenceShape,
        peak_speed,
        reference,
        reference_for_time,
    )
    from metropilot.planning.timed_reference import (
        ReferenceTrack,
        TimedReference,
        reference_under,
        reference_under_for_time,
        sample_reference,
        sampled_profile,
    )

__all__ = [
    "LONGEST_RATIO",
    "START_STRETCH_M",
    "STEP_MPS",
    "Call",
    "Front",
    "JourneyPlan",
    "Mesh",
    "NotchOptions",
    "NotchPlan",
    "Objective",
    "Plan",
    "PlanOptions",
    "Reference",
    "ReferenceShape",
    "ReferenceTrack",
    "Specific",
    "TimedReference",
    "Waypoint",
    "build_mesh",
    "check_running_time",
    "fastest_profile",
    "fastest_time",
    "journey_waypoints",
    "limit_at",
    "minimum_running_time",
    "notch_plan",
    "optimal_plan",
    "peak_speed",
    "plan_arrays",
    "plan_journey",
    "plan_speed",
    "plan_time",
    "pull_away",
    "ramped_acceleration",
    "reference",
    "reference_for_time",
    "reference_under",
    "reference_under_for_time",
    "sample_reference",
    "sampled_profile",
    "specific",
    "stated_s",
    "time_energy_front",
    "timetable_waypoints",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "effort_table": ("STEP_MPS", "Specific", "specific"),
        "fastest": ("LONGEST_RATIO", "check_running_time", "fastest_profile", "stated_s"),
        "journey": (
            "Call",
            "JourneyPlan",
            "Waypoint",
            "journey_waypoints",
            "plan_journey",
            "timetable_waypoints",
        ),
        "mesh": ("Mesh", "build_mesh", "limit_at"),
        "notches": ("NotchOptions", "NotchPlan", "notch_plan"),
        "optimal": (
            "Front",
            "Plan",
            "PlanOptions",
            "START_STRETCH_M",
            "fastest_time",
            "minimum_running_time",
            "optimal_plan",
            "plan_arrays",
            "plan_speed",
            "plan_time",
            "pull_away",
            "ramped_acceleration",
            "time_energy_front",
        ),
        "prices": ("Objective",),
        "references": ("Reference", "ReferenceShape", "peak_speed", "reference", "reference_for_time"),
        "timed_reference": (
            "ReferenceTrack",
            "TimedReference",
            "reference_under",
            "reference_under_for_time",
            "sample_reference",
            "sampled_profile",
        ),
    },
)
