"""Neural PID: a small network sets the gains and learns while it drives (NN-PID in Cheng23).

The textbook's back-propagation PID: inputs reference, speed, error and one; five hidden tanh units; three
sigmoid outputs scaled to the upper limits of the gains; the loss is half the squared error of the next
period, its gradient through the plant the sign of the answer to a command, which is +1. The details of the
paper that Cheng23 cites (Pu et al. 2020) are not public; layer sizes and rates are the textbook's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, NamedTuple, final

import numpy as np

from metropilot._schema import declare
from metropilot._typing import Array
from metropilot.control import CHENG2023_GAINS, CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import AbstractTracker, AbstractTrackingOptions, TrackingView
from metropilot.sim import Run
from metropilot.studies.cheng2023.tracking import array_namespace

HIDDEN = 5
SPEED_SCALE_MPS = 20.0


class LearningRates(NamedTuple):
    """Learning rates of the network.

    Attributes:
        learning: Learning rate.
        momentum: Share of the last change that is made again.
        error_scale_mps: Speed error that counts as 1.
    """

    learning: Array
    momentum: Array
    error_scale_mps: Array


TEXTBOOK_RATES = LearningRates(0.28, 0.04, 1.0)
TUNED_NEURAL_PID: Mapping[str, float] = MappingProxyType(
    {
        "kp": 4.835,
        "ki": 1.3242,
        "kd": 0.2075,
        "learning_rate": 5.611,
        "momentum": 0.06274,
        "error_mps": 0.01072,
    }
)
"""Found on the base scenario of Cheng23 by differential evolution, 1200 runs of three networks
(:func:`metropilot.studies.cheng2023.tuning.tune_driver`)."""


class Network(NamedTuple):
    """The controller's memory.

    Attributes:
        inner: Weights from the inputs to the hidden units. Shape (5, 4).
        outer: Weights from the hidden units, and a bias, to the outputs. Shape (3, 6).
        inner_change: Last change of ``inner``.
        outer_change: Last change of ``outer``.
        answer: Effect of the last period's command on each output, and the activations it came from.
        errors: Speed errors of the two periods before.
    """

    inner: Array
    outer: Array
    inner_change: Array
    outer_change: Array
    answer: tuple[Array, Array, Array]
    errors: Errors


def fresh_network(seed: int, base: Gains = CHENG2023_GAINS) -> Network:
    """A network whose gains begin near given ones: small random weights, biases that give those gains.

    Args:
        seed: Of the random weights.
        base: Gains at first.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    inner = random.uniform(-0.5, 0.5, (HIDDEN, 4))
    small = random.uniform(-0.1, 0.1, (3, HIDDEN))
    xp = array_namespace(base[0])
    share = xp.clip(xp.stack([xp.asarray(base[k] / CHENG2023_UPPER[k]) for k in range(3)]), 1e-3, 1.0 - 1e-3)
    outer = xp.concatenate([small, xp.log(share / (1.0 - share))[:, None]], axis=1)
    nothing = np.zeros(3), np.zeros(HIDDEN + 1), np.zeros(4)
    zero = np.float64(0.0)
    return Network(
        inner, outer, np.zeros((HIDDEN, 4)), np.zeros((3, HIDDEN + 1)), nothing, Errors(zero, zero)
    )


def step_neural_pid(
    network: Network, seen: TrackingView, rates: LearningRates = TEXTBOOK_RATES
) -> tuple[Array, Network]:
    """One period: learn from the error that the last command led to, set the gains, apply the law.

    Args:
        network: The controller's memory.
        seen: Controller inputs: errors, speed and last command.
        rates: Learning rates.

    Returns:
        The command in [-1, 1] and the next memory.
    """
    xp = array_namespace(seen.error_mps, network.inner)
    error, errors = seen.error_mps, network.errors
    owed, hidden, inputs = network.answer
    step = rates.learning * error / rates.error_scale_mps
    outer_change = step * owed[:, None] * hidden[None, :] + rates.momentum * network.outer_change
    back = (owed @ network.outer)[:HIDDEN] * (1.0 - hidden[:HIDDEN] ** 2)
    inner_change = step * back[:, None] * inputs[None, :] + rates.momentum * network.inner_change
    inner, outer = network.inner + inner_change, network.outer + outer_change

    one = xp.ones_like(error)
    parts = (
        seen.reference_mps / SPEED_SCALE_MPS,
        seen.speed_mps / SPEED_SCALE_MPS,
        xp.clip(error / rates.error_scale_mps, -1.0, 1.0),
        one,
    )
    inputs = xp.stack([xp.asarray(part) for part in parts])
    hidden = xp.concatenate([xp.tanh(inner @ inputs), xp.asarray(one)[None]])
    share = 0.5 * (1.0 + xp.tanh(0.5 * (outer @ hidden)))  # the sigmoid, without overflow
    limits = xp.asarray(CHENG2023_UPPER)
    gains = Gains(*(share[k] * limits[k] for k in range(3)))
    command, after = incremental_pid(seen.command, gains, error, errors)
    acts = xp.stack([error - errors.last, error, error - 2.0 * errors.last + errors.before])
    owed = acts / rates.error_scale_mps * limits * share * (1.0 - share)
    return command, Network(inner, outer, inner_change, outer_change, (owed, hidden, inputs), after)


@final
@dataclass(frozen=True)
class NeuralPidOptions(AbstractTrackingOptions):
    """Options of ``neural-pid``: the reference, the initial gains and the learning rates.

    Attributes:
        kp: Proportional gain at first.
        ki: Integral gain at first.
        kd: Derivative gain at first.
        learning_rate: Learning rate.
        momentum: Share of the last change that is made again.
        error_mps: Speed error that counts as 1.
        tuned: Take gains and rates that were found by search instead.
    """

    kp: float = declare(CHENG2023_GAINS.proportional, low=0.0, high=CHENG2023_UPPER.proportional)
    ki: float = declare(CHENG2023_GAINS.integral, low=0.0, high=CHENG2023_UPPER.integral)
    kd: float = declare(CHENG2023_GAINS.derivative, low=0.0, high=CHENG2023_UPPER.derivative)
    learning_rate: float = declare(TEXTBOOK_RATES.learning, low=0.0, high=100.0)
    momentum: float = declare(TEXTBOOK_RATES.momentum, low=0.0, high=1.0)
    error_mps: float = declare(TEXTBOOK_RATES.error_scale_mps, unit="m/s", low=0.0, high=10.0, above=True)
    tuned: bool = declare(False)


@final
class NeuralPid(AbstractTracker):
    """Tracks a reference with gains that a network sets and goes on learning.

    Args:
        options: Reference, gains at first, rates.
    """

    id: ClassVar[str] = "neural_pid"

    def __init__(self, options: NeuralPidOptions | None = None) -> None:
        options = options or NeuralPidOptions()
        options = replace(options, **TUNED_NEURAL_PID) if options.tuned else options
        super().__init__(options)
        self.base = Gains(options.kp, options.ki, options.kd)
        self.rates = LearningRates(options.learning_rate, options.momentum, options.error_mps)

    def fresh(self, run: Run) -> Network:
        """Random weights from the run's seed."""
        return fresh_network(run.seed, self.base)

    def control(self, memory: Network, seen: TrackingView) -> tuple[float, Network]:
        """One period: learn, set the gains, apply the law."""
        return step_neural_pid(memory, seen, self.rates)
