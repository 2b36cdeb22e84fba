"""Campaigns that drive compiled batches: the numbers of the host loop, and always the same bits."""

from dataclasses import replace

import pytest
from tests.sections import fall_of

from metropilot._io import encode_parquet
from metropilot.campaign import Campaign, DisturbanceCase, compute_shard
from metropilot.campaign.batch_tables import EnergyCurve
from metropilot.campaign.compiled import drive_batch
from metropilot.campaign.declared import BATCH
from metropilot.campaign.rows import RESULTS, drive_row
from metropilot.evaluate import attainable_of, driving_limits
from metropilot.planning import optimal_plan
from metropilot.railway import load_line, load_trainset, write_trainset
from metropilot.sim import Run

MATRIX = Campaign(
    "both ways",
    ("ppo",),
    (("yizhuang", "RJ", "WYJ"), ("yizhuang", "XC", "XHM")),
    (("dkz32", "AW0"), ("dkz32", "AW3")),
    (1.1, 1.3),
    (
        DisturbanceCase("nominal"),
        DisturbanceCase("ideal, told late", ideal=True, arrival=(1.1, 0.2)),
        DisturbanceCase(
            "everything", ranges={"speed_noise_mps": (0.0, 0.05)}, restriction=(0.45, 0.55, 40.0, 0.3)
        ),
    ),
    engine="compiled",
)
TIGHT = {
    "running_time_s": 1e-3,
    "stopping_error_m": 1e-3,
    "max_overspeed_mps": 1e-3,
    "minimum_running_time_s": 1e-6,
    "max_jerk_mps3": 0.02,
    "comfort_huang2025": 0.02,
}


@pytest.fixture(scope="module")
def driven():
    cases = [MATRIX.case(row) for row in range(MATRIX.rows)]
    return cases, [result for result, _ in drive_batch(MATRIX, cases)]


def test_a_compiled_row_is_the_row_of_the_host(driven):
    """Disturbances that leave the plant as told; both engines take the same draws and the same noise."""
    cases, results = driven
    for case, found in list(zip(cases, results, strict=True))[:: MATRIX.rows // 5]:
        host, _ = drive_row(MATRIX, case)
        for name in (
            "outcome",
            "success",
            "seed",
            "mass_factor",
            "interventions",
            "regime_switches",
            "error",
        ):
            assert found.get(name) == host.get(name), (case, name)
        for name, room in TIGHT.items():
            assert found[name] == pytest.approx(host[name], abs=room), (case, name)
        for name in ("energy_wheel_kwh", "energy_line_kwh"):
            assert found[name] == pytest.approx(host[name], rel=1e-5), (case, name)
        for name in ("optimal_energy_kwh", "attainable_energy_kwh"):
            assert found[name] == pytest.approx(host[name], rel=5e-4), (case, name)
        # between two solved times the looser of their bounds counts
        assert 0.995 < found["attainable_bound_kwh"] / host["attainable_bound_kwh"] < 1.0005, case
        assert (found["engine"], host["engine"]) == ("compiled", "host")


def test_the_disturbances_reach_the_compiled_runs(driven):
    cases, results = driven
    times = {(c.origin, c.load, c.time, c.disturbance.name): r for c, r in zip(cases, results, strict=True)}
    told = times["RJ", "AW0", 1.3, "ideal, told late"]
    assert told["scheduled_time_s"] == pytest.approx(
        1.1 * times["RJ", "AW0", 1.3, "nominal"]["scheduled_time_s"], abs=0.02
    )
    slow = times["RJ", "AW0", 1.1, "everything"]
    assert slow["minimum_running_time_s"] > times["RJ", "AW0", 1.1, "nominal"]["minimum_running_time_s"] + 3.0
    assert slow["speed_noise_mps"] > 0.0


def test_a_slow_restriction_told_on_the_way_has_its_time_in_both_engines():
    told = DisturbanceCase("walking pace", restriction=(0.3, 0.8, 5.0, 0.05))
    short = {"sections": MATRIX.sections[:1], "trainsets": MATRIX.trainsets[:1], "times": (1.1,)}
    few = replace(MATRIX, **short, disturbances=(told,))
    case = few.case(0)
    host, _ = drive_row(few, case)
    ((found, _),) = drive_batch(few, [case])
    assert (found["engine"], host["engine"]) == ("compiled", "host")
    assert found["running_time_s"] == pytest.approx(host["running_time_s"], abs=1e-3)
    assert (found["outcome"], host["outcome"]) == ("arrived", "arrived")


def test_a_compiled_shard_gives_the_same_bytes_again(driven):
    _, results = driven
    (piece,) = MATRIX.pieces()
    assert len(MATRIX.shard(piece)) == MATRIX.rows < BATCH
    assert compute_shard(MATRIX.text, piece).results == encode_parquet(RESULTS, results)


PLANTS = {
    "mass_factor": (0.8, 1.2),
    "resistance_factor": (0.5, 1.5),
    "delay_s": (0.0, 0.6),
    "lag_s": (0.4, 0.4),
    "headwind_mps": (-8.0, 8.0),
    "adhesion": (0.06, 0.12),
}


def test_only_learned_policies_are_compiled_and_only_where_asked():
    both = replace(MATRIX, drivers=("ppo_scaled", "optimal"))
    told = both.disturbances[0]
    assert [both.is_compiled(name, told, both.trainsets[0]) for name in both.drivers] == [True, False]
    assert not replace(both, engine="host").is_compiled("ppo_scaled", told, both.trainsets[0])
    assert both.shard_rows("ppo_scaled") == BATCH > both.shard_rows("optimal")


def test_a_trainset_that_declares_a_dead_time_is_driven_by_the_host(tmp_path):
    known = load_trainset("dkz32")
    write_trainset(
        replace(known, id="late", actuation=replace(known.actuation, delay_s=0.3)), tmp_path / "late.toml"
    )
    late = (str(tmp_path / "late.toml"), "AW0")
    assert not MATRIX.is_compiled("ppo", DisturbanceCase("nominal"), late)
    assert MATRIX.is_compiled("ppo", DisturbanceCase("ideal", ideal=True), late)


@pytest.mark.parametrize("ideal", [False, True])
def test_a_trainset_with_a_weak_guarantee_is_driven_by_the_host(ideal):
    """There the driver brakes within what protection admits, which no batch does."""
    weak = ("ch_stadler_flirt_tpf", "base")
    alone = replace(MATRIX, trainsets=(weak,), disturbances=(DisturbanceCase("told", ideal=ideal),))
    assert not alone.is_compiled("ppo", alone.disturbances[0], weak)
    assert alone.shard_rows("ppo") == replace(alone, engine="host").shard_rows("ppo")
    assert MATRIX.is_compiled("ppo", DisturbanceCase("told", ideal=ideal), MATRIX.trainsets[0])


@pytest.mark.parametrize("name", [*PLANTS, "speed_noise_mps"])
def test_a_plant_that_is_not_as_told_is_driven_by_the_host(name):
    """There the driver acts on what it observes, which no batch does."""
    told = DisturbanceCase(
        name, ranges=PLANTS | {name: (0.0, 0.1)} if name not in PLANTS else {name: PLANTS[name]}
    )
    assert not MATRIX.is_compiled("ppo", told, MATRIX.trainsets[0])
    alone = replace(MATRIX, disturbances=(told,))
    assert alone.shard_rows("ppo") == replace(alone, engine="host").shard_rows("ppo")
    both = replace(MATRIX, disturbances=(*MATRIX.disturbances, told))
    assert both.shard_rows("ppo") == BATCH


def test_a_shard_of_both_engines_has_the_rows_of_each_in_their_order():
    late = DisturbanceCase("late", ranges={"delay_s": (0.4, 0.4)})
    few = replace(
        MATRIX,
        sections=MATRIX.sections[1:],
        trainsets=MATRIX.trainsets[:1],
        times=(1.2,),
        seeds=2,
        disturbances=(late, DisturbanceCase("noise", ranges={"speed_noise_mps": (0.05, 0.05)})),
    )
    (piece,) = few.pieces()
    cases = [few.case(row) for row in few.shard(piece)]
    found = [drive_row(few, case)[0] for case in cases[:2]]
    found += [result for result, _ in drive_batch(few, cases[2:])]
    assert [row["engine"] for row in found] == ["host", "host", "compiled", "compiled"]
    assert compute_shard(few.text, piece).results == encode_parquet(RESULTS, found)


@pytest.mark.parametrize("objective", ["wheel", "line"])
def test_the_optimum_read_between_two_solved_ones_is_the_solved_one(objective):
    section, trainset = load_line("yizhuang").section("RJ", "WYJ"), load_trainset("dkz32", "AW2")
    limits = driving_limits(Run(section, trainset, 110.0), section)
    curve = EnergyCurve(section, trainset, objective, limits)
    for ratio in (1.005, 1.03, 1.111, 1.35):
        time_s = ratio * curve.fastest_s
        solved = optimal_plan(section, trainset, time_s, curve.options)
        found = curve.at(time_s)
        assert found.plan.energy_j == pytest.approx(solved.energy_j, rel=2e-4)
        best = attainable_of(section, trainset, time_s, limits, solved, objective)
        if best is None:
            assert found.attainable is None
            continue
        assert found.attainable.energy_j == pytest.approx(best.energy_j, rel=1e-3)
        assert found.attainable.bound_j == pytest.approx(best.bound_j, rel=5e-3)
    assert sorted(curve.knots) == [1, 2, 5, 6, 17, 18]


def test_the_optimum_between_two_that_need_nothing_is_none():
    """On a section that falls all the way both energies are zero, and were divided by."""
    section, trainset = fall_of(600.0), load_trainset("dkz32")
    curve = EnergyCurve(section, trainset, "wheel", driving_limits(Run(section, trainset, 100.0), section))
    found = curve.at(1.71 * curve.fastest_s)
    for each in (found.plan, found.attainable):
        assert abs(each.energy_j) < 1e3
        assert each.bound_j <= each.energy_j
