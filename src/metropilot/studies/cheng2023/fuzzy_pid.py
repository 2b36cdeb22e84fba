"""Fuzzy PID: rules move the gains of the incremental PID (the F-PID that Cheng23 compares with).

The rules are the textbook's 7 x 7 tables (Liu Jinkun, Advanced PID Control with MATLAB): rows the error,
columns its change, from negative big to positive big. Memberships are triangles that reach over two spacings
to each side, with Z- and S-shaped ends; inference is Mamdani's minimum and maximum, the answer the centroid.
The rule bases of the papers that Cheng23 cites are not printed there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from metropilot._schema import declare
from metropilot._typing import Array
from metropilot.control import CHENG2023_GAINS, CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import AbstractTracker, AbstractTrackingOptions, TrackingView
from metropilot.studies.cheng2023.tracking import array_namespace

NB, NM, NS, ZO, PS, PM, PB = range(7)
PROPORTIONAL = (
    (PB, PB, PM, PM, PS, ZO, ZO),
    (PB, PB, PM, PS, PS, ZO, NS),
    (PM, PM, PM, PS, ZO, NS, NS),
    (PM, PM, PS, ZO, NS, NM, NM),
    (PS, PS, ZO, NS, NS, NM, NM),
    (PS, ZO, NS, NM, NM, NM, NB),
    (ZO, ZO, NM, NM, NM, NB, NB),
)
INTEGRAL = (
    (NB, NB, NM, NM, NS, ZO, ZO),
    (NB, NB, NM, NS, NS, ZO, ZO),
    (NB, NM, NS, NS, ZO, PS, PS),
    (NM, NM, NS, ZO, PS, PM, PM),
    (NM, NS, ZO, PS, PS, PM, PB),
    (ZO, ZO, PS, PS, PM, PB, PB),
    (ZO, ZO, PS, PM, PM, PB, PB),
)
DERIVATIVE = (
    (PS, NS, NB, NB, NB, NM, PS),
    (PS, NS, NB, NM, NM, NS, ZO),
    (ZO, NS, NM, NM, NS, NS, ZO),
    (ZO, NS, NS, NS, NS, NS, ZO),
    (ZO, ZO, ZO, ZO, ZO, ZO, ZO),
    (PB, NS, PS, PS, PS, PS, PB),
    (PB, PM, PM, PM, PS, PS, PB),
)
TABLES = (PROPORTIONAL, INTEGRAL, DERIVATIVE)
GRID = np.linspace(-3.0, 3.0, 61)
TINY = 1e-12


class Universes(NamedTuple):
    """Half-widths of the universes; everything inside is counted from -3 to 3.

    Attributes:
        error_mps: Speed error that is wholly big.
        change_mps: Change of it over a period that is wholly big.
        proportional: Largest move of the proportional gain.
        integral: Largest move of the integral gain.
        derivative: Largest move of the derivative gain.
    """

    error_mps: Array
    change_mps: Array
    proportional: Array
    integral: Array
    derivative: Array


ASSUMED_UNIVERSES = Universes(0.5, 0.1, 1.0, 0.15, 0.1)
"""The textbook's universes scaled to a metro's speed errors: assumed."""
TUNED_FUZZY_PID: Mapping[str, float] = MappingProxyType(
    {
        "kp": 4.634,
        "ki": 1.4992,
        "kd": 0.2040,
        "error_mps": 0.5534,
        "change_mps": 0.00935,
        "kp_span": 2.2557,
        "ki_span": 0.00658,
        "kd_span": 0.7666,
    }
)
"""Found on the base scenario of Cheng23 by differential evolution, 1200 runs
(:func:`metropilot.studies.cheng2023.tuning.tune_driver`)."""


def memberships(x: Array) -> Array:
    """Degree to which each number is NB, NM, NS, ZO, PS, PM and PB.

    Args:
        x: In [-3, 3]. Shape ().

    Returns:
        Shape (7,), or (N, 7) for x of shape (N, 1).
    """
    xp = array_namespace(x)
    x = xp.clip(x, -3.0, 3.0)
    centre, left, right = _TRIANGLES
    triangle = xp.minimum((x - left) / (centre - left), (right - x) / (right - centre))
    big = [xp.reshape(_smooth(side, xp), (*xp.shape(triangle)[:-1], 1)) for side in (-x, x)]
    return xp.concatenate([big[0], xp.clip(triangle, 0.0, 1.0), big[1]], -1)


_TRIANGLES = tuple(
    np.array(row)
    for row in ((-2.0, -1.0, 0.0, 1.0, 2.0), (-3.0, -3.0, -2.0, -1.0, 0.0), (0.0, 1.0, 2.0, 3.0, 3.0))
)


def _smooth(x: Array, xp: Any) -> Array:  # noqa: ANN401 (a module)
    """The S-shaped end: 0 up to 1, 1 from 3, two parabolas in between."""
    share = xp.clip((x - 1.0) / 2.0, 0.0, 1.0)
    return xp.where(share < 0.5, 2.0 * share**2, 1.0 - 2.0 * (1.0 - share) ** 2)


SHAPES = memberships(GRID[:, None]).T
"""Membership of every point of the output grid in every set. Shape (7, 61)."""
_RULES = np.array([[[row == k for k in range(7)] for row in np.ravel(table)] for table in TABLES])


def infer(error: Array, change: Array) -> Array:
    """Moves of the three gains between -3 and 3: minimum, maximum, centroid.

    Args:
        error: Speed error over its universe, from -3 to 3. Shape ().
        change: Its change, likewise. Shape ().

    Returns:
        Shape (3,).
    """
    xp = array_namespace(error)
    firing = xp.minimum(memberships(error)[:, None], memberships(change)[None, :]).reshape(49)
    strength = xp.max(xp.where(_RULES, firing[None, :, None], 0.0), axis=1)
    shape = xp.max(xp.minimum(strength[:, :, None], SHAPES[None]), axis=1)
    return (shape @ GRID) / xp.maximum(shape.sum(-1), TINY)


def fuzzy_gains(
    error_mps: Array,
    change_mps: Array,
    universes: Universes = ASSUMED_UNIVERSES,
    base: Gains = CHENG2023_GAINS,
) -> Gains:
    """The gains for a speed error and its change over the last period.

    Args:
        error_mps: Speed of the reference less speed.
        change_mps: Its change over the last period.
        universes: Half-widths of the universes.
        base: Gains that the rules move.
    """
    moved = infer(3.0 * error_mps / universes.error_mps, 3.0 * change_mps / universes.change_mps)
    xp = array_namespace(moved)
    spans = universes[2:]
    return Gains(*(xp.clip(base[k] + moved[k] / 3.0 * spans[k], 0.0, CHENG2023_UPPER[k]) for k in range(3)))


def step_fuzzy_pid(
    command: Array, error_mps: Array, errors: Errors, universes: Universes, base: Gains
) -> tuple[Array, Errors]:
    """One period: infer the gains, then the incremental law."""
    gains = fuzzy_gains(error_mps, error_mps - errors.last, universes, base)
    return incremental_pid(command, gains, error_mps, errors)


@final
@dataclass(frozen=True)
class FuzzyPidOptions(AbstractTrackingOptions):
    """Options of ``fuzzy-pid``: the reference, the gains that the rules change, and the universes.

    Attributes:
        kp: Proportional gain at rest.
        ki: Integral gain at rest.
        kd: Derivative gain at rest.
        error_mps: Speed error that is wholly big.
        change_mps: Change of it over a period that is wholly big.
        kp_span: Largest move of the proportional gain.
        ki_span: Largest move of the integral gain.
        kd_span: Largest move of the derivative gain.
        tuned: Take gains and universes that were found by search instead.
    """

    kp: float = declare(CHENG2023_GAINS.proportional, low=0.0, high=CHENG2023_UPPER.proportional)
    ki: float = declare(CHENG2023_GAINS.integral, low=0.0, high=CHENG2023_UPPER.integral)
    kd: float = declare(CHENG2023_GAINS.derivative, low=0.0, high=CHENG2023_UPPER.derivative)
    error_mps: float = declare(ASSUMED_UNIVERSES.error_mps, unit="m/s", low=0.0, high=10.0, above=True)
    change_mps: float = declare(ASSUMED_UNIVERSES.change_mps, unit="m/s", low=0.0, high=10.0, above=True)
    kp_span: float = declare(ASSUMED_UNIVERSES.proportional, low=0.0, high=CHENG2023_UPPER.proportional)
    ki_span: float = declare(ASSUMED_UNIVERSES.integral, low=0.0, high=CHENG2023_UPPER.integral)
    kd_span: float = declare(ASSUMED_UNIVERSES.derivative, low=0.0, high=CHENG2023_UPPER.derivative)
    tuned: bool = declare(False)


@final
class FuzzyPid(AbstractTracker):
    """Tracks a reference with gains moved by rules.

    Args:
        options: Reference, gains at rest, universes.
    """

    id: ClassVar[str] = "fuzzy_pid"

    def __init__(self, options: FuzzyPidOptions | None = None) -> None:
        options = options or FuzzyPidOptions()
        options = replace(options, **TUNED_FUZZY_PID) if options.tuned else options
        super().__init__(options)
        self.base = Gains(options.kp, options.ki, options.kd)
        self.universes = Universes(
            options.error_mps, options.change_mps, options.kp_span, options.ki_span, options.kd_span
        )

    def aboard(self, number: type) -> None:
        """None: its table of rules is reshaped in a way that has no form in C."""
        del number

    def control(self, memory: Errors, seen: TrackingView) -> tuple[float, Errors]:
        """One period: rules, then law."""
        return step_fuzzy_pid(seen.command, seen.error_mps, memory, self.universes, self.base)
