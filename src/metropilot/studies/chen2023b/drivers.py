"""Followers of the paper: a PID whose gains a policy sets, each policy from one checked file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final, no_type_check

import numpy as np

from metropilot import convoy
from metropilot._schema import declare
from metropilot._typing import Scalar
from metropilot.control import Errors, Gains
from metropilot.errors import InputError
from metropilot.physics import Vehicle, namespace, scalars
from metropilot.policy import Policy, load_policy, policy_path, shipped_policy
from metropilot.policy import act as policy_act

STATE_SIZE, GAINS = 6, 3
"""Chen23b eqs. 15 and 16."""


@dataclass(frozen=True)
class FollowPolicyOptions:
    """Policy that sets the gains.

    Attributes:
        policy: A policy file, or the folder or id of a learning run; empty: the one shipped with the driver.
    """

    policy: str = declare("")


class AbstractGainFollower(convoy.AbstractFollower):
    """PID on the speed difference whose gains a policy sets anew in every period.

    Args:
        options: Policy.
    """

    def __init__(self, options: FollowPolicyOptions | None = None) -> None:
        self.options = options or FollowPolicyOptions()

    @cached_property
    def policy(self) -> Policy:
        """The policy; it must take the state of Chen23b and return three gains.

        Raises:
            InputError: The file cannot be used.
        """
        shipped = shipped_policy(self.id)
        path = policy_path(self.options.policy) if self.options.policy else shipped
        policy, _ = load_policy(path)
        size, gains = policy.spec.observation_size, policy.spec.actions
        if size != STATE_SIZE or gains != GAINS or policy.spec.discrete:
            raise InputError(
                "not a policy that sets a follower's gains",
                file=path,
                field="policy",
                value=f"{size} observations, {gains} actions",
                allowed=f"{STATE_SIZE} observations, {GAINS} actions",
            )
        return policy

    def init(self, vehicle: Vehicle, period_s: float) -> Errors:
        """Read the policy; start with zero errors."""
        del period_s
        _ = self.policy
        zero = np.asarray(vehicle.mass_kg).dtype.type(0.0)
        return Errors(zero, zero)

    @no_type_check
    def choose_gains(self, observation: convoy.FollowerObservation) -> Gains:
        """Gains that the policy sets."""
        xp = namespace(observation.position_m, observation.gap_m)
        xp = np if xp is scalars else xp
        policy = self.policy
        return convoy.gains_of(
            policy_act(policy.spec, policy.params, convoy.chen2023b_state(observation), None, xp)
        )

    @no_type_check
    def act(self, memory: Errors, observation: convoy.FollowerObservation) -> tuple[Scalar, Errors]:
        """Set the gains by the policy and evaluate the PID."""
        return convoy.pid_step(observation, self.choose_gains(observation), memory)


@final
class DdpgPidFollow(AbstractGainFollower):
    """Baseline of Chen23b: gains by a policy trained with DDPG."""

    id = "ddpg_pid_follow"


@final
class SacPid(AbstractGainFollower):
    """Follower of Chen23b: gains by a policy trained with soft actor-critic."""

    id = "sac_pid"
