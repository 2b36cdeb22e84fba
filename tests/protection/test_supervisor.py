"""Answer of the supervisor to one command after another."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot import physics
from metropilot.physics import Command
from metropilot.protection import (
    LEVELS,
    Bounds,
    admits_braking,
    at_start,
    periods_in_effect,
    permitted_speed,
    protect,
    supervise,
)
from metropilot.railway import (
    Actuation,
    EffortCurve,
    MovementAuthority,
    Restriction,
    SafeBraking,
    Steps,
    load_line,
    load_trainset,
)

LINE = load_line("yizhuang")
SECTION = LINE.section("RJ", "WYJ")
DKZ32 = load_trainset("dkz32")
IDEAL = DKZ32.ideal()
LATE = replace(DKZ32, actuation=replace(DKZ32.actuation, delay_s=1.0, lag_s=0.6))
FALLING = replace(SECTION, gradient_permil=Steps(np.array([-500.0]), np.array([-35.0])))
DT = 0.2


class Ride:
    """A plant under supervision, one period at a time."""

    def __init__(self, trainset=DKZ32, section=SECTION, x=0.0, v=0.0, **options):
        self.protection = protect(section, trainset, Bounds.of(trainset, DT), **options)
        self.vehicle, self.track = physics.vehicle_arrays(trainset), physics.track_arrays(section, trainset)
        self.state = physics.at_rest(self.vehicle, position_m=x, speed_mps=v)
        self.memory = at_start(self.protection)
        self.levels, self.shares, self.speeds = [], [], []

    def go(self, share, steps=1, emergency=False):
        for _ in range(steps):
            seen = self.state.position_m, self.state.speed_mps
            command, self.memory, verdict = supervise(
                self.protection, self.memory, *seen, Command(np.float64(share), emergency)
            )
            self.state = physics.step(self.vehicle, self.track, self.state, command, DT)
            self.levels.append(LEVELS[verdict.level])
            self.shares.append(float(command.share))
            self.speeds.append(float(self.state.speed_mps))
        return self


def test_a_modest_driver_is_left_alone():
    ride = Ride().go(0.6, 40).go(0.0, 50).go(-0.8, 40)
    assert set(ride.levels) == {"none"}
    assert ride.shares == [0.6] * 40 + [0.0] * 50 + [-0.8] * 40
    assert ride.memory.interventions == 0


STEEP = replace(
    SECTION,
    gradient_permil=Steps(np.arange(-500.0, 3000.0, 40.0), np.resize([16.0, -14.0], 88)),
    limit_mps=Steps(np.array([-500.0]), np.array([8.1])),
)
SHORT = replace(load_trainset("cn_beijing_subway"), actuation=Actuation(0.35, 0.56, 0.54))
FAST = replace(
    SECTION,
    gradient_permil=Steps(np.arange(-500.0, 3000.0, 120.0), np.resize([20.0, -40.0], 30)),
    limit_mps=Steps(np.array([-500.0]), np.array([24.0])),
)


@pytest.mark.parametrize(
    ("section", "trainset", "below_mps"), [(SECTION, LATE, 0.6), (STEEP, SHORT, 1.0), (FAST, SHORT, 2.5)]
)
def test_full_braking_over_a_path_is_told_as_period_by_period(section, trainset, below_mps):
    """Near a limit, with traction on its way: the answer for all periods is that for each of them."""
    guard, rng, told = protect(section, trainset, Bounds.of(trainset, DT)), np.random.default_rng(3), []

    def passes(after, path, more_mps):
        for x, v in path.T:
            _, after, verdict = supervise(guard, after, x, v + more_mps, Command(np.float64(-1.0), False))
            if verdict.level > 0:
                return False
        return True

    rises = np.flatnonzero(np.diff(guard.pull_mps2) > 0.05)
    before_fall_m = guard.start_m + guard.spacing_m * rises[(rises > 200) & (rises < 2000)]
    for number in range(300):
        x, share, acting = rng.uniform(200.0, 2000.0), rng.uniform(0.0, 0.6), 0.0
        if before_fall_m.size > 0 and number % 2 == 0:
            # traction acts, and a fall ahead begins to count in the first period
            x, acting = float(rng.choice(before_fall_m)) - rng.uniform(0.0, 6.0), share
        v = float(permitted_speed(guard, np.float64(x))) - rng.uniform(0.0, below_mps)
        before = at_start(guard, share=acting)
        _, after, verdict = supervise(guard, before, x, v, Command(np.float64(share), False))
        if verdict.level > 0:
            continue
        count = periods_in_effect(guard, after) - 1
        speeds = v + rng.uniform(-0.2, 1.0) * DT * np.minimum(np.arange(1, count + 1), after.recent.size)
        path = np.array([x + np.cumsum(speeds) * DT, speeds])
        told.append(admits_braking(guard, after, *path))
        # it allows for an error of the expected speeds of 0.02 m/s
        assert passes(after, path, 0.0 if told[-1] else 0.04) == told[-1]
    assert 0.1 < np.mean(told) < 0.9


def test_full_traction_ends_in_a_cut_off_not_in_an_emergency():
    for trainset in (DKZ32, IDEAL):
        ride = Ride(trainset).go(1.0, 250)
        assert ride.memory.emergencies == 0
        assert ride.memory.interventions > 0
        assert {"none", "traction cut-off"} <= set(ride.levels)
        over = max(ride.speeds) - float(ride.track.limit_mps.max())
        assert -1.2 < over <= 0.0


def test_a_lower_limit_ahead_is_met_with_the_service_brake():
    section = SECTION.with_restriction(Restriction(700.0, 900.0, 8.0))
    ride = Ride(section=section).go(1.0, 260)
    assert ride.memory.emergencies == 0
    assert "service brake" in ride.levels
    assert max(ride.speeds) > 12.0


@pytest.mark.parametrize("below_mps", [0.001, 0.003, 0.006, 0.01])
def test_nobody_creeps_over_the_limit_between_two_nodes(below_mps):
    """Found by the long campaign: coasting downhill at a low limit, the peak lies inside one cell."""
    slope = Steps(np.array([-500.0]), np.array([-8.0]))
    limit = Steps(np.array([-500.0]), np.array([2.5]))
    section = replace(SECTION, limit_mps=limit, gradient_permil=slope, curves=())
    for start in np.linspace(650.0, 651.0, 5):
        ride = Ride(IDEAL, section=section, x=start, v=2.5 - below_mps).go(0.0, 30)
        assert max(ride.speeds) <= 2.5


@pytest.mark.parametrize("share", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_a_full_service_brake(share):
    ride = Ride(IDEAL, v=10.0, x=300.0).go(share, 3)
    assert ride.shares == [-1.0] * 3
    assert ride.memory.invalid == 3


def test_what_is_out_of_range_is_clipped_and_counted():
    ride = Ride(v=5.0, x=300.0).go(7.0).go(-3.0).go(1.0)
    assert ride.shares == [1.0, -1.0, 1.0]
    assert ride.memory.invalid == 2
    assert ride.memory.interventions == 0


LOST = [
    (np.nan, 10.0),
    (300.0, np.nan),
    (300.0, np.inf),
    (-np.inf, 3.0),
    (300.0, -3.0),
    (300.0, -1e300),
    (-400.0, 3.0),
]
"""Position and speed that cannot be: no numbers, a speed backward, a place before the map."""


@pytest.mark.parametrize("seen", LOST)
def test_a_lost_measurement_is_an_emergency(seen):
    ride = Ride(v=10.0, x=300.0)
    command, memory, verdict = supervise(
        ride.protection, ride.memory, *map(np.float64, seen), Command(0.5, False)
    )
    assert command.emergency
    assert LEVELS[verdict.level] == "emergency brake"
    assert memory.emergencies == 1


@pytest.mark.parametrize("seen", [(300.0, -0.04), (0.0, 0.0), (-45.0, 0.0), (300.0, 10.0)])
def test_a_measurement_that_can_be_is_believed(seen):
    ride = Ride()
    command, _, verdict = supervise(ride.protection, ride.memory, *map(np.float64, seen), Command(0.5, False))
    assert not command.emergency
    assert verdict.level == 0


def test_the_emergency_brake_holds_until_standstill_and_then_lets_go():
    ride = Ride(v=15.0, x=300.0).go(0.5, emergency=True)
    steps = 0
    while ride.state.speed_mps > 0.0:
        ride.go(1.0)
        steps += 1
    assert set(ride.levels) == {"emergency brake"}
    # 15 m/s at 1.2 m/s^2 and more, after 0.4 s of reaction and 0.8 s of build-up.
    assert 10.0 < steps * DT < 15.0
    ride.go(0.5, 10)
    assert ride.levels[-1] == "none"
    assert ride.state.speed_mps > 0.0
    # The driver asked for it: not an intervention until it asked for traction against it.
    assert ride.memory.emergencies == 1


def test_the_end_of_the_authority_is_never_passed():
    for trainset in (DKZ32, IDEAL):
        for end in (400.0, 777.7, SECTION.length_m):
            ride = Ride(trainset, stop_at_m=end).go(1.0, 700)
            assert ride.state.position_m <= end
            assert ride.state.position_m > end - 40.0
            assert ride.speeds[-1] < 0.5


@pytest.mark.parametrize("trainset", [DKZ32, IDEAL, LATE], ids=["catalogue", "ideal", "late"])
@pytest.mark.parametrize(("distance_m", "release_kmh"), [(2.0, 15.0), (0.0, 3.0), (20.0, 40.0)])
def test_nobody_runs_far_past_the_end_of_the_authority_behind_a_stop(trainset, distance_m, release_kmh):
    authority = MovementAuthority(distance_m, release_kmh / 3.6)
    for section in (replace(SECTION, authority=authority), replace(FALLING, authority=authority)):
        end = section.length_m + distance_m
        for v in (0.0, 3.0, 12.0):
            ride = Ride(trainset, section, x=0.0 if v == 12.0 else end - 60.0, v=v).go(1.0, 600)
            assert ride.speeds[-1] < 1.0
            pull = float(ride.protection.pull_mps2.max())
            most = release_kmh / 3.6 + 0.4 * pull
            assert ride.state.position_m <= end + 1.3 * most + most**2 / (2.0 * (1.2 - pull)) + 1.0
            assert ride.memory.emergencies >= 1


def test_a_creep_past_the_end_of_the_authority_is_not_silent():
    ride = Ride(x=SECTION.length_m - 3.0, v=1.0)
    while ride.state.position_m <= SECTION.length_m + 2.0:
        ride.go(0.02)
    assert set(ride.levels) == {"none"}
    assert ride.go(0.02, 30).levels[-1] == "emergency brake"
    assert ride.speeds[-1] == 0.0
    assert ride.memory.emergencies == 1
    assert ride.state.position_m < SECTION.length_m + 4.0


def test_a_restriction_announced_too_late_brakes_at_once_and_holds_where_it_can():
    announced = Ride(v=20.0, x=500.0).go(0.0, 5)
    section = SECTION.with_restriction(Restriction(announced.state.position_m + 20.0, 900.0, 8.0))
    announced.protection = protect(section, DKZ32, Bounds.of(DKZ32, DT))
    announced.go(1.0)
    assert announced.levels[-1] == "emergency brake"
    before = announced.state.speed_mps
    announced.go(1.0, 200)
    # From 20 to 8 m/s takes 140 m: over the limit at first, and nowhere after the braking distance.
    assert before > 19.0
    assert announced.memory.emergencies == 1
    assert all(b <= a + 0.25 for a, b in pairwise(announced.speeds[6:30]))


def test_a_restriction_announced_in_time_is_kept():
    ride = Ride(v=20.0, x=300.0).go(0.0, 5)
    section = SECTION.with_restriction(Restriction(ride.state.position_m + 320.0, 900.0, 8.0))
    ride.protection = protect(section, DKZ32, Bounds.of(DKZ32, DT))
    track = physics.track_arrays(section, DKZ32)
    for _ in range(200):
        ride.go(1.0)
        k = np.searchsorted(track.limit_from_m, ride.state.position_m, side="right") - 1
        assert ride.state.speed_mps <= track.limit_mps[k]
    assert ride.memory.emergencies == 0


def test_after_an_intervention_a_command_needs_more_room():
    ride = Ride(IDEAL)

    def fastest_that_passes(level):
        low, high = 10.0, 30.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            memory = ride.memory._replace(level=np.int32(level))
            seen = np.float64(500.0), np.float64(middle)
            _, _, verdict = supervise(ride.protection, memory, *seen, Command(np.float64(1.0), False))
            low, high = (middle, high) if verdict.level == 0 else (low, middle)
        return low

    assert 0.09 < fastest_that_passes(0) - fastest_that_passes(1) < 0.13


def test_jax_decides_as_numpy_does():
    shares = np.random.default_rng(1).uniform(-0.5, 1.0, 300)
    ride = Ride(x=20.0)
    for share in shares:
        ride.go(share)
    fresh = Ride(x=20.0)
    with physics.double_precision():
        start = jax.tree.map(jnp.asarray, (fresh.state, fresh.memory))
        protection, vehicle, track = jax.tree.map(jnp.asarray, (fresh.protection, fresh.vehicle, fresh.track))

        def body(carry, share):
            state, memory = carry
            seen = state.position_m, state.speed_mps
            command, memory, verdict = supervise(
                protection, memory, *seen, Command(share, jnp.asarray(False))
            )
            state = physics.step(vehicle, track, state, command, jnp.asarray(DT))
            return (state, memory), (state.speed_mps, verdict.level)

        (_, memory), (speeds, levels) = jax.jit(lambda c, s: jax.lax.scan(body, c, s))(
            start, jnp.asarray(shares)
        )
        assert [LEVELS[k] for k in np.asarray(levels)] == ride.levels
        np.testing.assert_allclose(np.asarray(speeds), ride.speeds, atol=1e-9)
        assert memory.interventions == ride.memory.interventions


def test_sections_share_one_compiled_program():
    shapes = set()
    for section in (
        LINE.sections()[3],
        LINE.sections()[7],
        SECTION.with_restriction(Restriction(300.0, 400.0, 5.0)),
    ):
        protection = protect(section, DKZ32.with_load("AW3"), Bounds.of(DKZ32, DT), dtype=np.float32)
        shapes.add(tuple(np.shape(leaf) for leaf in jax.tree.leaves(protection)))
        assert {np.asarray(leaf).dtype.kind for leaf in jax.tree.leaves(protection)} == {"f", "i"}
    assert len(shapes) <= 2


def test_the_permitted_speed_is_for_many_positions_at_once():
    protection = protect(SECTION, IDEAL, replace(Bounds.of(IDEAL, DT), position_error_m=1.0))
    at = np.linspace(0.0, 1000.0, 7)
    assert permitted_speed(protection, at).shape == (7,)
    np.testing.assert_allclose(permitted_speed(protection, at), [permitted_speed(protection, x) for x in at])


def test_a_brake_that_fades_while_a_fall_adds_speed():
    """A command that still held back when it passed holds less at the speed gained in the reaction."""
    period_s, limit = 0.5, 9.4
    speeds = np.linspace(0.0, 44.0, 80)
    fading = np.maximum(speeds / 8.0, 1.0) ** -8.0
    known = load_trainset("drawn-77-3")
    slow = replace(
        known,
        electric_brake=EffortCurve.table(speeds, 0.9 * known.effective_mass_kg * fading),
        friction_brake_n=0.0,
        service_deceleration_mps2=0.9,
        length_m=0.0,
        max_speed_mps=40.0,
        actuation=Actuation(4.0),
        safe_braking=SafeBraking(1.2, 0.9, reaction_s=4.0),
    )
    steep = replace(
        SECTION,
        gradient_permil=Steps(np.array([-500.0]), np.array([-40.0])),
        limit_mps=Steps(np.array([-500.0]), np.array([limit])),
        curves=(),
        tunnels=(),
        authority=None,
    )
    sure = replace(Bounds.of(slow, period_s), mass=(1.0, 1.0), resistance=(1.0, 1.0), service_share=1.0)
    guard = protect(steep, slow, sure)
    guard = guard._replace(service=np.full_like(guard.service, 1e6))
    vehicle, track = physics.vehicle_arrays(slow), physics.track_arrays(steep, slow)
    for share in (-0.3, -0.27):
        state = physics.at_rest(vehicle, delay_steps=8, speed_mps=limit - 3.0)
        memory, levels = at_start(guard), set()
        for _ in range(120):
            seen = state.position_m, state.speed_mps
            command, memory, verdict = supervise(guard, memory, *seen, Command(np.float64(share), False))
            levels.add(int(verdict.level))
            state = physics.step(vehicle, track, state, command, period_s)
            assert state.speed_mps <= limit
        assert 3 in levels
