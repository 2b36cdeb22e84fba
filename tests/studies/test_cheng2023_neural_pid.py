"""The neural PID: its learning step is a gradient step, and it learns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.control import CHENG2023_GAINS, CHENG2023_UPPER, Errors
from metropilot.drivers import TrackingView
from metropilot.studies.cheng2023.neural_pid import (
    SPEED_SCALE_MPS,
    TUNED_NEURAL_PID,
    LearningRates,
    NeuralPid,
    NeuralPidOptions,
    fresh_network,
    step_neural_pid,
)


def seen(error, command=0.1, speed=10.0):
    return TrackingView(error, 0.0, speed, speed + error, command)


def test_it_begins_with_the_gains_it_is_given():
    network = fresh_network(3)._replace(outer=fresh_network(3).outer * np.array([0, 0, 0, 0, 0, 1.0]))
    # only the biases are left: u = 0.1 + kp 0.02 + ki 0.02 + kd 0.02
    command, _ = step_neural_pid(network, seen(0.02))
    assert command == pytest.approx(0.1 + 0.02 * sum(CHENG2023_GAINS))


def test_its_weights_move_along_the_gradient_of_the_command():
    # Loss: half the squared error of the next period; d error / d command counts as -1. So the weights move
    # by the learning rate times that error times d command / d weights, in units of the error scale.
    rates, errors, first, then = LearningRates(0.3, 0.0, 0.5), Errors(0.03, -0.01), seen(0.05), seen(0.08)
    network = fresh_network(1)._replace(errors=errors)

    def command(inner, outer):
        inputs = jnp.array([first.reference_mps / SPEED_SCALE_MPS, first.speed_mps / SPEED_SCALE_MPS, 0.1, 1])
        hidden = jnp.append(jnp.tanh(inner @ inputs), 1.0)
        kp, ki, kd = jnp.array(CHENG2023_UPPER) * jax.nn.sigmoid(outer @ hidden)
        return 0.1 + kp * 0.02 + ki * 0.05 + kd * (0.05 - 0.06 - 0.01)

    with jax.enable_x64(True):
        inner, outer = jax.grad(command, (0, 1))(jnp.asarray(network.inner), jnp.asarray(network.outer))
    given, after = step_neural_pid(network, first, rates)
    assert given == pytest.approx(float(command(network.inner, network.outer)), abs=1e-6)
    assert after.inner == pytest.approx(network.inner)  # the first period has nothing to learn from
    _, moved = step_neural_pid(after, then, rates)
    scale = 0.3 * (0.08 / 0.5) / 0.5
    np.testing.assert_allclose(moved.outer - network.outer, scale * np.asarray(outer), atol=1e-7)
    np.testing.assert_allclose(moved.inner - network.inner, scale * np.asarray(inner), atol=1e-7)


def test_momentum_makes_part_of_the_last_change_again():
    rates = LearningRates(0.3, 0.5, 0.5)
    _, once = step_neural_pid(fresh_network(1), seen(0.05), rates)
    _, twice = step_neural_pid(once, seen(0.08), rates)
    _, thrice = step_neural_pid(twice, seen(0.0), rates)
    np.testing.assert_allclose(thrice.outer - twice.outer, 0.5 * twice.outer_change)


def test_seeds_differ_and_repeat():
    assert (fresh_network(0).inner != fresh_network(1).inner).any()
    assert (fresh_network(2).inner == fresh_network(2).inner).all()


def test_options():
    assert NeuralPid(NeuralPidOptions(tuned=True)).rates.learning == TUNED_NEURAL_PID["learning_rate"]
