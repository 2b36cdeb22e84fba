"""Attribution of a learned driver's decisions to the features that it sees.

Integrated gradients (Sundararajan et al. 2017): the gradient of the network's output, times the difference of
the observation from the mean observation of the drive, integrated along the straight line between them. The
shares sum up to the difference of the output from that of the mean observation. A feature of several numbers
has the sum of theirs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.drivers import AbstractNetworkDriver
from metropilot.policy import Policy, in_precision, network_output, output_gradient
from metropilot.sim import AbstractDriver, Drive, Rollout

STEPS = 64
"""Points of the integral along the line."""
SAME_M = 1e-3
"""Difference of position up to which a run counts as driven again."""


class FeatureShare(NamedTuple):
    """Share of a feature in a decision.

    Attributes:
        feature: Name of the feature.
        words: The feature in the field's words.
        share: Part of the output's difference from that of the mean observation.
    """

    feature: str
    words: str
    share: float


class FeatureMoment(NamedTuple):
    """Decision of a learned driver, and what it rests on.

    Attributes:
        time_s: Time since departure.
        position_m: Position.
        output: Output of the network: of a continuous action before it is clipped, of a choice the value of
            the chosen notch less the mean of all.
        usual: The same for the mean observation of the drive.
        meaning: What a positive share speaks for, in words.
        shares: Share of every feature, the strongest first; they sum up to ``output - usual``.
    """

    time_s: float
    position_m: float
    output: float
    usual: float
    meaning: str
    shares: tuple[FeatureShare, ...]


def attribute_decisions(
    drive: Drive, driver: AbstractDriver, times_s: Float[ndarray, " moments"]
) -> tuple[FeatureMoment, ...]:
    """Attribute decisions of a learned driver to its features.

    The run is driven once more, to see what the driver saw.

    Args:
        drive: The drive.
        driver: The driver that drove it, made anew.
        times_s: Moments, s since departure; the last decision before each is taken.

    Returns:
        One a decision, in the order of the drive; a moment at which the network is not asked, as in the
        station stop of an expert system, has the last one before. Empty for a driver without a network (a
        table has none), and for a drive with manual driving in it.
    """
    if not isinstance(driver, AbstractNetworkDriver):
        return ()
    view = driver.network_view(drive.run)
    if view.policy.spec.output == "table":
        return ()
    when, seen = _replay(drive, driver, view.policy)
    if not len(seen):
        return ()
    features = view.features
    starts = np.cumsum([0, *(each.size for each in features)])[:-1]
    policy = Policy(view.policy.spec, in_precision(view.policy.params, np.float64))
    usual, found = seen.mean(axis=0), []
    last = np.searchsorted(when, times_s + 1e-6) - 1
    for k in dict.fromkeys(last[last >= 0].tolist()):
        weights = _output_weights(policy, seen[k], view.output)
        shares = np.add.reduceat(_integrate(policy, usual, seen[k], weights), starts)
        order = np.argsort(-np.abs(shares))
        output, mean_output = (
            float(weights @ network_output(policy.spec, policy.params, each, np)) for each in (seen[k], usual)
        )
        position_m = float(np.interp(when[k], drive.trajectory.time_s, drive.trajectory.position_m))
        told = (FeatureShare(features[j].feature, features[j].words, float(shares[j])) for j in order)
        found.append(
            FeatureMoment(float(when[k]), position_m, output, mean_output, view.meaning, tuple(told))
        )
    return tuple(found)


def _replay(
    drive: Drive, driver: AbstractNetworkDriver, policy: Policy
) -> tuple[Float[ndarray, " decisions"], Float[ndarray, "decisions features"]]:
    """Times and observations of the decisions; none where the run goes another way, as by hand."""
    seen: list[ndarray] = []
    when: list[float] = []

    def decide(observation: ndarray, mask: ndarray | None = None) -> object:
        seen.append(observation.astype(np.float64))
        return policy(observation, mask)

    rollout = Rollout(drive.run, driver.with_policy(decide))
    while rollout.outcome is None:
        time_s = rollout.moment().time_s
        rollout.advance()
        when += [time_s] * (len(seen) - len(when))
    again_m, driven_m = rollout.drive().trajectory.position_m, drive.trajectory.position_m
    if again_m.size != driven_m.size or not np.allclose(again_m, driven_m, atol=SAME_M):
        return np.zeros(0), np.zeros((0, 0))
    return np.array(when), np.array(seen)


def _output_weights(
    policy: Policy, observation: Float[ndarray, " features"], place: int
) -> Float[ndarray, " width"]:
    """Weights of the network's outputs in the number that is attributed."""
    spec = policy.spec
    output = network_output(spec, policy.params, observation, np)
    weights = np.zeros(output.size)
    if spec.discrete:
        weights -= 1.0 / output.size
        weights[int(output.argmax())] += 1.0
    else:
        weights[place] = 1.0
    return weights


def _integrate(
    policy: Policy,
    usual: Float[ndarray, " features"],
    seen: Float[ndarray, " features"],
    weights: Float[ndarray, " width"],
) -> Float[ndarray, " features"]:
    """Integrated gradients of one observation."""
    way = (np.arange(STEPS) + 0.5)[:, None] / STEPS
    gradients = output_gradient(policy, usual + way * (seen - usual), weights)
    return (seen - usual) * gradients.mean(axis=0)
