"""Campaigns by file or by the name of one that ships."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metropilot.campaign.declared import Campaign
from metropilot.errors import InputError

FOLDER = Path(__file__).parent / "files"


def shipped_campaigns() -> tuple[str, ...]:
    """Names of the campaigns that ship."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def read_campaign(name_or_path: str, drivers: str | None = None) -> Campaign:
    """A campaign by the name of one that ships, or by its file.

    Args:
        name_or_path: Name of a campaign that ships, or path of a TOML file.
        drivers: Drivers to run instead of the file's own, separated by commas.

    Raises:
        InputError: No such campaign, or something in it cannot be used.
    """
    from metropilot.campaign.reading import campaign_from_toml
    from metropilot.evaluate import make_driver

    path = FOLDER / f"{name_or_path}.toml" if name_or_path in shipped_campaigns() else Path(name_or_path)
    if not path.exists():
        allowed = f"a TOML file, or one of {', '.join(shipped_campaigns())}"
        raise InputError("no such campaign", field="campaign", value=name_or_path, allowed=allowed)
    campaign = campaign_from_toml(path)
    if drivers is None:
        return campaign
    names = tuple(dict.fromkeys(word.strip() for word in drivers.split(",") if word.strip()))
    if not names:
        raise InputError("no driver given", field="drivers", value=drivers)
    for name in names:
        make_driver(name)
    return replace(campaign, drivers=names)
