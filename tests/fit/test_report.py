"""The command prints the fit and writes a trainset that can be read and driven."""

import json

import pytest
from tests import commands

from metropilot.evaluate import make_driver
from metropilot.railway import load_trainset
from metropilot.sim import Outcome, Run, drive

WHERE = ("--trainset", "dkz32", "--line", "yizhuang", "RJ", "WYJ")


@pytest.fixture(scope="module")
def fitted(trajectory_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fit")
    code, out, _ = commands.run("fit", str(trajectory_file), *WHERE, "--out", "fitted", "--json", cwd=folder)
    assert code == 0
    return folder / "fitted", json.loads(out)


def test_the_folder_holds_trainset_plots_and_numbers(fitted):
    folder, answer = fitted
    assert sorted(path.name for path in folder.iterdir()) == [
        "dkz32-fitted.toml",
        "fit.json",
        "residuals.png",
        "residuals.svg",
    ]
    values = {row["id"]: row["value"] for row in answer["parameters"]}
    assert values["mass_factor"] == pytest.approx(1.1, rel=1e-3)
    assert answer["samples"] > 600
    assert {"low", "high", "unit"} <= set(answer["parameters"][0])


def test_the_written_trainset_says_where_it_comes_from_and_can_be_driven(fitted, section):
    trainset = load_trainset(fitted[0] / "dkz32-fitted.toml")
    assert trainset.actuation.delay_s == pytest.approx(0.43, abs=2e-3)
    for block in ("mass", "resistance", "limits", "actuation"):
        assert "fitted to 1 log, 1 run, " in trainset.source[block]
        assert "95 %" in trainset.source[block]
    assert any("from dkz32" in note for note in trainset.notes)
    assert drive(Run(section, trainset, 130.0), make_driver("pid")).outcome is Outcome.ARRIVED


def test_the_tables_name_parameters_and_intervals(trajectory_file, tmp_path):
    code, out, _ = commands.run(
        "fit", str(trajectory_file), *WHERE, "--keep", "brake", "--keep", "lag", cwd=tmp_path
    )
    assert code == 0
    for word in ("dead time", "95 % interval", "kept", "resistance at 40 km/h", "--out DIR"):
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("missing.csv", "--trainset", "dkz32"), "missing.csv"),
        (("LOG", "--trainset", "none"), "unknown trainset"),
        (("LOG", "--trainset", "dkz32", "--keep", "weight"), "--keep: unknown"),
        (("LOG", "--trainset", "dkz32", "--input", "power"), "--input: unknown"),
        (("LOG", "--trainset", "dkz32", "--resistance", "two"), "--resistance: unknown"),
        (("LOG", "--trainset", "dkz32", "--line", "yizhuang", "RJ", "X"), "X"),
    ],
)
def test_bad_input_is_one_line_and_code_2(trajectory_file, tmp_path, arguments, said):
    words = [str(trajectory_file) if word == "LOG" else word for word in arguments]
    code, _, error = commands.run("fit", *words, cwd=tmp_path)
    assert code == 2
    assert said in error
    assert len(error.strip().splitlines()) == 1
