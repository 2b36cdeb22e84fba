"""After an intervention, wherever it stops the trainset, every driver moves on and stops at the mark."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.drivers import DRIVERS
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Outcome, Rollout, Run

DKZ32 = load_trainset("dkz32")
LATE = replace(DKZ32, actuation=replace(DKZ32.actuation, delay_s=0.8, lag_s=0.4))
SECTION = load_line("yizhuang").section("RJ", "WYJ")
ANYWHERE = (
    *("optimal", "mpc", "generalist", "eitoe", "eitop", "itor", "ston", "stod", "flat_out", "manual"),
    *("pid", "ddpg_pid", "fuzzy_pid", "neural_pid", "ppo_scaled"),
)
"""Drivers that are offered for any line."""


@pytest.mark.parametrize("driver", ANYWHERE)
@pytest.mark.parametrize(
    ("trainset", "left_m"),
    [(DKZ32, 6.0), (LATE, 300.0), (LATE, 25.0), (LATE, 6.0)],
    ids=["6 m", "late, 300 m", "late, 25 m", "late, 6 m"],
)
def test_nobody_is_left_standing_short_of_the_stop(driver, trainset, left_m):
    """An emergency brake on the way, however near to the stop, is followed by a drive to the mark."""
    rollout = Rollout(Run(SECTION, trainset, 101.0), DRIVERS.make(driver))
    braked = False
    while rollout.outcome is None:
        moment = rollout.advance()
        if not braked and SECTION.length_m - moment.position_m < left_m:
            braked = True
            latched = rollout.state.supervision._replace(emergency=np.bool_(True))
            rollout.state = rollout.state._replace(supervision=latched)
    assert braked
    assert rollout.outcome is Outcome.ARRIVED
    # ddpg_pid, whose policy knows no dead time, comes late by itself
    assert moment.time_s < (200.0 if driver == "ddpg_pid" else 135.0)
