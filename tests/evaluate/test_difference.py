"""Two drives against each other over distance, where the answer is known in closed form."""

from dataclasses import fields

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.evaluate import difference_of
from metropilot.sim import Trajectory


def accelerated(rate_mps2: float, until_s: float, step_s: float) -> Trajectory:
    """A drive from standstill at a constant acceleration; its energies are those of 1 kg."""
    t = np.arange(0.0, until_s + step_s / 2, step_s)
    columns = {f.name: np.zeros_like(t) for f in fields(Trajectory)}
    columns |= {"time_s": t, "speed_mps": rate_mps2 * t, "position_m": rate_mps2 * t**2 / 2}
    columns |= {"energy_wheel_j": (rate_mps2 * t) ** 2 / 2, "phase": np.full(t.size, "power")}
    return Trajectory(**columns)


def test_two_constant_accelerations_over_distance():
    found = difference_of(accelerated(1.0, 20.0, 0.5), accelerated(0.5, 40.0, 0.7))
    at = found.position_m
    assert at[0] == 0.0
    assert at[-1] == pytest.approx(200.0)
    assert np.diff(at).max() <= 5.0 + 1e-9
    for row, rate in zip(found.speed_mps, (1.0, 0.5), strict=True):
        np.testing.assert_allclose(row, np.sqrt(2.0 * rate * at), atol=1e-9)
    late = found.time_s[1] - found.time_s[0]
    far = at > 20.0
    np.testing.assert_allclose(late[far], (2.0 - np.sqrt(2.0)) * np.sqrt(at[far]), rtol=0.01)
    np.testing.assert_allclose(found.energy_wheel_j[0] / found.energy_wheel_j[1].clip(1e-9), 2.0 * (at > 0))


def test_a_drive_that_stood_is_refused():
    with pytest.raises(InputError, match="position_m: one of the runs did not move"):
        difference_of(accelerated(1.0, 20.0, 0.5), accelerated(0.0, 20.0, 0.5))
