"""Network of a driver: its policy and features, for those who explain or replace it."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

from metropilot.drivers.learned import PolicyFunction
from metropilot.policy import Policy
from metropilot.sim import AbstractDriver, Run


class FeatureSpan(NamedTuple):
    """Feature that a network sees.

    Attributes:
        feature: Name of the feature.
        words: The feature in the field's words.
        size: Number of numbers that it has in the observation.
    """

    feature: str
    words: str
    size: int


class NetworkView(NamedTuple):
    """Network of a driver.

    Attributes:
        policy: The policy.
        features: Features of an observation, in its order.
        meaning: What a larger output speaks for, in words.
        output: Place of that output among those of a continuous action.
    """

    policy: Policy
    features: tuple[FeatureSpan, ...]
    meaning: str
    output: int


class AbstractNetworkDriver(AbstractDriver):
    """A driver that asks a learned network."""

    @abstractmethod
    def network_view(self, run: Run) -> NetworkView:
        """The network and what it sees on a run.

        Raises:
            InputError: The policy's file cannot be used.
        """

    @abstractmethod
    def with_policy(self, policy: PolicyFunction) -> AbstractDriver:
        """The same driver with another function in the place of its policy."""
