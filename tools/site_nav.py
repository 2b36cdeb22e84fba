"""The site's navigation, made while it is built: a new page appears under *More* by itself.

A hook of mkdocs (``hooks`` in mkdocs.yml). A page is named by its first heading.
"""

from fnmatch import fnmatch
from pathlib import Path
from typing import Any

SECTIONS = {
    "Start": ("index.md", "tutorial.md"),
    "How to": ("howto/index.md", "howto/*.md"),
    "Theory": (
        "physics.md",
        "planning.md",
        "task.md",
        "tracking.md",
        "learning.md",
        "convoy.md",
        "line.md",
        "fit.md",
    ),
    "Reference": ("drivers.md", "kpis.md", "formats.md", "console.md", "campaigns.md", "api.md"),
    "Evidence": (
        "safety.md",
        "validation.md",
        "optimal-driver.md",
        "learned-driver.md",
        "generalist.md",
        "robustness.md",
        "trainsets.md",
        "leaderboard.md",
        "robustness-testing.md",
        "benchmarks.md",
    ),
    "Studies": ("studies/*.md",),
    "Design": ("design.md", "decisions/index.md", "decisions/*.md"),
}


def navigation(pages: list[str]) -> list[dict[str, list[str]]]:
    """Every page once, in the first section that names it, in the section's order.

    Args:
        pages: Paths below the documentation's folder.
    """
    left, found = sorted(pages), []
    for title, patterns in SECTIONS.items():
        here = []
        for pattern in patterns:
            here += [page for page in left if fnmatch(page, pattern)]
            left = [page for page in left if page not in here]
        if here:
            found.append({title: here})
    return [*found, {"More": left}] if left else found


def on_config(config: Any) -> Any:  # noqa: ANN401 (mkdocs' configuration)
    """Called by mkdocs once its configuration is read."""
    folder = Path(config["docs_dir"])
    config["nav"] = navigation([path.relative_to(folder).as_posix() for path in folder.rglob("*.md")])
    return config
