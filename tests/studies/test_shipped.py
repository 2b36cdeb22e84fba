"""A shipped policy was learned with what its recipe says today: the recipe learns it again."""

import jax
import pytest

from metropilot.env import PolicyInterface
from metropilot.learn import RECIPES, TeacherConfig, config_from_mapping, imitation_spec, make_learner
from metropilot.policy import load_policy, shipped_policy
from metropilot.studies import STUDIES
from metropilot.studies.chen2023b import learning as chen2023b
from metropilot.studies.chen2023b import ship as chen2023b_ship
from metropilot.studies.cheng2023 import learning as cheng2023
from metropilot.studies.huang2025 import ship as huang2025_ship
from metropilot.studies.learning import print_shipped
from metropilot.studies.lu2023 import drives as lu2023
from metropilot.studies.lu2023 import ship as lu2023_ship
from metropilot.studies.lu2023.learning import ALL_STEPS, LEARNING, plan_job
from metropilot.studies.lu2023.setting import PLANS

POLICIES = shipped_policy("ppo").parent
BY_STUDY = {"ddpg_pid", "ddpg_pid_follow", "sac_pid"}
"""These learn no driving task; their study declares task and learner."""


def declare(about):
    """The learner's configuration as a policy's file has it."""
    return config_from_mapping(about["algorithm"], about["config"])


def spec_of(config, task):
    """The network that a learner would make for a task."""
    if isinstance(config, TeacherConfig):
        return imitation_spec(config, task.observation_size)
    return make_learner(config, task).spec


def test_every_shipped_policy_has_a_recipe():
    files = {path.stem for path in POLICIES.glob("*.safetensors")}
    assert files == files & ({*RECIPES} | BY_STUDY)
    assert files >= BY_STUDY


@pytest.mark.parametrize("driver", sorted({p.stem for p in POLICIES.glob("*.safetensors")} - BY_STUDY))
def test_a_shipped_policy_was_learned_by_its_recipe(driver):
    policy, about = load_policy(POLICIES / f"{driver}.safetensors")
    recipe = RECIPES.get(driver)
    task = recipe.make_task()
    assert declare(about) == recipe.paper
    assert PolicyInterface.from_dict(about["perception"]) == task.config.interface
    assert policy.spec == spec_of(recipe.paper, task)
    name = about["task"] if isinstance(about["task"], str) else about["task"]["name"]
    assert name == recipe.task


def test_the_policy_of_ddpg_pid_was_learned_as_its_study_says():
    policy, about = load_policy(POLICIES / "ddpg_pid.safetensors")
    assert declare(about) == cheng2023.config()
    assert policy.spec == spec_of(cheng2023.config(), cheng2023.task())
    options = STUDIES.get("cheng2023").check_options({})
    expected = {"name": "cheng2023", "rewards": repr(cheng2023.REWARDS), **options}
    assert about["task"] == expected


@pytest.mark.parametrize("algorithm", list(chen2023b.NAMES))
def test_the_policies_of_followers_were_learned_as_their_study_says(algorithm):
    policy, about = load_policy(POLICIES / f"{chen2023b.NAMES[algorithm]}.safetensors")
    assert declare(about) == chen2023b.config(algorithm, "paper")
    task = chen2023b.task(about["task"]["eta"])
    with jax.numpy_dtype_promotion("standard"):
        assert policy.spec == spec_of(declare(about), task)
    assert about["period_s"] == task.config.dt
    assert about["task"]["eta"] == STUDIES.get("chen2023b").check_options({})["eta"]


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.id)
def test_the_policies_of_one_plan_were_learned_as_the_study_says(plan):
    policy, about = load_policy(lu2023.policy_file(f"improved_dqn-{plan.id}"))
    job = plan_job("improved_dqn", plan, 0, steps=ALL_STEPS if plan.restricted else LEARNING.steps)
    task = job.task()
    assert declare(about) == job.config
    assert PolicyInterface.from_dict(about["perception"]) == task.config.interface
    assert policy.spec == spec_of(job.config, task)


@pytest.mark.parametrize(
    "study", [chen2023b_ship, huang2025_ship, lu2023_ship], ids=lambda each: each.__name__
)
def test_a_folder_without_learning_runs_ships_nothing(study, tmp_path, monkeypatch, capsys):
    before = {path: path.read_bytes() for path in POLICIES.glob("*.safetensors")}
    monkeypatch.setattr("sys.argv", ["ship", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        print_shipped(study.ship)
    said = capsys.readouterr()
    assert (ended.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert str(tmp_path) in said.err
    assert before == {path: path.read_bytes() for path in POLICIES.glob("*.safetensors")}
    assert not any(tmp_path.iterdir())
