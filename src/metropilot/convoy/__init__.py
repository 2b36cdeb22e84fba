"""Virtually coupled trainsets: model, link, environment, followers, rollout, key figures."""

from metropilot.convoy.drivers import FOLLOWERS, AbstractFollower
from metropilot.convoy.env import ConvoyTask, ConvoyTaskConfig
from metropilot.convoy.kpis import ConvoyKpis, MemberKpis, convoy_kpis
from metropilot.convoy.link import Link
from metropilot.convoy.model import Convoy
from metropilot.convoy.request import ConvoyRequest
from metropilot.convoy.rollout import ConvoyDrive, ConvoyRollout, HeadRun, drive_convoy

__all__ = [
    "FOLLOWERS",
    "AbstractFollower",
    "Convoy",
    "ConvoyDrive",
    "ConvoyKpis",
    "ConvoyRequest",
    "ConvoyRollout",
    "ConvoyTask",
    "ConvoyTaskConfig",
    "HeadRun",
    "Link",
    "MemberKpis",
    "convoy_kpis",
    "drive_convoy",
]
