"""Station stop by a heuristic online algorithm: the brake's gain is learned and kept for the next stop.

In every control period the deceleration is computed anew that ends at the stop, ``b = v^2 / (2 S)`` with
the trainset's jerk limit (:mod:`metropilot.control.stopping`), and divided by the gain learned so far. The
gain is learned twice: in every period from the deceleration that came of the command, and at the balises from
the speeds at two exact places, ``(v1^2 - v2^2) / (2 (S1 - S2))``.

Source: Chen, Chen, Li and Tang, T-ITS 14(3) 2013 (TASC, HOA; used in Huang25 section 3.1). Its formula is not
at hand; this is the form its description has. Places of the balises: from memory of the group's papers.
"""

from __future__ import annotations

from typing import NamedTuple

from metropilot.control import (
    STOP_OPTIONS,
    STRONGEST_MPS2,
    CommandActuation,
    PredictedState,
    StopCurve,
    required_with_build_up,
    stop_deceleration,
)
from metropilot.drivers.expert.ground import ExpertTrack, share_of

BALISES_M = (64.0, 36.0, 16.0, 4.0, 0.0)
"""Distances of the balises before the stop."""
HEURISTIC = 0.5
"""Share of the gain measured between two balises that is taken over."""
UNSURE = 0.2
"""Scatter of the gain of a brake never tried."""
SETTLED = 0.01
"""Least scatter, and what one day does to it."""
ANSWER_MPS2 = 0.03
"""Scatter of a period's deceleration about the gain's."""
STRANGE = 4.0
"""A period this many deviations off is not the brake's doing (protection may have stepped in) ..."""
DOUBT = 0.003
"""... or the brake is no longer what it was: so much more scatter."""
LEAST_EFFORT_MPS2 = 0.15
GAIN = (0.5, 1.6)
CAUTION = 1.7
USE = 0.97
NEAR = 0.4
COARSE = 0.05
"""A period in which braking changes the speed by more than twice this share is no measure of distance."""
PAST_M = 0.1
"""Farther past the stop than this it is better to stand with all the jerk limit allows."""


class Hoa(NamedTuple):
    """Knowledge of the brake, and progress of this stop.

    Attributes:
        gain: Actual over nominal braking force.
        sigma: Its standard deviation.
        braking: True while the station-stop braking is on.
        passed: Balises passed.
        speed_mps: Speed at the last of them.
        effort_jpkg: Braking effort asked for since, times distance, after delay and lag.
        drag_jpkg: Resistance and gradient since, times distance.
    """

    gain: float = 1.0
    sigma: float = UNSURE
    braking: bool = False
    passed: int = 0
    speed_mps: float = 0.0
    effort_jpkg: float = 0.0
    drag_jpkg: float = 0.0

    def plan_mps2(self, brake_mps2: float, downhill_mps2: float, most_mps2: float) -> float:
        """Deceleration to plan the stop with: the less the gain is known the less, downhill what is left."""
        sure = min(self.gain * (1.0 - CAUTION * self.sigma), 1.0)
        left = min(self.gain, 1.0) * brake_mps2 + downhill_mps2
        return USE * min(brake_mps2 * sure, left, most_mps2)

    def next_stop(self) -> Hoa:
        """Knowledge carried to the next stop."""
        return Hoa(self.gain, max(self.sigma, SETTLED))


def update_gain(
    hoa: Hoa,
    ground: ExpertTrack,
    actuation: CommandActuation,
    state: tuple[float, float, float],
    before_mps2: float,
) -> Hoa:
    """Update the gain after one control period.

    Args:
        hoa: Knowledge before the period.
        ground: Tables of the section.
        actuation: Actuation during the period.
        state: Position, speed and acceleration of the period; m, m/s, m/s^2.
        before_mps2: Acceleration of the period before.
    """
    x, v, a = state
    asked = -actuation.share * ground.brake(v)
    if asked < LEAST_EFFORT_MPS2 or v < 0.5:
        return hoa
    drag = ground.drag(x, v)
    found = _at_balise(hoa, ground, x, v, (asked * v * actuation.dt, drag * v * actuation.dt))
    ramping = abs(a - before_mps2) > 0.9 * ground.jerk_mps3 * actuation.dt
    if ramping:
        return found
    variance = found.sigma * found.sigma
    spread = ANSWER_MPS2 * ANSWER_MPS2 + variance * asked * asked
    miss = -(a + drag) - asked * found.gain
    if miss * miss > STRANGE * STRANGE * spread:
        return found._replace(sigma=min(found.sigma + DOUBT, UNSURE))
    weight = variance * asked / spread
    gain = found.gain + weight * miss
    variance *= 1.0 - weight * asked
    return found._replace(gain=min(max(gain, GAIN[0]), GAIN[1]), sigma=max(variance**0.5, SETTLED))


def _at_balise(hoa: Hoa, ground: ExpertTrack, x: float, v: float, work: tuple[float, float]) -> Hoa:
    """Add up the period's work; at a balise, what came of it since the one before."""
    hoa = hoa._replace(effort_jpkg=hoa.effort_jpkg + work[0], drag_jpkg=hoa.drag_jpkg + work[1])
    if hoa.passed >= len(BALISES_M) or ground.length_m - x > BALISES_M[hoa.passed]:
        return hoa
    gain = hoa.gain
    if hoa.passed > 0 and hoa.effort_jpkg > LEAST_EFFORT_MPS2 and 0.5 * work[0] <= COARSE * v * v:
        lost = 0.5 * (hoa.speed_mps * hoa.speed_mps - v * v)
        said = (lost - hoa.drag_jpkg) / hoa.effort_jpkg
        gain += HEURISTIC * min(max(said - gain, -0.1), 0.1)
    return hoa._replace(gain=gain, passed=hoa.passed + 1, speed_mps=v, effort_jpkg=0.0, drag_jpkg=0.0)


def stop_share(
    hoa: Hoa, ground: ExpertTrack, actuation: CommandActuation, ahead: PredictedState, curve: StopCurve
) -> tuple[float, bool]:
    """Choose the command of the station-stop braking; False beside it if it is not on.

    Args:
        hoa: Knowledge of the brake.
        ground: Tables of the section.
        actuation: Commands on their way.
        ahead: The state when a command given now begins to act, the gain in its brake.
        curve: Shape of the stop, planned with :meth:`Hoa.plan_mps2`.
    """
    v, distance, plan = ahead.speed_mps, ground.length_m - ahead.position_m, curve.deceleration_mps2
    if v <= 0.0 and distance < STOP_OPTIONS.inch_m:
        return share_of(actuation, ahead, -max(curve.end_mps2, STOP_OPTIONS.hold_mps2)), True
    if not hoa.braking and v * v < 2.0 * NEAR * plan * max(distance - 2.0 * v, 0.5):
        return 0.0, False
    dt, a = actuation.dt, ahead.acceleration_mps2
    if not hoa.braking:
        early_m = v * (0.5 * actuation.lag_s + 0.25 * dt)
        sooner, _ = required_with_build_up(v, a, distance - early_m, curve)
        later, _ = required_with_build_up(v, a, distance - _way(v, -max(a, 0.0), dt), curve)
        if sooner < plan and later <= plan / USE:
            return 0.0, False
    wanted = stop_deceleration(v, a, distance, curve, dt).wanted_mps2
    if _way(v, wanted, dt) > distance + PAST_M:
        short = v * v / (2.0 * distance) if distance > 0.0 else STRONGEST_MPS2
        wanted = max(wanted, min(short, curve.build_jerk_mps3 * dt))
    return share_of(actuation, ahead, ahead.resistance_mps2 - wanted), True


def _way(speed_mps: float, deceleration_mps2: float, dt: float) -> float:
    """Distance gone in a period, or to the stand in it."""
    if speed_mps <= deceleration_mps2 * dt:
        return 0.5 * speed_mps * speed_mps / deceleration_mps2 if deceleration_mps2 > 0.0 else 0.0
    return (speed_mps - 0.5 * deceleration_mps2 * dt) * dt
