"""The guards of protection, where each stands, and its source without it; for `tools/mutate_guards.py`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPERVISOR, PREDICT, CURVES, SEPARATION, BOUNDS = (
    f"protection/{name}.py" for name in ("supervisor", "predict", "curves", "separation", "bounds")
)
BY_NAME = "test_supervisor.py"
DUELS = "test_mutations.py"
PAIRS = "test_separation.py"
LAWS = "test_curves.py"
HOSTILE = "test_hostile.py"
WORST = "test_worst_case.py"
ALL = (BY_NAME, LAWS, PAIRS, "test_guards.py", DUELS, "test_permitted.py", WORST, HOSTILE)


@dataclass(frozen=True)
class Guard:
    """One guard, and how to remove it.

    Attributes:
        name: What it guards against.
        hazard: Number of the hazard in the safety argument.
        file: Where it stands, below the package.
        old: Source that holds it; occurs once.
        new: The same without it.
        tests: Test files that should notice, the likeliest first.
    """

    name: str
    hazard: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = (DUELS,)


GUARDS = (
    Guard(
        "every command is checked",
        "H1",
        SUPERVISOR,
        "    level = unless(passes, 0, _milder,",
        "    level = unless(passes | True, 0, _milder,",
        (BY_NAME,),
    ),
    Guard(
        "the emergency brake must be in time for every plant",
        "H1",
        SUPERVISOR,
        "margin_mps) & self._in_time(self.worst, share, margin_mps)",
        "margin_mps)",
        ("test_mutations.py::test_guard_in_the_arrays[control period]",),
    ),
    Guard(
        "a traction cut-off must suffice, or braking follows",
        "H1",
        SUPERVISOR,
        "return check.xp.where(check.passes(cut, none), 1, brake)",
        "return check.xp.where(check.passes(cut, none) | True, 1, brake)",
        (HOSTILE,),
    ),
    Guard(
        "a service brake must suffice, or the emergency brake acts",
        "H1",
        SUPERVISOR,
        "return 1 if check.passes(cut, none) else 2 if check.emergency(none - 1.0, none) else 3",
        "return 1 if check.passes(cut, none) else 2",
        (BY_NAME,),
    ),
    Guard(
        "the last level is the emergency brake",
        "H1",
        SUPERVISOR,
        "emergency = (level == 3) | (memory",
        "emergency = (memory",
        (BY_NAME,),
    ),
    Guard(
        "service brake before emergency brake",
        "comfort",
        SUPERVISOR,
        "self._in_time(self.usual, share, margin_mps) & self",
        "self",
        (BY_NAME,),
    ),
    Guard(
        "a command that is not a number is a full brake",
        "H2",
        SUPERVISOR,
        'xp.where(xp.abs(command.share) < float("inf"), xp.clip(command.share, -1.0, 1.0), full)',
        "xp.clip(command.share, -1.0, 1.0)",
        (BY_NAME,),
    ),
    Guard(
        "a command out of range is clipped",
        "H2",
        SUPERVISOR,
        "xp.clip(command.share, -1.0, 1.0), full)",
        "command.share, full)",
        (BY_NAME,),
    ),
    Guard(
        "a position that is not a number",
        "H3",
        SUPERVISOR,
        "self.measured = known & forward",
        "self.measured = forward",
        (BY_NAME,),
    ),
    Guard(
        "a speed that is not a number",
        "H3",
        SUPERVISOR,
        "self.measured = known & forward",
        "self.measured = known",
        (BY_NAME,),
    ),
    Guard(
        "a position before the map",
        "H3",
        SUPERVISOR,
        'known = (position_m >= protection.start_m - protection.spacing_m) & (position_m < float("inf"))',
        'known = xp.abs(position_m) < float("inf")',
        ("test_supervisor.py",),
    ),
    Guard(
        "a speed below zero",
        "H3",
        SUPERVISOR,
        "forward = (speed_mps >= -(STANDSTILL_MPS + protection.rates.speed_error_mps)) & (",
        'forward = (speed_mps > -float("inf")) & (',
        ("test_supervisor.py",),
    ),
    Guard(
        "error of the measured speed",
        "H3",
        SUPERVISOR,
        "speed = self.speed_mps + brake.rates.speed_error_mps + margin_mps",
        "speed = self.speed_mps + margin_mps",
        ("test_mutations.py::test_guard_in_the_arrays[error of the measured speed]",),
    ),
    Guard(
        "error of the measured position",
        "H3",
        CURVES,
        "    if bounds.position_error_m > 0:\n",
        "    if bounds.position_error_m > 1e9:\n",
        ("test_mutations.py::test_guard_in_the_curves[error of the measured position]",),
    ),
    Guard(
        "a larger margin before a command passes again",
        "H4",
        SUPERVISOR,
        "margin = xp.where(memory.level > 0, RELEASE_MPS, 0.0)",
        "margin = xp.where(memory.level > 0, 0.0, 0.0)",
        ("test_supervisor.py::test_after_an_intervention_a_command_needs_more_room",),
    ),
    Guard(
        "commands in the dead time",
        "H4",
        SUPERVISOR,
        "newest = self.xp.maximum(share, self.older)",
        "newest = share",
        ("test_mutations.py::test_commands_on_their_way",),
    ),
    Guard(
        "remainder of older commands after the lag",
        "H4",
        SUPERVISOR,
        "return newest + self.xp.maximum(self.memory.share - newest, 0.0) * self.protection.fading.share",
        "return newest",
        ("test_mutations.py::test_guard_in_the_arrays[lag]",),
    ),
    Guard(
        "remainder of the last acceleration under the jerk limit",
        "H4",
        SUPERVISOR,
        "acting = self.xp.maximum(acceleration(brake.forces, self.share_bound(share)), fading)",
        "acting = acceleration(brake.forces, self.share_bound(share))",
        ("test_mutations.py::test_guard_in_the_arrays[jerk limit in service]",),
    ),
    Guard(
        "the stored acceleration is the largest possible",
        "H4",
        SUPERVISOR,
        "return kept, self.xp.maximum(acceleration(self.worst.forces, kept), self.fading)",
        "return kept, acceleration(self.worst.forces, kept)",
        ("test_mutations.py::test_guard_in_the_arrays[jerk limit in service]",),
    ),
    Guard(
        "the emergency brake stays on until standstill",
        "H6",
        SUPERVISOR,
        "| (memory.emergency & moving) |",
        "|",
        (BY_NAME,),
    ),
    Guard(
        "the driver may apply the emergency brake",
        "H6",
        SUPERVISOR,
        "(memory.emergency & moving) | command.emergency",
        "(memory.emergency & moving)",
        (BY_NAME,),
    ),
    Guard(
        "one period passes before the next decision",
        "H5",
        BOUNDS,
        "return self.dt_s * (1 + ceil(",
        "return self.dt_s * (0 + ceil(",
        ("test_mutations.py::test_guard_in_the_arrays[control period]",),
    ),
    Guard(
        "dead time of the emergency brake",
        "H5",
        BOUNDS,
        "return self.dt_s * (1 + ceil(self.emergency_reaction_s / self.dt_s - 1e-3))",
        "return self.dt_s",
        ("test_mutations.py::test_guard_in_the_arrays[reaction of the emergency brake]",),
    ),
    Guard(
        "build-up of the emergency brake",
        "H5",
        CURVES,
        "        jerk_mps3=min(bounds.emergency_jerk_mps3, AT_ONCE_MPS3),\n",
        "        jerk_mps3=AT_ONCE_MPS3,\n",
        ("test_mutations.py::test_guard_in_the_arrays[build-up of the emergency brake]",),
    ),
    Guard(
        "a trainset lighter than nominal gains more speed",
        "H5",
        PREDICT,
        "lightest = rates.mass_low * vehicle",
        "lightest = vehicle",
        ("test_mutations.py::test_guard_in_the_arrays[lighter than nominal]",),
    ),
    Guard(
        "a trainset heavier than nominal brakes less",
        "H5",
        PREDICT,
        "heaviest = rates.mass_high * vehicle",
        "heaviest = vehicle",
        ("test_mutations.py::test_guard_in_the_arrays[heavier than nominal]",),
    ),
    Guard(
        "a service brake weaker than nominal",
        "H5",
        PREDICT,
        "hold = rates.service_share * xp",
        "hold = xp",
        ("test_mutations.py::test_guard_in_the_arrays[weak service brake]",),
    ),
    Guard(
        "uncertain resistance",
        "H5",
        PREDICT,
        "coast = pull_mps2 - rates.resistance_low * davis",
        "coast = pull_mps2 - davis",
        ("test_mutations.py::test_guard_in_the_arrays[resistance that is not certain]",),
    ),
    Guard(
        "traction at the worse of two speeds",
        "H5",
        PREDICT,
        "push = xp.maximum(slow.traction_n, quick.traction_n) / lightest",
        "push = quick.traction_n / lightest",
        ("test_curves.py::test_forces_are_the_worst_that_any_speed_and_plant_within_reach_can_have",),
    ),
    Guard(
        "brake at the worse of two speeds",
        "H5",
        PREDICT,
        "xp.minimum(slow.brake_n, quick.brake_n) / heaviest",
        "slow.brake_n / heaviest",
        ("test_curves.py::test_forces_are_the_worst_that_any_speed_and_plant_within_reach_can_have",),
    ),
    Guard(
        "speed that a fall adds until the emergency brake acts",
        "H5",
        PREDICT,
        "high = speed_mps + rates.speed_error_mps + gain_mps",
        "high = speed_mps + rates.speed_error_mps",
        ("test_supervisor.py::test_a_brake_that_fades_while_a_fall_adds_speed",),
    ),
    Guard(
        "gradient during the reaction",
        "H7",
        SUPERVISOR,
        "return self.xp.maximum(pulls[self.node], pulls[self.node + 1])",
        "return 0.0 * pulls[self.node]",
        ("test_mutations.py::test_guard_in_the_arrays[gradient in the reaction]",),
    ),
    Guard(
        "gradient of the next node too",
        "H7",
        SUPERVISOR,
        "return self.xp.maximum(pulls[self.node], pulls[self.node + 1])",
        "return pulls[self.node]",
        ("test_curves.py::test_the_next_node_counts_too",),
    ),
    Guard(
        "gradient as far as the prediction reaches",
        "H7",
        CURVES,
        "pull = sliding_max(field.pull_mps2, before, reach)",
        "pull = sliding_max(field.pull_mps2, before, 1)",
        ("test_curves.py::test_a_fall_counts_from_afar_and_for_a_while_after_it",),
    ),
    Guard(
        "gradient behind the trainset",
        "H7",
        CURVES,
        "    before = int(np.ceil(_memory_m(bounds, top, field.pull_mps2) / spacing_m))\n",
        "    before = 0\n",
        ("test_curves.py::test_a_fall_counts_from_afar_and_for_a_while_after_it",),
    ),
    Guard(
        "gradient in the braking curve",
        "H7",
        CURVES,
        "rate = rate_mps2 - sliding_max(field.pull_mps2, before, 1)[:-1]",
        "rate = rate_mps2 + 0.0 * sliding_max(field.pull_mps2, before, 1)[:-1]",
        ("test_curves.py::test_emergency_curve_is_the_braking_parabola",),
    ),
    Guard(
        "gradient changes between nodes",
        "H7",
        CURVES,
        "    kinks = np.concatenate([breaks, breaks + trainset.length_m])\n",
        "    kinks = breaks[:0]\n",
        ("test_curves.py::test_a_fall_between_two_nodes_counts",),
    ),
    Guard(
        "limits between nodes",
        "H8",
        CURVES,
        "    for step in range(1, int((high - low).max()) + 1):\n",
        "    for step in range(1, 1):\n",
        ("test_curves.py::test_a_limit_between_two_nodes_counts",),
    ),
    Guard(
        "a limit holds until the tail has cleared it",
        "H8",
        CURVES,
        "restrictive_profile(section, trainset.length_m, trainset",
        "restrictive_profile(section, 0.0, trainset",
        ("test_curves.py::test_emergency_curve_is_the_braking_parabola",),
    ),
    Guard(
        "the lower of two limits at a node",
        "H8",
        CURVES,
        "np.minimum(np.append(ceiling[0], ceiling), np.append(ceiling, 0.0))",
        "np.append(ceiling, 0.0)",
        ("test_curves.py::test_at_a_change_of_limit_the_lower_one_counts",),
    ),
    Guard(
        "every point of the motion, not only the last",
        "H8",
        PREDICT,
        "    return xp.all(cells & (full",
        "    return xp.all(cells[..., -1:] & (full",
        ("test_mutations.py::test_zones_shorter_than_the_reaction",),
    ),
    Guard(
        "points between two nodes of the prediction",
        "H8",
        PREDICT,
        "xp.minimum(room[..., left], room[..., right]) >= bulge",
        "xp.minimum(room[..., left], room[..., right]) >= 0.0",
        ("test_supervisor.py::test_nobody_creeps_over_the_limit_between_two_nodes",),
    ),
    Guard(
        "a prediction that leaves the window is refused",
        "H8",
        PREDICT,
        "xp.all(cells & (full <= distance_m[..., -1:]), axis=-1)",
        "xp.all(cells, axis=-1)",
        ("test_curves.py::test_a_prediction_that_leaves_the_window_is_refused",),
    ),
    Guard(
        "end of the movement authority",
        "H9",
        CURVES,
        "return ceiling if stop_at_m is None else np.where(nodes[1:] > stop_at_m, 0.0, ceiling)",
        "return ceiling",
        ("test_supervisor.py::test_the_end_of_the_authority_is_never_passed",),
    ),
    Guard(
        "release speed at the end of the authority behind a stop",
        "H9",
        CURVES,
        "field._replace(ceiling_mps=np.minimum(field.ceiling_mps, most[1:]))",
        "field",
        ("test_curves.py::test_the_curves_lead_to_the_release_speed_at_the_end_of_the_authority",),
    ),
    Guard(
        "emergency brake beyond the end of the authority",
        "H9",
        SUPERVISOR,
        "| command.emergency | beyond",
        "| command.emergency",
        ("test_supervisor.py::test_a_creep_past_the_end_of_the_authority_is_not_silent",),
    ),
    Guard(
        "the map ends in a stop",
        "H9",
        CURVES,
        "curve = np.zeros_like(limit)",
        "curve = np.full_like(limit, np.inf)",
        ("test_curves.py::test_the_map_ends_in_a_stop",),
    ),
    Guard(
        "rounding of the number type",
        "H10",
        CURVES,
        "np.maximum(_emergency_curve(field, bounds, rate_mps2, before) - rounding, 0.0)",
        "np.maximum(_emergency_curve(field, bounds, rate_mps2, before), 0.0)",
        ("test_curves.py::test_curves_keep_clear_of_their_number_types_rounding",),
    ),
    Guard(
        "the trainset ahead is supervised",
        "H11",
        SUPERVISOR,
        "        if self.ahead is None:\n",
        "        if True:\n",
        ("test_separation.py::test_a_trainset_ahead_that_is_no_number_brings_the_emergency_brake",),
    ),
    Guard(
        "margin that must remain",
        "H11",
        SUPERVISOR,
        ">= bounds.margin_m + rooms * bounds.room_m",
        ">= rooms * bounds.room_m",
        ("test_separation.py::test_the_margin_is_never_used_up",),
    ),
    Guard(
        "age of the last message",
        "H11",
        SEPARATION,
        "distance_at(leader, times + ahead.age_s)",
        "distance_at(leader, times)",
        ("test_separation.py::test_least_gap_is_never_more_than_the_smallest_on_the_way",),
    ),
    Guard(
        "the trainset ahead may brake from its message on",
        "H11",
        SEPARATION,
        "bounds.leader_jerk_mps3, bounds.leader_mps2)\n",
        "bounds.leader_jerk_mps3, 0.5 * bounds.leader_mps2)\n",
        ("test_separation.py::test_nobody_ahead_stops_shorter_than_assumed",),
    ),
    Guard(
        "its deceleration starts one period earlier",
        "H11",
        SEPARATION,
        "worst = ahead.acceleration_mps2 - bounds.leader_jerk_mps3 * bounds.period_s",
        "worst = ahead.acceleration_mps2 - 0.0 * bounds.period_s",
        ("test_separation.py::test_nobody_ahead_stops_shorter_than_assumed",),
    ),
    Guard(
        "the follower's brake may be weaker",
        "H11",
        SEPARATION,
        "held = held_mps2 - pair.scatter_mps2",
        "held = held_mps2",
        ("test_separation.py::test_what_the_brake_may_miss_is_taken_off",),
    ),
    Guard(
        "every moment until both stand still, not only the last",
        "H11",
        SEPARATION,
        "times = join.concatenate([NODES.astype(late.dtype) * building, late])",
        "times = late",
        ("test_separation.py::test_least_gap_is_never_more_than_the_smallest_on_the_way",),
    ),
    Guard(
        "minimum of the gap between two moments",
        "H11",
        SEPARATION,
        "return gaps.min() - dip",
        "return gaps.min() - 0.0 * dip",
        ("test_separation.py::test_between_two_moments_the_gap_may_dip",),
    ),
    Guard(
        "a follower's brake that does not hold is refused",
        "H11",
        SEPARATION,
        "    if held < SLOWEST_MPS2:\n",
        "    if held < -1e9:\n",
        ("test_separation.py::test_a_brake_that_does_not_hold_is_refused",),
    ),
)


def remove_guard(source: str, guard: Guard) -> str:
    """A module's source without the guard.

    Raises:
        ValueError: The source that holds it does not occur exactly once.
    """
    if source.count(guard.old) != 1:
        raise ValueError(f"{guard.name}: {source.count(guard.old)} times in {guard.file}, wanted once")
    return source.replace(guard.old, guard.new)
