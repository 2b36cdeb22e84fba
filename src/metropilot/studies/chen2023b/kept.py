"""Parts of the study that take minutes, kept in its folder: an interrupted study goes on from there."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.drivers.learned import AbstractGainFollower


def kept(folder: Path, name: str, about: Mapping[str, Any], make: Callable[[], Any]) -> Any:  # noqa: ANN401
    """A value that JSON can hold: the one in the folder if it is of the very same part, else made now.

    Args:
        folder: Of the study's runs.
        name: Of the part, a file name without ending.
        about: Plain values that identify it; a change makes it anew.
        make: Makes it.
    """
    from metropilot._io import atomic_write

    path, wanted = folder / "parts" / f"{name}.json", json.loads(json.dumps(dict(about)))
    try:
        found = json.loads(path.read_text())
        if found["about"] == wanted:
            return found["value"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    value = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, lambda partial: partial.write_text(json.dumps({"about": wanted, "value": value})))
    return value


def identity(follower: AbstractFollower) -> str:
    """What a follower is: its id, and the weights of its policy if it has one."""
    if not isinstance(follower, AbstractGainFollower):
        return follower.id
    digest = sha256()
    for key, values in sorted(follower.policy.params.items()):
        digest.update(key.encode() + np.asarray(values).tobytes())
    return f"{follower.id} {digest.hexdigest()[:16]}"
