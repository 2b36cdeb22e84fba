"""Gymnasium's own checker, seeds, options, and the vector environment."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from metropilot.env import DisturbanceDistribution, DrivingConfig, DrivingTask  # noqa: E402
from metropilot.env.adapters import DriveEnv, DriveVectorEnv  # noqa: E402
from metropilot.errors import InputError  # noqa: E402
from metropilot.railway import load_line, load_trainset  # noqa: E402

PREFIX = "metropilot/"


@pytest.mark.parametrize("name", ["Drive", "DriveNotches"])
def test_gymnasium_accepts_it(name):
    env = gymnasium.make(f"{PREFIX}{name}-v0")
    check_env(env.unwrapped, skip_render_check=True)


def test_seed_and_initial_state():
    env = gymnasium.make(f"{PREFIX}Drive-v0").unwrapped
    one, _ = env.reset(seed=3)
    two, _ = env.reset(seed=3)
    other, _ = env.reset(seed=4)
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
    place = {"position_m": 300.0, "speed_mps": 12.0, "time_s": 40.0, "scheduled_s": 100.0}
    _, info = env.reset(seed=0, options={"initial_state": place})
    assert info["position_m"] == 300.0
    assert info["speed_mps"] == 12.0
    assert info["time_s"] == 40.0
    with pytest.raises(InputError, match="colour"):
        env.reset(options={"initial_state": {"colour": 1}})


def test_a_case_comes_with_its_own_timetable_and_restrictions():
    scenarios = DisturbanceDistribution(time_ratio=(1.1, 1.2), restriction=1.0)
    sections = tuple(load_line("yizhuang").section(*ends) for ends in (("RJ", "WYJ"), ("XHM", "JG")))
    task = DrivingTask(DrivingConfig(sections, (load_trainset("dkz32"),), scenarios=scenarios))
    env, restrictions = DriveEnv(task), task.rows.count // 2 - 1
    for seed in range(4):
        for case in (0, 1):
            env.reset(seed=seed, options={"initial_state": {"case": case}})
            start = env._state.start
            assert int(start.case) == case
            assert task.times_s[0, case] <= float(start.scheduled_s) <= task.times_s[1, case]
            assert (int(start.restricted) - 2) // restrictions == case
    with pytest.raises(InputError, match=r"case: .*0 to 1"):
        env.reset(options={"initial_state": {"case": 2}})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("case", 99),
        ("position_m", 1e4),
        ("speed_mps", "fast"),
        ("mass_factor", 0.0),
        ("time_s", float("nan")),
        ("case", 0.7),
        ("position_m", True),
        ("position_m", np.array([3.0])),
    ],
)
def test_an_initial_state_out_of_range_is_named(name, value):
    env = gymnasium.make(f"{PREFIX}Drive-v0").unwrapped
    with pytest.raises(InputError, match=name):
        env.reset(options={"initial_state": {name: value}})


@pytest.mark.parametrize("options", [[1], {"initial_state": "x"}, {"initial_state": [1, 2]}, {1: 2}])
def test_options_that_are_no_table_are_refused(options):
    env = gymnasium.make(f"{PREFIX}Drive-v0").unwrapped
    with pytest.raises(InputError, match=r"options|initial_state"):
        DriveEnv.reset.__wrapped__(env, options=options)  # the tests' own check of types left out


@pytest.mark.parametrize("number", [np.float32(3.0), np.array(3.0), 3])
def test_numbers_of_numpy_place_a_start(number):
    env = gymnasium.make(f"{PREFIX}Drive-v0").unwrapped
    assert env.reset(options={"initial_state": {"position_m": number}})[1]["position_m"] == 3.0


def test_actions_that_are_none_of_the_space_are_refused():
    drive, notches = (gymnasium.make(f"{PREFIX}{name}-v0").unwrapped for name in ("Drive", "DriveNotches"))
    for env, action, words in (
        (drive, np.zeros(2, np.float32), r"shape \(1,\)"),
        (drive, 0.5, r"shape \(1,\)"),
        (drive, np.array([np.nan], np.float32), "finite"),
        (notches, 99, "0 to 8"),
        (notches, -1, "0 to 8"),
        (notches, 1.5, "whole numbers"),
    ):
        env.reset(seed=0)
        with pytest.raises(InputError, match=f"action: .*{words}"):
            env.step(action)
    drive.reset(seed=0)
    assert np.isfinite(drive.step(np.array([5.0], np.float32))[1]), "clipped"


def test_an_episode_ends_with_its_outcome():
    env = gymnasium.make(f"{PREFIX}Drive-v0").unwrapped
    env.reset(seed=0)
    over, total, wheel = False, 0.0, 0.0
    while not over:
        _, reward, terminated, truncated, info = env.step(np.ones(1, np.float32))
        assert reward == pytest.approx(sum(info["terms"].values()), abs=1e-5)
        total, wheel, over = total + reward, wheel + info["terms"]["energy"], terminated or truncated
    assert terminated
    assert info["outcome"] == "arrived"
    assert wheel == pytest.approx(-info["energy_wheel_j"] / 3.6e6, rel=1e-4)


def test_vector_environment():
    envs = DriveVectorEnv("drive", num_envs=3)
    first, _ = envs.reset(seed=1)
    again, _ = envs.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    assert first.shape == envs.observation_space.shape
    some, _ = envs.reset(seed=[3, 1, None])
    np.testing.assert_array_equal(some[1], first[0])
    with pytest.raises(InputError, match="seed"):
        envs.reset(seed=[1])
    ends = 0
    for _ in range(300):
        seen, reward, terminated, truncated, info = envs.step(np.ones((3, 1), np.float32))
        assert seen.shape == first.shape
        assert reward.shape == terminated.shape == truncated.shape == (3,)
        if terminated.any():
            ends += int(terminated.sum())
            assert (info["kpis"]["outcome"][info["_kpis"]] == 0).all()
    assert ends >= 3, "environments go on with new episodes"


def test_a_vector_environment_names_what_it_cannot_take():
    with pytest.raises(InputError, match=r"num_envs: .*>= 1"):
        DriveVectorEnv("drive", 0)
    envs = DriveVectorEnv("drive", num_envs=2)
    for seed in (-1, 2**32 - 1, [1, -4], [1, 2**32], 1.5, [1, "x"]):
        with pytest.raises(InputError, match="seed"):
            DriveVectorEnv.reset.__wrapped__(envs, seed=seed)  # the tests' own check of types left out
    first, _ = envs.reset(seed=2**32 - 2)
    again, _ = envs.reset(seed=(2**32 - 2, 2**32 - 1))
    np.testing.assert_array_equal(first, again)
    with pytest.raises(InputError, match=r"shape \(2, 1\)"):
        envs.step(np.ones((3, 1), np.float32))


def test_gymnasiums_wrapper_of_statistics_takes_the_vector_environment():
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    envs = RecordEpisodeStatistics(gymnasium.make_vec(f"{PREFIX}Drive-v0", num_envs=3))
    envs.reset(seed=0)
    found = []
    for _ in range(300):
        *_, info = envs.step(np.ones((3, 1), np.float32))
        if "episode" in info:
            ended = info["_episode"]
            np.testing.assert_array_equal(ended, info["_kpis"])
            found += zip(info["episode"]["l"][ended], info["kpis"]["decisions"][ended], strict=True)
    assert len(found) >= 3
    assert all(length == decisions for length, decisions in found)


def test_gymnasium_makes_the_vector_environment():
    envs = gymnasium.make_vec(f"{PREFIX}Drive-v0", num_envs=2, vectorization_mode="vector_entry_point")
    assert envs.reset(seed=0)[0].shape[0] == 2
