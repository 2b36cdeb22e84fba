"""The paper's own settings: refused where a study has none, declared, run, and shown beside ours."""

import json
import math

import numpy as np
import pytest

from metropilot._registry import RegistryRow
from metropilot.cli import main
from metropilot.studies import (
    STUDIES,
    AsPrinted,
    LiteralRun,
    Order,
    PrintedSetting,
    ReportRow,
    Study,
    StudyReport,
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
