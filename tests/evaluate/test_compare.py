"""Several drivers on one run."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.drivers import DRIVERS
from metropilot.evaluate import RunSpec, best, best_of, compare, comparison_json, jobs, run_from_toml
from metropilot.evaluate.comparison import bootstrap
from metropilot.evaluate.figures import comparison_figure
from metropilot.evaluate.folder import write_comparison, write_run_toml


@pytest.fixture(scope="module")
def entries():
    """One driver, two seeds of noise (drives are slow under the run-time type check)."""
    from metropilot.sim import Disturbance

    noisy = Disturbance(speed_noise_mps=0.02)
    request = RunSpec("yizhuang", "RJ", "WYJ", 90.0, driver="flat_out", disturbance=noisy)
    return request, compare(request, jobs(["flat_out"], 5, 2))


def test_jobs_name_each_driver_once():
    assert [tuple(j) for j in jobs(["a", "b", "a"], 3, 2)] == [("a", 3), ("a", 4), ("b", 3), ("b", 4)]


def test_seeds_differ_and_repeat(entries):
    request, (first,) = entries
    assert [d.run.seed for d in first.drives] == [5, 6]
    assert first.kpis[0].energy_wheel_kwh != first.kpis[1].energy_wheel_kwh
    again = compare(request, jobs(["flat_out"], 6, 1))[0]
    assert again.kpis[0].energy_wheel_kwh == first.kpis[1].energy_wheel_kwh


def test_json_holds_every_seed(entries):
    table = comparison_json(*entries)
    (only,) = table["drivers"]
    assert only["driver"] == "flat_out"
    assert [r["seed"] for r in only["runs"]] == [5, 6]
    low, mean, high = (only["kpis"]["energy_wheel_kwh"][k] for k in ("low", "mean", "high"))
    assert low <= mean <= high


def test_the_best_is_the_lowest_of_those_that_succeed(entries):
    first = entries[1][0]
    assert first.successes == 2
    thrifty = replace(first, driver="b", kpis=tuple(replace(k, energy_wheel_kwh=1.0) for k in first.kpis))
    lost = replace(
        first,
        driver="c",
        kpis=tuple(replace(k, energy_wheel_kwh=0.1, outcome="overspeed", safe=False) for k in first.kpis),
    )
    rough = replace(
        first,
        driver="d",
        kpis=tuple(replace(k, energy_wheel_kwh=0.2, interventions=2) for k in first.kpis),
    )
    assert best([first, thrifty, lost, rough], "energy_wheel_kwh") == "b"
    assert best([first, lost], "energy_wheel_kwh") is None, "the best needs a rival"


def test_whoever_returns_most_is_best_at_the_line_and_an_error_counts_either_way():
    assert best_of({"a": -4.0, "b": -4.8, "c": 1.0}, "energy_line_kwh") == "b"
    assert best_of({"a": -4.0, "b": 0.5, "c": 1.0}, "time_error_s") == "b"


@pytest.mark.parametrize("count", [5, 11, len(DRIVERS)])
def test_the_figure_of_many_drivers_keeps_its_words_apart(entries, count):
    """The legend ran out of the figure, the key of the energies over the curves and below the axis."""
    first = entries[1][0]
    figure = comparison_figure([replace(first, driver=name) for name in [*DRIVERS][:count]])
    figure.canvas.draw()
    whole, (speed, _, energy) = figure.bbox, figure.axes
    legend, key = (axes.get_legend().get_window_extent() for axes in (speed, energy))
    assert whole.x0 <= legend.x0 <= legend.x1 <= whole.x1
    for words in speed.texts[-2:]:
        extent = words.get_window_extent()
        assert legend.y1 <= extent.y0 <= extent.y1 <= whole.y1
    highest = max(float(line.get_ydata().max()) for line in energy.lines)
    assert key.x1 <= energy.bbox.x1
    assert key.y0 >= energy.transData.transform((0.0, highest))[1]


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
    assert "compared" not in (tmp_path / "run.toml").read_text()


def test_the_run_of_a_comparison_names_the_drivers_it_leaves_out(tmp_path):
    request = RunSpec("yizhuang", "RJ", "WYJ", 90.0, driver="flat_out")
    write_run_toml(tmp_path, request, ["flat_out", "pid", "optimal"])
    path = tmp_path / "run.toml"
    assert "# It is the run of the first driver compared; the others: pid, optimal.\n" in path.read_text()
    assert run_from_toml(path) == request.resolve()
