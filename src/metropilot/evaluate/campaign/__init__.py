"""Campaigns: a declared matrix of runs, driven on one machine or a cluster, resumable, reported."""

from metropilot.evaluate.campaign.declared import Campaign, Case, Disturbance
from metropilot.evaluate.campaign.run import Progress, run_campaign
from metropilot.evaluate.campaign.shipped import read_campaign, shipped_campaigns
from metropilot.evaluate.campaign.summary import summarise

__all__ = [
    "Campaign",
    "Case",
    "Disturbance",
    "Progress",
    "read_campaign",
    "run_campaign",
    "shipped_campaigns",
    "summarise",
]
