"""Each reward term against a number worked out by hand; each action against the command it means."""

import numpy as np
import pytest

from metropilot.env import ACTIONS, task_config
from metropilot.env.actions import GainsAction, IncrementAction, NotchAction, RegimeAction
from metropilot.env.features import FeatureContext
from metropilot.env.rewards import TERMS, Energy, Failure, OnTime, PeriodChange, Punctuality
from metropilot.env.tables import SectionRows
from metropilot.errors import InputError
from metropilot.physics import effort_at

F = np.float64
MOVING = PeriodChange(
    wheel_j=F(7.2e6),
    line_j=F(9e6),
    jerk_mps2=F(0.4),
    seconds=F(0.5),
    overruled=F(1.0),
    overspeed_mps=F(0.2),
    ended=np.bool_(False),
    arrived=np.bool_(False),
    late_s=F(-50.0),
    error_m=F(-600.0),
    braked_j=F(0.8e6),
    acceleration_mps2=F(0.5),
    before_mps2=F(0.2),
    speed_mps=F(12.0),
    command=F(0.5),
    command_before=F(0.2),
)
ARRIVED = MOVING._replace(ended=np.bool_(True), arrived=np.bool_(True), late_s=F(3.0), error_m=F(0.1))
FAILED = MOVING._replace(ended=np.bool_(True), late_s=F(3.0), error_m=F(-100.0))


@pytest.mark.parametrize(
    ("name", "moving", "arrived", "failed"),
    [
        ("energy", -2.0, -2.0, -2.0),
        ("line_energy", -2.5, -2.5, -2.5),
        ("comfort", -0.04, -0.04, -0.04),
        ("on_time", 0.0, 100.0, -100.0),
        ("punctuality", 0.0, -2.5, 0.0),  # |3| - 0.5
        ("stop_error", 0.0, -0.1, -20.0),  # at most 20
        ("failure", 0.0, 0.0, -12.0),  # 10 + 0.02 * 100
        ("intervention", -0.5, -0.5, -0.5),
        ("overspeed", -0.1, -0.1, -0.1),
        ("seconds", -0.05, -0.05, -0.05),
    ],
)
def test_term(name, moving, arrived, failed):
    term = TERMS[name]()
    assert float(term.value(MOVING)) == pytest.approx(moving)
    assert float(term.value(ARRIVED)) == pytest.approx(arrived)
    assert float(term.value(FAILED)) == pytest.approx(failed)


def test_every_term_is_tested():
    assert set(TERMS) == {
        mark.args[1][k][0] for mark in test_term.pytestmark for k in range(len(mark.args[1]))
    }


def test_weights():
    assert float(Energy(per_kwh=3.0).value(MOVING)) == pytest.approx(-6.0)
    assert float(OnTime(allowed_s=2.0).value(ARRIVED)) == -100.0
    early = ARRIVED._replace(late_s=F(-3.0))
    assert float(Punctuality(early=0.5).value(early)) == pytest.approx(-1.25)
    assert float(Punctuality(soft_s=4.0).value(ARRIVED)) == pytest.approx(-9.0 / 8.0)
    assert float(Failure(price=1.0, per_m=0.0).value(FAILED)) == -1.0


def context():
    rows = SectionRows(task_config("chen2023a").tables(np.float64), jax=False)
    case = rows.case(0)
    seen = {"case": 0, "command": F(0.4), "speed_mps": F(10.0), "position_m": F(300.0)}
    seen |= {"rows": rows, "vehicle": case.vehicle, "track": case.track, "rates": case.protection.rates}
    return FeatureContext(**dict.fromkeys(FeatureContext._fields) | seen)


@pytest.mark.parametrize("notches", [(), (0.0, float("nan")), (3.0,), ("full",)])
def test_notches_are_commands_or_forces(notches):
    with pytest.raises(InputError, match="notches: "):
        NotchAction.__init__.__wrapped__(
            object.__new__(NotchAction), notches
        )  # past the tests' check of types
    assert NotchAction((-3.0, 4.0), forces=True).space.count == 2


def test_actions():
    seen = context()
    command = lambda action, value: float(action.command(seen, np.array(value), 0.5))  # noqa: E731
    regime = RegimeAction(coast=0.2, full=0.8)
    found = [command(regime, [x]) for x in (-1, -0.5, -0.1, 0.1, 0.5, 0.9)]
    assert found == pytest.approx([-1, -0.5, 0, 0, 0.5, 1])
    assert command(IncrementAction(rate_per_s=0.4), [-1.0]) == pytest.approx(0.2)
    assert command(NotchAction((-1.0, 0.0, 0.5)), 2) == 0.5
    gains = GainsAction(low=(0.1, 0.5), high=(0.9, 0.5))
    # The middle of a range is its geometric mean.
    assert gains.gains(seen, np.zeros(2)) == pytest.approx([0.3, 0.5])
    assert command(gains, [0.0, 0.0]) == pytest.approx(0.3 * (0.5 * seen.permitted_mps - 10.0), abs=1e-6)
    newtons = float(effort_at(seen.vehicle, F(10.0)).traction_n)
    assert command(NotchAction((-1e9, 0.25 * newtons, newtons), forces=True), 1) == pytest.approx(0.25)
    assert command(NotchAction((-1e9, 0.25 * newtons, newtons), forces=True), 0) == -1.0
    for kind in map(ACTIONS.get, ACTIONS):
        space = kind().space
        assert (space.size > 0) != space.discrete
