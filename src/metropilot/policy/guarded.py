"""A policy file as a driver takes it: the policy, guarded, and what it sees and means by its actions."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from metropilot._dirs import runs_folder
from metropilot._typing import Bool, Float, Num
from metropilot.env import PolicyInterface
from metropilot.errors import InputError
from metropilot.policy.file import load_policy
from metropilot.policy.networks import Policy, choose_action, network_output

POLICY_FILE = "policy.safetensors"
"""Name of the policy in the folder of a learning run."""


@final
class GuardedPolicy:
    """A policy from somebody's file: what it answers is a number in range, or an error.

    Args:
        policy: The policy.
        path: Its file, for error messages.
    """

    def __init__(self, policy: Policy, path: Path) -> None:
        self.policy = policy
        self.path = path

    def __call__(
        self, observation: Float[np.ndarray, " features"], mask: Bool[np.ndarray, " choices"] | None = None
    ) -> Num[np.ndarray, "*actions"] | np.integer:
        """The action for one observation, among the choices that a mask allows.

        Raises:
            InputError: The observation is not as long as the policy's, or the answer is not finite.
        """
        spec = self.policy.spec
        if observation.size != spec.observation_size:
            raise InputError(
                "the features do not give as many numbers as the policy takes",
                file=self.path,
                field="perception.features",
                value=observation.size,
                allowed=str(spec.observation_size),
            )
        with np.errstate(all="ignore"):
            output = network_output(spec, self.policy.params, observation, np)
        if not np.isfinite(output).all():
            raise InputError("the policy answers what is not a number", file=self.path, field="policy")
        return choose_action(spec, output, mask, np)


@dataclass(frozen=True)
class LoadedPolicy:
    """A policy file, read and checked.

    Attributes:
        policy: From an observation to an action.
        interface: Its features, the meaning of its actions, its assists.
        about: Further facts that the file gives: task, algorithm, seed, KPIs, provenance.
        path: The file.
    """

    policy: GuardedPolicy
    interface: PolicyInterface
    about: Mapping[str, Any]
    path: Path


def policy_path(given: str | Path) -> Path:
    """The policy file that is meant: the file itself, or that of a learning run by its folder or its id.

    Raises:
        InputError: The learning run has not ended.
    """
    path = Path(given)
    if not path.exists() and path.name == str(given) and (runs_folder() / path).is_dir():
        path = runs_folder() / path
    if not path.is_dir():
        return path
    if not (path / POLICY_FILE).exists() and (status := _learning_status(path)):
        allowed = f"done, after metropilot learn --resume {path}"
        raise InputError(
            "the learning run has no policy yet", file=path, field="status", value=status, allowed=allowed
        )
    return path / POLICY_FILE


def _learning_status(folder: Path) -> str:
    """Status in the record of a learning run's folder; empty of any other folder."""
    try:
        record = tomllib.loads((folder / "run.toml").read_text("utf-8"))
    except (OSError, ValueError):
        return ""
    return str(record["status"]) if {"algorithm", "status"} <= record.keys() else ""


def load_driving_policy(given: str | Path) -> LoadedPolicy:
    """Read the policy of a driver.

    Args:
        given: A policy file, or the folder or id of a learning run.

    Raises:
        InputError: The file cannot be read, is damaged, does not say how to drive with it, or says what does
            not fit its network.
    """
    path = policy_path(given)
    policy, about = load_policy(path)
    if "perception" not in about:
        raise InputError("does not say what the policy sees", file=path, field="perception")
    interface = PolicyInterface.from_dict(about["perception"], file=path)
    space, spec = interface.action.space, policy.spec
    if (space.discrete, space.count or space.size) != (spec.discrete, spec.actions):
        wanted = f"{space.count} choices" if space.discrete else f"{space.size} numbers"
        value = f"{spec.actions} {'choices' if spec.discrete else 'numbers'}"
        raise InputError(
            "the policy's output is not the action's", file=path, field="policy", value=value, allowed=wanted
        )
    return LoadedPolicy(GuardedPolicy(policy, path), interface, about, path)
