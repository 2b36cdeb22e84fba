"""Drivers that were learned: one small class and one policy file each, and one that drives any policy file.

``policy/shipped/<id>.safetensors`` is the policy of the driver ``<id>``. Each takes an option
``policy``: another file, or the folder or id of a learning run.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, final

from metropilot._schema import declare
from metropilot.drivers.learned import LearnedDriver, LearnedMemory, PolicyFunction
from metropilot.drivers.network import AbstractNetworkDriver, FeatureSpan, NetworkView
from metropilot.env import FEATURE_WORDS, GainsAction
from metropilot.errors import InputError
from metropilot.policy import LoadedPolicy, load_driving_policy, shipped_policy
from metropilot.sim import Observation, Run


@dataclass(frozen=True)
class PolicyOptions:
    """Options of a driver with a policy file.

    Attributes:
        policy: A policy file, or the folder or id of a learning run; empty: the one shipped with the driver.
    """

    policy: str = declare("")


class AbstractPolicyDriver(AbstractNetworkDriver):
    """Drives by a policy file, which is read when it is first needed.

    What the policy was not learned for (another section, another trainset) it still drives, as well as it
    can; protection supervises it like any other driver.

    Args:
        options: Options: the policy file.
    """

    def __init__(self, options: PolicyOptions | None = None) -> None:
        self.options = options or PolicyOptions()

    @property
    @abstractmethod
    def path(self) -> Path:
        """The policy's file.

        Raises:
            InputError: There is none.
        """

    @cached_property
    def loaded_policy(self) -> LoadedPolicy:
        """The policy, what it sees, and what is known about it.

        Raises:
            InputError: The file cannot be used.
        """
        return load_driving_policy(self.path)

    def read_policy(self) -> object:
        """Read the policy."""
        return self.loaded_policy

    def with_policy(self, policy: PolicyFunction) -> LearnedDriver:
        """The same driver with another function in the place of its policy."""
        return LearnedDriver(policy, self.loaded_policy.interface)

    def network_view(self, run: Run) -> NetworkView:
        """The network and what it sees on a run; of gains the held speed counts, which comes last."""
        loaded = self.loaded_policy
        policy, gains = loaded.policy.policy, loaded.interface.action.kind == GainsAction.kind
        sizes = self._driver.feature_sizes(run).items()
        spans = (FeatureSpan(name, FEATURE_WORDS[name], size) for name, size in sizes)
        meaning = "the notch chosen" if policy.spec.discrete else "a higher speed" if gains else "more power"
        return NetworkView(policy, tuple(spans), meaning, policy.spec.actions - 1)

    @cached_property
    def _driver(self) -> LearnedDriver:
        return self.with_policy(self.loaded_policy.policy)

    def init(self, run: Run) -> LearnedMemory:
        """Read the policy, and build the tables it sees."""
        return self._driver.init(run)

    def act(self, memory: LearnedMemory, observation: Observation) -> tuple[float, LearnedMemory]:
        """The policy's command, with the assists it was learned with."""
        return self._driver.act(memory, observation)


class AbstractShippedDriver(AbstractPolicyDriver):
    """A driver whose policy lies in this package."""

    @property
    def path(self) -> Path:
        """The file given, or the one shipped."""
        return Path(self.options.policy) if self.options.policy else shipped_policy(self.id)


@final
class FromFile(AbstractPolicyDriver):
    """Any learned policy: ``--set policy=PATH``, a policy file, or the folder or id of a learning run.

    Args:
        options: Options: the policy file.
    """

    id: ClassVar[str] = "learned"

    @property
    def path(self) -> Path:
        """The file given."""
        if not self.options.policy:
            allowed = (
                "--set policy=PATH or learned:policy=PATH, a policy file, or a learning run (folder or id)"
            )
            raise InputError("the driver learned needs a policy", field="policy", allowed=allowed)
        return Path(self.options.policy)


@final
class Ppo(AbstractShippedDriver):
    """Learned by PPO on Rongjing to Wanyuanjie, every load, times from 1.08 of the minimum to 130 s."""

    id: ClassVar[str] = "ppo"


@final
class PpoScaled(AbstractShippedDriver):
    """Learned by PPO with reward scaling (Chen23a eq. 23), for the same runs as ``ppo``."""

    id: ClassVar[str] = "ppo_scaled"


@final
class Generalist(AbstractShippedDriver):
    """Taught by the optimal plan on random sections and trainsets: drives any section it never saw."""

    id: ClassVar[str] = "generalist"
