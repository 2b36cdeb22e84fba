"""Folders of the user's files: learning runs, and results that can be computed again."""

from __future__ import annotations

import os
from pathlib import Path

HOME = "METROPILOT_HOME"


def runs_folder() -> Path:
    """Folder of the learning runs: ``$METROPILOT_HOME/runs``, else in the platform's data folder."""
    return _home("runs")


def cache_folder() -> Path:
    """Folder of what can be computed again: ``$METROPILOT_HOME/cache``, else the platform's cache folder."""
    return _home("cache")


def _home(kind: str) -> Path:
    home = os.environ.get(HOME)
    if home:
        return Path(home).expanduser() / kind
    from platformdirs import user_cache_path, user_data_path

    return user_cache_path("metropilot") if kind == "cache" else user_data_path("metropilot") / kind
