"""Dead time, lag and jerk limit in plain numbers: the state when a command given now begins to act."""

from __future__ import annotations

import math
from typing import NamedTuple

from metropilot.control.estimator import Model, PredictedState
from metropilot.drivers.expert.ground import ExpertTrack

LAG_LEAD = 0.7
"""How much of the lag is made up for by asking for more at once."""


class CommandActuation(NamedTuple):
    """Commands on their way (Huang25 eq. 4).

    Attributes:
        commands: Commands given, newest first, as many as are on their way and one more.
        share: Command after dead time and lag in the last period.
        steps: Dead time in control periods.
        keep: Share of the old effort that the lag keeps over a period.
        lag_s: Time constant of the lag.
        dt: Control period, s.
    """

    commands: tuple[float, ...]
    share: float
    steps: int
    keep: float
    lag_s: float
    dt: float

    def issued(self, command: float) -> CommandActuation:
        """The actuation once a command has been given for the coming period."""
        commands = (command, *self.commands[:-1])
        acting = commands[self.steps]
        return self._replace(commands=commands, share=acting + (self.share - acting) * self.keep)


def actuation_of(model: Model) -> CommandActuation:
    """Nothing on its way."""
    dt, lag = model.dt, float(model.vehicle.lag_s)
    steps = round(float(model.vehicle.delay_s) / dt)
    keep = math.exp(-dt / lag) if lag > 0 else 0.0
    return CommandActuation((0.0,) * (steps + 1), 0.0, steps, keep, lag, dt)


def ahead_of(
    ground: ExpertTrack, actuation: CommandActuation, state: tuple[float, float, float], brake_gain: float
) -> PredictedState:
    """The state at the moment a command given now begins to act, with the commands on their way.

    Args:
        ground: Tables of the section.
        actuation: Commands on their way.
        state: Position, speed and acceleration of the last period; m, m/s, m/s^2.
        brake_gain: Actual over believed braking force.
    """
    x, v, a = state
    dt, share, room = actuation.dt, actuation.share, ground.jerk_mps3 * actuation.dt
    traction, brake = ground.traction(v), brake_gain * ground.brake(v)
    drag = ground.drag(x, v)
    for k in range(actuation.steps):
        acting = actuation.commands[actuation.steps - 1 - k]
        share = acting + (share - acting) * actuation.keep
        wanted = share * (traction if share > 0.0 else brake) - drag
        a = min(max(wanted, a - room), a + room)
        a = max(a, 0.0) if v <= 0.0 else a
        after = max(v + a * dt, 0.0)
        x, v = x + 0.5 * (v + after) * dt, after
    if actuation.steps:
        traction, brake, drag = ground.traction(v), brake_gain * ground.brake(v), ground.drag(x, v)
    return PredictedState(actuation.steps * dt, x, v, a, share, drag, 0.0, traction, brake)


def share_of(actuation: CommandActuation, ahead: PredictedState, effort_mps2: float) -> float:
    """The command that gives a wheel effort when it begins to act, in [-1, 1].

    Args:
        actuation: Commands on their way.
        ahead: The state at that moment.
        effort_mps2: Effort over mass, traction positive.
    """
    share = effort_mps2 / (ahead.traction_mps2 if effort_mps2 >= 0.0 else ahead.brake_mps2)
    kept = LAG_LEAD * actuation.keep
    share = min(max(share, -1.0), 1.0)
    return min(max((share - kept * ahead.share) / (1.0 - kept), -1.0), 1.0)
