"""Campaigns: a declared matrix of runs, driven on one machine or a cluster, resumable, with a report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.campaign.declared import Campaign, CampaignCase, DisturbanceCase, case_request
    from metropilot.campaign.leaderboard import write_leaderboard
    from metropilot.campaign.page import RESULTS_FILE, collect_parts, summarise, write_campaign_report
    from metropilot.campaign.reading import campaign_from_toml, read_campaign, shipped_campaigns
    from metropilot.campaign.rows import RESULTS, drive_shard, peak_memory_mb
    from metropilot.campaign.run import CampaignProgress, run_campaign
    from metropilot.campaign.store import DONE_FILE, TIMINGS_FOLDER, CampaignStore, stored_campaign

__all__ = [
    "DONE_FILE",
    "RESULTS",
    "RESULTS_FILE",
    "TIMINGS_FOLDER",
    "Campaign",
    "CampaignCase",
    "CampaignProgress",
    "CampaignStore",
    "DisturbanceCase",
    "campaign_from_toml",
    "case_request",
    "collect_parts",
    "drive_shard",
    "peak_memory_mb",
    "read_campaign",
    "run_campaign",
    "shipped_campaigns",
    "stored_campaign",
    "summarise",
    "write_campaign_report",
    "write_leaderboard",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "declared": (
            "Campaign",
            "CampaignCase",
            "DisturbanceCase",
            "case_request",
        ),
        "leaderboard": ("write_leaderboard",),
        "page": (
            "RESULTS_FILE",
            "collect_parts",
            "summarise",
            "write_campaign_report",
        ),
        "reading": (
            "campaign_from_toml",
            "read_campaign",
            "shipped_campaigns",
        ),
        "rows": (
            "RESULTS",
            "drive_shard",
            "peak_memory_mb",
        ),
        "run": (
            "CampaignProgress",
            "run_campaign",
        ),
        "store": (
            "CampaignStore",
            "DONE_FILE",
            "TIMINGS_FOLDER",
            "stored_campaign",
        ),
    },
)
