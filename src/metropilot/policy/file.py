"""A learned policy as one file, NAME.safetensors, all that is known about it as one JSON string inside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from metropilot._tensors import read_tensors, write_tensors
from metropilot.errors import InputError
from metropilot.policy.networks import ACTIVATIONS, OUTPUTS, Policy, PolicySpec

FORMAT = 1
SHIPPED = Path(__file__).parent / "shipped"
MAX_BYTES = 64 << 20
MAX_WIDTH = 16_384
MAX_LAYERS = 16


def shipped_policy(driver_id: str) -> Path:
    """Path of the policy file shipped for a driver or follower, whether there is one or not."""
    return SHIPPED / f"{driver_id}.safetensors"


def save_policy(path: Path, policy: Policy, metadata: Mapping[str, Any]) -> None:
    """Write a policy; equal policies give equal bytes.

    Args:
        path: NAME.safetensors.
        policy: Of one seed.
        metadata: Plain values: task, observer, action, algorithm, seed, KPIs, provenance.

    Raises:
        InputError: The file cannot be written, or would not be read again.
    """
    arrays = {name: np.asarray(value, np.float32) for name, value in policy.params.items()}
    _check(path, policy.spec, arrays)
    write_tensors(path, arrays, {"format": FORMAT, "policy": policy.spec.as_dict(), "about": dict(metadata)})


def load_policy(path: str | Path) -> tuple[Policy, dict[str, Any]]:
    """Read a policy and what is known about it; nothing in the file is executed.

    Raises:
        InputError: The file cannot be read, is damaged, or does not fit what it says of itself.
    """
    path = Path(path)
    arrays, metadata = read_tensors(path, MAX_BYTES)
    if metadata.get("format") != FORMAT:
        raise InputError(
            "unknown format", file=path, field="format", value=metadata.get("format"), allowed=str(FORMAT)
        )
    about = metadata.get("about")
    spec = _spec(path, metadata.get("policy"))
    _check(path, spec, arrays)
    return Policy(spec, arrays), about if isinstance(about, dict) else {}


def _spec(path: Path, found: object) -> PolicySpec:
    """The description, every field checked."""
    if not isinstance(found, dict):
        raise InputError("does not describe its policy", file=path, field="policy")
    choices = {"output": OUTPUTS, "activation": ACTIVATIONS}
    for name, allowed in choices.items():
        if found.get(name) not in allowed:
            value, shown = repr(found.get(name))[:50], ", ".join(allowed)
            raise InputError("unknown choice", file=path, field=name, value=value, allowed=shown)
    if type(found.get("normalised")) is not bool:
        raise InputError("not true or false", file=path, field="normalised")
    hidden = found.get("hidden")
    if not isinstance(hidden, list) or len(hidden) > MAX_LAYERS:
        raise InputError("not a list of widths", file=path, field="hidden", allowed=f"at most {MAX_LAYERS}")
    counts = {name: found.get(name) for name in ("observation_size", "actions", "width")}
    for name, value in [*counts.items(), *(("hidden", width) for width in hidden)]:
        if type(value) is not int or not 1 <= value <= MAX_WIDTH:
            allowed = f"1 to {MAX_WIDTH}"
            raise InputError("out of range", file=path, field=name, value=repr(value)[:50], allowed=allowed)
    if set(found) != set(PolicySpec.__dataclass_fields__) or found["actions"] > found["width"]:
        raise InputError("does not describe its policy", file=path, field="policy")
    fields: dict[str, Any] = {**found, "hidden": tuple(hidden)}
    return PolicySpec(**fields)


def _check(path: Path, spec: PolicySpec, arrays: Mapping[str, np.ndarray]) -> None:
    """Every array that the description asks for, with its shape and type, finite, and no other."""
    shapes = spec.shapes()
    for name in sorted(set(shapes) ^ set(arrays)):
        words = "array is missing" if name in shapes else "array does not belong here"
        raise InputError(words, file=path, field=name[:100])
    for name, shape in shapes.items():
        array = arrays[name]
        if array.shape != shape or array.dtype != np.float32:
            found, allowed = f"{array.dtype} {array.shape}", f"float32 {shape}"
            raise InputError(
                "array has the wrong shape or type", file=path, field=name, value=found, allowed=allowed
            )
        if not np.isfinite(array).all():
            raise InputError("array has numbers that are not finite", file=path, field=name)
