"""Learning on another line or trainset than a task's own: the task, and a run that keeps its files."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.env import TASKS, TaskSite, make_task, task_config
from metropilot.errors import InputError
from metropilot.learn import RunStore, begin_run, new_request, resume_request
from metropilot.railway import document_text, load_line, load_trainset


def test_a_task_on_another_line_has_its_sections_every_load_and_times_of_its_own():
    site = TaskSite(line="yizhuang", sections="CQN-JHL,JHL-CQN", trainset="dkz32@0.5,0.3")
    config, own = task_config("drive_both", site), task_config("drive_both")
    assert [section.name for section in config.sections] == ["CQN-JHL", "JHL-CQN"]
    assert [trainset.load for trainset in config.trainsets] == ["AW0", "AW2", "AW3"] * 2
    assert [trainset.actuation.delay_s for trainset in config.trainsets] == [0.0] * 3 + [0.5] * 3
    assert (own.scenarios.longest_s, config.scenarios.longest_s) == (136.0, None)
    assert config.scenarios.time_ratio == own.scenarios.time_ratio
    assert (own.observer, config.observer) == ("section_jerk", "line")
    assert config.action == own.action
    assert config.rewards == own.rewards


def test_a_task_keeps_what_a_site_does_not_name():
    everywhere = task_config("drive_line", TaskSite(trainset="cheng2023"))
    assert len(everywhere.sections) == 26
    assert {trainset.id for trainset in everywhere.trainsets} == {"cheng2023"}
    one = task_config("drive_jerk", TaskSite(load="AW3"))
    assert [section.name for section in one.sections] == ["RJ-WYJ"]
    assert [trainset.load for trainset in one.trainsets] == ["AW3"]
    assert len(task_config("drive", TaskSite(line="yizhuang")).sections) == 26
    assert task_config("drive", TaskSite()) == task_config("drive")


def test_episodes_of_a_long_section_are_not_cut_off():
    task = make_task("drive_jerk", TaskSite(line="yizhuang", sections="SJZ-YZHC", load="AW3"))
    longest_s = task.most_decisions * task.config.dt * task.config.periods
    assert 1.25 * task.times_s.max() + 30.0 <= longest_s < 1.25 * task.times_s.max() + 31.0
    assert longest_s > 2000.0
    assert np.all(task.times_s[0] > task.minimum_s)


@pytest.mark.parametrize(
    ("task", "site", "words"),
    [
        (
            "huang2025",
            {"line": "yizhuang"},
            r"^task: the task has .* \(allowed: drive, drive_jerk, ",
        ),
        ("worlds", {"load": "AW2"}, "^task: the task has sections and trainsets of its own: 'worlds'"),
        ("drive", {"sections": "RJ-WYJ"}, "^sections: sections of no line: 'RJ-WYJ'"),
        ("drive", {"line": "yizhuang", "sections": "RJ"}, "^sections: not a section: 'RJ'"),
        ("drive", {"line": "nowhere"}, "^line: unknown line"),
        ("drive", {"trainset": "dkz33"}, "^trainset: unknown trainset, did you mean 'dkz32'"),
        ("drive", {"load": "AW9"}, "load: unknown load: 'AW9'"),
    ],
)
def test_what_cannot_be_learned_is_named(task, site, words):
    with pytest.raises(InputError, match=words):
        task_config(task, TaskSite(**site))


def test_a_run_keeps_its_own_line_and_trainset(tmp_path):
    line, trainset = tmp_path / "mine.toml", tmp_path / "train.toml"
    line.write_text(document_text("line", "yizhuang"), encoding="utf-8")
    trainset.write_text(document_text("trainset", "dkz32"), encoding="utf-8")
    site = TaskSite(line=str(line), sections="RJ-WYJ", trainset=f"{trainset}@0.4,0.2", load="AW2")
    request = new_request("ddpg", budget="quick", site=site, seed=3, command="metropilot learn ddpg")
    store = RunStore(tmp_path / "runs")
    record = begin_run(store, request)
    expected = {"line": "line.toml", "sections": "RJ-WYJ", "trainset": "trainset.toml@0.4,0.2", "load": "AW2"}
    assert record.about == expected | {"name": "drive"}
    line.unlink()
    trainset.unlink()
    folder = store.folder(record.id)
    again = resume_request(store.show(record.id), folder)
    assert again.task.config == request.task.config
    assert (again.config, again.name, again.seed, again.driver) == (request.config, "drive", 3, "ddpg")
    assert again.site.as_copied().values() == expected
    assert load_line(folder / "line.toml") == load_line("yizhuang")
    assert load_trainset(folder / "trainset.toml") == load_trainset("dkz32")


def test_a_record_names_no_file_outside_of_its_folder(tmp_path):
    site = TaskSite(line="/elsewhere/mine.toml", trainset="../../train.json@0.4,0.2:AW2")
    expected = {"line": f"{tmp_path}/line.toml", "trainset": f"{tmp_path}/trainset.json@0.4,0.2:AW2"}
    assert site.in_folder(tmp_path).values() == expected
    assert {"line.toml", "trainset.json"} <= set(site.copy_names())
    assert TaskSite(line="yizhuang").in_folder(tmp_path) == TaskSite(line="yizhuang")


def test_every_task_is_learned_on_its_own_sections_or_takes_others():
    for name in TASKS:
        own = task_config(name)
        try:
            other = task_config(name, TaskSite(line="yizhuang", sections="RJ-WYJ", trainset="dkz32"))
        except InputError:
            assert not name.startswith("drive")
        else:
            assert replace(other, sections=own.sections, trainsets=own.trainsets).rewards == own.rewards
