"""Several drivers on one run."""

import numpy as np
import pytest

from metropilot.evaluate import best, compare, comparison_json, jobs
from metropilot.evaluate.compare import bootstrap
from metropilot.evaluate.folder import write_comparison


@pytest.fixture(scope="module")
def entries():
    from metropilot.evaluate import Request

    request = Request("yizhuang", "RJ", "WYJ", 101.0, speed_noise_mps=0.02)
    return request, compare(request, jobs(["manual", "flat_out", "manual"], 5, 2))


def test_jobs_name_each_driver_once():
    assert [tuple(j) for j in jobs(["a", "b", "a"], 3, 2)] == [("a", 3), ("a", 4), ("b", 3), ("b", 4)]


def test_seeds_differ_and_repeat(entries):
    request, (manual, flat_out) = entries
    assert [d.run.seed for d in manual.drives] == [5, 6]
    assert manual.kpis[0].energy_wheel_kwh != manual.kpis[1].energy_wheel_kwh
    again = compare(request, jobs(["manual"], 6, 1))[0]
    assert again.kpis[0].energy_wheel_kwh == manual.kpis[1].energy_wheel_kwh
    assert flat_out.successes == 0


def test_json_holds_every_seed(entries):
    table = comparison_json(*entries)
    assert [d["driver"] for d in table["drivers"]] == ["manual", "flat_out"]
    first = table["drivers"][0]
    assert [r["seed"] for r in first["runs"]] == [5, 6]
    low, mean, high = (first["kpis"]["energy_wheel_kwh"][k] for k in ("low", "mean", "high"))
    assert low <= mean <= high


def test_the_best_needs_a_rival(entries):
    assert best(entries[1], "energy_wheel_kwh") is None


def test_bootstrap_repeats_itself_and_holds_the_mean():
    values = np.random.default_rng(1).normal(10.0, 2.0, 40)
    found = bootstrap(values)
    assert found == bootstrap(values)
    assert found.low < found.mean < found.high
    # The interval of a mean of 40 values with deviation 2 is about 2 * 1.96 * 2 / sqrt(40) = 1.24 wide.
    assert found.high - found.low == pytest.approx(1.24, rel=0.3)


def test_bootstrap_of_a_constant_has_no_width():
    assert bootstrap(np.full(5, 3.0)) == (3.0, 3.0, 3.0)


def test_the_folder_of_a_comparison(entries, tmp_path):
    write_comparison(tmp_path, *entries)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "comparison.json",
        "comparison.png",
        "comparison.svg",
        "run.toml",
    ]
