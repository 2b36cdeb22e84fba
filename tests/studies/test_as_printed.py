"""The paper's own settings: refused where a study has none, declared, run, and shown beside ours."""

import json
import math

import numpy as np
import pytest

from metropilot._registry import RegistryRow
from metropilot.cli import main
from metropilot.learn import RunRecord, config_to_mapping
from metropilot.studies import (
    STUDIES,
    AsPrinted,
    LiteralRun,
    Order,
    PrintedSetting,
    ReportRow,
    SeedResult,
    Study,
    StudyReport,
    learning,
    reproduce,
    study_page,
)

PLACE = ("Table 1", "100 s", "ppo", "energy", "kWh")
SETTINGS = (
    PrintedSetting("price of time", "1000", "100"),
    PrintedSetting("unit of energy", "not printed", "kWh", "kWh, as in the tables."),
)


def our_report(order):
    return StudyReport(1, [ReportRow(*PLACE, published=10.0, ours=12.0)], deviations=["A deviation."])


def literal_run(order):
    missed = ReportRow("Table 1", "100 s", "ppo", "speed at the end", "m/s")
    return LiteralRun([ReportRow(*PLACE).with_values([14.0, 15.0, 19.0]), missed], ["3 of 500 episodes."])


@pytest.fixture
def two_studies(monkeypatch):
    able = Study("able2020", "A title", "A, 2020.", our_report, as_printed=AsPrinted(SETTINGS, literal_run))
    unable = Study("unable2020", "A title", "B, 2020.", our_report)
    rows = {study.id: RegistryRow(study, study.title) for study in (able, unable)}
    monkeypatch.setattr(STUDIES, "_rows", rows)
    return able


def test_a_study_without_printed_settings_is_refused_before_anything_runs(two_studies, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["reproduce", "unable2020", "--as-printed", "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "as-printed" in error
    assert "able2020" in error
    assert not (tmp_path / "out" / "report.json").exists()


def test_published_ours_and_as_printed_stand_in_one_row(two_studies, tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "able2020", "--as-printed", "--out", str(tmp_path), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == [found["rows"][0]], "the study's own rows stay as they are"
    first, missed = found["as_printed"]["rows"]
    assert (first["published"], first["ours"], first["as_printed"]) == (10.0, 12.0, 15.0)
    assert (first["low"], first["high"], first["values"]) == (14.0, 19.0, [14.0, 15.0, 19.0])
    assert (missed["published"], missed["ours"], missed["as_printed"]) == (None, None, None)
    assert found["as_printed"]["remarks"] == ["3 of 500 episodes."]
    assert found["deviations"] == ["A deviation.", "As printed, unit of energy: kWh, as in the tables."]
    page = (tmp_path / "able2020.md").read_text()
    assert "able2020 --budget quick --as-printed`" in page
    assert "| price of time | 1000 | 100 |" in page
    assert "| 100 s | `ppo` | energy | kWh | 10.00 | 12.00 | 15.00 | 14.00 … 19.00 |" in page
    assert "- 3 of 500 episodes." in page
    rows = (tmp_path / "able2020" / "rows.csv").read_text().splitlines()
    assert rows[-2].startswith("As printed,100 s,ppo,energy,kWh,10.0,15.0,14.0,19.0,")
    assert rows[-2].endswith(",14.0,15.0,19.0")


def test_the_tables_are_shown_on_the_command_line(two_studies, tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "able2020", "--as-printed", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    for word in ("Settings as printed", "as printed", "15.00", "price of time", "3 of 500 episodes."):
        assert word in shown


def test_nothing_changes_where_it_is_not_asked_for(two_studies, tmp_path):
    report = reproduce("able2020", Order(tmp_path))
    assert report.as_printed is None
    assert report.as_dict()["as_printed"] is None
    assert "As printed" not in study_page(two_studies, report)
    assert list(report.deviations) == ["A deviation."]


@pytest.fixture
def history(monkeypatch):
    """Learning runs that are there, with one history for all of them."""
    history = {}

    def there(jobs, folder, processes, say):
        assert len({job.run_id for job in jobs}) == len(jobs)
        assert all(job.name.startswith("as-printed-") for job in jobs)
        return [SeedResult(job, None, 0.0, history, record_of(job)) for job in jobs]

    monkeypatch.setattr(learning, "learn_seeds", there)
    return history


def record_of(job):
    """Record that the learning run of a job would have."""
    told = (job.seed, "done", "2026-01-02T03:04:05+00:00", 61.0, job.config.steps, 1.0, "f" * 40)
    return RunRecord(
        job.run_id,
        job.config.algorithm,
        job.name,
        *told,
        config_to_mapping(job.config),
        {},
        {},
        machine="one",
    )


@pytest.mark.parametrize("study_id", [name for name in STUDIES if STUDIES.get(name).as_printed])
def test_every_setting_says_what_is_printed_and_what_is_ours(study_id):
    settings = STUDIES.get(study_id).as_printed.settings
    assert len({one.name for one in settings}) == len(settings) > 3
    for one in settings:
        assert one.printed
        assert one.ours
        assert one.settled or one.printed != "not printed", f"{one.name}: what is taken instead?"


class TestCheng2023:
    """Literal rewards of eqs. 17 to 22, the literal state of eq. 7, the end at the planned time."""

    def test_a_step_earns_what_the_equations_say(self):
        import jax.numpy as jnp

        from metropilot.studies.cheng2023.as_printed import literal_rewards
        from metropilot.studies.cheng2023.env import TrackingFacts, reward_terms

        # 1 m/s and 3 m off: 1/2 + 1/4; jerk 1: 1/2; 2 kJ; 0.2 m from the stop: 1/1.2; all times 0.2
        facts = TrackingFacts(1.0, -3.0, -0.2, 1.0, 2e3, jnp.bool_(True), jnp.bool_(True))
        terms = {name: float(value) for name, value in reward_terms(literal_rewards(1e3), facts).items()}
        assert terms == pytest.approx(
            {
                "safety": 0.2 * -100.0,
                "tracking": 0.2 * 0.75,
                "parking": 0.2 / 1.2,
                "comfort": 0.2 * 0.5,
                "efficiency": 0.2 * -2.0,
            }
        )

    def test_the_state_is_in_metres_and_seconds(self):
        from metropilot.drivers import TrackingView
        from metropilot.studies.cheng2023.as_printed import STATE
        from metropilot.studies.cheng2023.tracking import tracking_observation

        seen = TrackingView(-9.0, 400.0, 21.0, 12.0, 0.5)
        assert tracking_observation(seen, STATE).tolist() == [21.0, 0.5, -9.0, 400.0]

    def test_the_episode_ends_at_the_planned_time_even_in_motion(self):
        import jax

        from metropilot.studies.cheng2023.as_printed import literal_task
        from metropilot.studies.cheng2023.setting import course

        task = literal_task(1e3)
        start, seen = task.reset(jax.random.key(3))
        assert np.array(seen).tolist() == [0.0, 0.0, 0.0, 0.0], "always from standstill"
        late = start._replace(loop=start.loop._replace(period=task.courses.end[0] - 1))
        moving = late._replace(
            loop=late.loop._replace(plant=late.loop.plant._replace(speed_mps=np.float32(9)))
        )
        action = np.zeros(3, np.float32)
        _, last = jax.jit(task.step)(jax.random.key(0), moving, action)
        assert bool(last.terminated)
        # 1280 m short of the stop: minus the distance, times 0.2
        assert float(last.terms["parking"]) == pytest.approx(-0.2 * 1278.0, abs=1.0)
        _, before = jax.jit(task.step)(jax.random.key(0), start, action)
        assert not bool(before.terminated)
        assert int(course().end) * 0.2 > 80.0

    def test_nothing_of_ours_is_left_in_the_learner(self):
        from metropilot.studies.cheng2023.as_printed import STATE, literal_config

        config = literal_config("quick")
        assert (config.activation, config.saturation_cost, config.keep) == ("relu", 0.0, "last")
        assert math.isinf(STATE.most)


class TestChen2023a:
    """No assist, no price of runs that never arrive; a run ends at the destination, moving or not."""

    def test_a_full_command_runs_through_the_station_and_earns_the_bonus(self):
        import jax
        import jax.numpy as jnp

        from metropilot.env import episode_of, starts
        from metropilot.sim import CODES, Outcome
        from metropilot.studies.chen2023a.as_printed import literal_task
        from metropilot.studies.learning import drive_to_end

        task = literal_task()
        begin = task.begin(jax.tree.map(lambda x: x[0], starts([0], [80.0])))

        def run(command):
            return drive_to_end(task, lambda _, __: command[None], begin, jax.random.key(0), 132)

        states, returns = jax.jit(jax.vmap(run))(jnp.array([0.6, 0.0]))
        moving, standing = (jax.tree.map(lambda x, k=k: x[k], states) for k in range(2))
        assert CODES[int(moving.outcome)] == Outcome.OVERSHOT
        assert float(moving.plant.speed_mps) > 1.0, "nothing makes it stop"
        run = episode_of(task, moving)
        assert 72.0 <= float(run.running_time_s) <= 88.0
        energy = float(run.wheel_j) / 3.6e6
        assert float(returns[0]) == pytest.approx(100.0 - energy - 0.1 * float(run.jerk_mps2), abs=0.05)
        # standing still costs what being late costs, and no more
        assert float(returns[1]) == pytest.approx(-100.0)
        assert CODES[int(standing.outcome)] != Outcome.ARRIVED

    def test_the_rows_are_those_of_the_figures(self, history, tmp_path):
        chunks = 20
        flat = {"episodes": 100.0, "loss": 1.0, "length": 84.0, "return": 89.0, "term.energy": -10.0}
        flat |= {"term.comfort": -0.5, "evaluation.running_time_s": 84.0, "evaluation.energy_kwh": 10.0}
        flat |= {"evaluation.impact_mps3": 0.06, "evaluation.stopping_error_m": 0.5, "evaluation.score": 89.0}
        flat |= {"evaluation.arrived": 1.0, "evaluation.end_mps": 3.3}
        history.update({name: np.full(chunks, value) for name, value in flat.items()})
        run = STUDIES.get("chen2023a").as_printed.measure(Order(tmp_path, "paper", seeds=7))
        found = {(row.case, row.driver, row.kpi): row for row in run.rows}
        place = ("episodes with exploration", "ppo")
        assert found[*place, "share of seeds converged"].ours == 1.0
        assert found[*place, "share of seeds converged"].published == 0.0
        assert found[*place, "final energy"].ours == 10.0
        assert found["the policy itself", "ddpg", "speed at the end"].ours == 3.3
        assert "PPO at 3.3 m/s after 84 s" in run.remarks[1]


class TestLu2023:
    """Position, speed and time; a decision every 0.2 s; no assist; eqs. 15 to 20 as printed."""

    def test_a_step_earns_what_the_equations_say(self):
        from metropilot.env import PeriodChange
        from metropilot.studies.lu2023.as_printed import literal_task

        zero = dict.fromkeys(PeriodChange._fields, np.float64(0.0))
        zero |= {"ended": np.bool_(False), "arrived": np.bool_(False)}
        rewards = literal_task(filtered=False).config.rewards

        def paid(**given):
            change = PeriodChange(**(zero | {name: np.asarray(value) for name, value in given.items()}))
            return {term.name: float(term.value(change)) for term in rewards}

        # Eq. 16 in joules: 1e-5 of traction and braking; eq. 18: P + a, also for a brake; eq. 20: 0.01
        found = paid(wheel_j=2e5, braked_j=1e5, acceleration_mps2=-0.5, before_mps2=-0.5, speed_mps=9.0)
        assert found["effort_energy"] == pytest.approx(-3.0)
        assert found["acceleration_comfort"] == pytest.approx(1.0 - 0.5)
        assert found["moving"] == pytest.approx(0.01)
        assert paid(acceleration_mps2=0.7, before_mps2=0.6)["acceleration_comfort"] == pytest.approx(1.7)
        assert paid(acceleration_mps2=0.9, before_mps2=0.8)["acceleration_comfort"] == pytest.approx(-1.0)
        assert paid(acceleration_mps2=0.3, before_mps2=-0.2)["acceleration_comfort"] == pytest.approx(-10.0)
        end = {"ended": True, "arrived": True, "late_s": 2.9, "error_m": 0.2}
        assert paid(**end)["on_time"] == paid(**end)["stop_window"] == 1000.0
        assert paid(**end | {"late_s": 3.1})["on_time"] == -1000.0

    def test_the_network_sees_and_decides_as_printed(self):
        from metropilot.studies.lu2023.as_printed import literal_config, literal_task

        task = literal_task(filtered=True)
        assert task.observation_size == 3
        assert task.config.dt * task.config.periods == pytest.approx(0.2)
        assert not task.config.assists.stop
        assert not task.config.assists.ceiling
        config = literal_config("paper", improved=True)
        assert (config.learning_rate, config.gamma, config.hidden) == (1e-5, 0.98, (128, 256))
        assert (config.reward_factor, config.huber, config.normalise_observations) == (1.0, None, False)
        assert config.double
        assert config.dueling
        assert config.prioritised
        assert not literal_config("paper", improved=False).double

    def test_the_policy_kept_is_measured(self, history, tmp_path):
        columns = {
            "score": [-900.0, 5.0, -3.0],
            "120.arrived": [0.0, 1.0, 0.0],
            "120.stop_m": [9.0, -0.2, 3.0],
        }
        columns |= {"120.late_s": [30.0, -1.5, 9.0], "120.kwh": [9.0, 18.0, 8.0], "120.over_mps": [0.0] * 3}
        history.update({f"evaluation.{name}": np.array(values) for name, values in columns.items()})
        run = STUDIES.get("lu2023").as_printed.measure(Order(tmp_path, "paper", seeds=7))
        found = {(row.driver, row.kpi): row.ours for row in run.rows}
        for driver in ("improved_dqn", "dqn"):
            assert found[driver, "stopping error"] == 0.2
            assert found[driver, "time error"] == 1.5
            assert found[driver, "wheel traction energy"] == 18.0
        assert "1,500 episodes" in run.remarks[0]


class TestHuang2025:
    """The limits of EITOE, and the expert at another driver's arrival."""

    def test_eitoe_needs_less_energy_the_more_it_may_accelerate(self):
        from metropilot.studies.huang2025.as_printed import _rows, driver_at
        from metropilot.studies.huang2025.drives import drive_at_arrival
        from metropilot.studies.huang2025.setting import BY_ID, EITOE, IE, TOOK

        case, used = BY_ID["101"], []
        for limit in (0.6, 1.0):
            found = drive_at_arrival(case, 101.0, limit, driver_at(EITOE, limit))
            rows = {row.kpi: row for row in _rows(found)}
            assert rows[TOOK].ours == pytest.approx(101.0, abs=0.2)
            used.append(rows[IE].ours)
            assert rows[IE].published == 380.0
        # The peak that 101 s need falls from 19.5 to 18.4 m/s, and Ie is its square: about 11 % less.
        assert 0.86 < used[1] / used[0] < 0.92

    def test_eitop_learns_case_1_alone(self):
        from metropilot.studies.huang2025.as_printed import jobs, literal_task

        config = literal_task(0.6).config
        assert len(config.sections) == 1
        assert config.scenarios.time_s == (101.0, 101.0)
        assert config.scenarios.on_the_way == 0.0
        assert config.action.start_mps2 == 0.6
        names = [job.run_id for job in jobs([0, 1], "quick")]
        assert len(set(names)) == 4
        assert all(name.startswith("as-printed-") for name in names)


class TestChen2023b:
    """Eq. 18 with the gap itself, eta 1000, one head, no disturbance, no protection."""

    def test_the_reward_of_a_step_is_that_of_the_gap_itself(self):
        import jax

        from metropilot.studies.chen2023b.as_printed import literal_task

        task = literal_task()
        config = task.config
        assert task.count == 1
        assert (config.on_the_way, config.disturbed, config.eta_speed, config.eta_gap) == (0.0, 0.0, 1e3, 1e3)
        with jax.numpy_dtype_promotion("standard"):
            state, _ = task.begin(np.int32(0))
            _, found = jax.jit(task.step)(jax.random.key(0), state, np.zeros(3, np.float32))
        # at the desired gap: 1 / (1 + 1000 x 5.92) = 0.00017, where this study has 1
        assert float(found.terms["gap"]) == pytest.approx(1.0 / 5921.0, rel=0.05)
