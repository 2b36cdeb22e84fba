"""Remove each guard in turn: the attack made for it gets through, and does not with the guard in place."""

from dataclasses import replace

import numpy as np
import pytest
from tests.protection.duel import Scenario, duel

from metropilot.protection import predict, supervisor

DROP = ((420.0, 300.0, 8.0),)


def near_drop(**changes):
    """A drop to 8 m/s ahead, and a trainset that no resistance helps to brake."""
    return Scenario(**{"limits": DROP, "zone": (150.0, 330.0), "resistance": 0.0, **changes})


def rates(**changes):
    new = {key: np.float64(value) for key, value in changes.items()}
    return lambda protection: protection._replace(rates=protection.rates._replace(**new))


def fading(**changes):
    new = {key: np.float64(value) for key, value in changes.items()}
    return lambda protection: protection._replace(fading=protection.fading._replace(**new))


def no_pull(protection):
    return protection._replace(pull_mps2=0.0 * protection.pull_mps2)


# Guard: the attack, and the protection without the guard.
IN_THE_ARRAYS = {
    "reaction of the emergency brake": (near_drop(delay_s=0.6, reaction_s=0.6), rates(reaction_s=0.2)),
    "control period": (near_drop(delay_s=0.6), rates(reaction_s=0.0)),
    "build-up of the emergency brake": (
        near_drop(delay_s=0.6, emergency_jerk_mps3=1.0),
        rates(jerk_mps3=1e4),
    ),
    "lighter than nominal": (near_drop(delay_s=0.6, reaction_s=0.6, mass=0.8, pace=0.8), rates(mass_low=1.0)),
    "heavier than nominal": (near_drop(mass=1.6, reaction_s=0.6, friction=False), rates(mass_high=1.0)),
    "weak service brake": (near_drop(service=0.5, reaction_s=0.6), rates(service_share=1.0)),
    "resistance that is not certain": (near_drop(delay_s=0.6, reaction_s=0.6), rates(resistance_low=1.0)),
    "error of the measured speed": (near_drop(speed_bias_mps=0.15), rates(speed_error_mps=0.0)),
    "lag": (near_drop(lag_s=1.0, reaction_s=0.6), fading(share=0.0)),
    "jerk limit in service": (near_drop(jerk_mps3=0.5, reaction_s=0.6), fading(acceleration_mps2=np.inf)),
    "gradient in the reaction": (
        near_drop(
            section=("XHM", "JG"),
            limits=((700.0, 400.0, 8.0),),
            zone=(450.0, 620.0),
            reaction_s=0.8,
            delay_s=0.6,
        ),
        no_pull,
    ),
}


@pytest.mark.parametrize("guard", IN_THE_ARRAYS)
def test_guard_in_the_arrays(guard):
    attack, removed = IN_THE_ARRAYS[guard]
    assert duel(attack) <= 0.0
    assert duel(attack, removed) > 0.005


# Guard: the attack, and the scenario that protection believes in.
IN_THE_CURVES = {
    "error of the measured position": (
        near_drop(position_bias_m=3.0, reaction_s=0.6),
        {"position_bias_m": 0.0},
    ),
    "limit until the tail has cleared": (
        near_drop(limits=((200.0, 200.0, 8.0),), zone=(250.0, 400.0)),
        {"length_m": 0.0},
    ),
    "restrictions": (near_drop(), {"limits": ()}),
}


@pytest.mark.parametrize("guard", IN_THE_CURVES)
def test_guard_in_the_curves(guard):
    attack, believed = IN_THE_CURVES[guard]
    assert duel(attack) <= 0.0
    assert duel(attack, believed=replace(attack, **believed)) > 0.05


def test_gradient_in_the_braking_curve():
    attack = near_drop(section=("XHM", "JG"), limits=((800.0, 400.0, 8.0),), zone=(400.0, 620.0), delay_s=0.6)
    assert duel(attack) <= 0.0
    assert duel(attack, ground=flat) > 0.5


def flat(section):
    return replace(
        section, gradient_permil=replace(section.gradient_permil, value=0.0 * section.gradient_permil.value)
    )


def test_commands_on_their_way(monkeypatch):
    attack = near_drop(delay_s=0.6)
    assert duel(attack) <= 0.0
    monkeypatch.setattr(supervisor.CommandCheck, "share_bound", lambda _check, share: share)
    assert duel(attack) > 0.05


def test_zones_shorter_than_the_reaction(monkeypatch):
    attack = near_drop(
        limits=((420.0, 4.0, 13.4),), zone=(300.0, 415.0), delay_s=0.6, reaction_s=0.6, length_m=0.0
    )
    assert duel(attack) <= 0.0

    whole = predict.stays_under

    def only_the_end(rates, curve, distance_m, *motion):
        far = curve.copy()
        far[: int(0.75 * curve.size)] = np.inf
        return whole(rates, far, distance_m, *motion)

    monkeypatch.setattr(supervisor, "stays_under", only_the_end)
    assert duel(attack) > 0.05
