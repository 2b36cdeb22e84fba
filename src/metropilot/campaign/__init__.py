"""Campaigns: a declared matrix of runs, driven on one machine or a cluster, resumable, with a report."""

from metropilot.campaign.declared import Campaign, CampaignCase, DisturbanceCase
from metropilot.campaign.rows import RESULTS
from metropilot.campaign.run import CampaignProgress, run_campaign
from metropilot.campaign.shipped import read_campaign, shipped_campaigns
from metropilot.campaign.summary import summarise

__all__ = [
    "RESULTS",
    "Campaign",
    "CampaignCase",
    "CampaignProgress",
    "DisturbanceCase",
    "read_campaign",
    "run_campaign",
    "shipped_campaigns",
    "summarise",
]
