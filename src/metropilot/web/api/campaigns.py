"""Routes of campaigns: statistics and rows of the published ones and of those of this server."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from metropilot.web import evidence
from metropilot.web.api.catalogue import Key
from metropilot.web.api.jobs import add_job
from metropilot.web.schemas.requests import DriveIn
from metropilot.web.schemas.responses import CampaignOut, CampaignRow, CampaignRowsOut
from metropilot.web.service import Service

Column = Annotated[str, Query(pattern=r"^[a-z0-9_]{1,40}$")]
Value = Annotated[str | None, Query(max_length=80)]


def routes(service: Service) -> APIRouter:
    """Make the routes of campaigns."""
    router = APIRouter(tags=["campaigns"])

    words = "Compute a campaign of drives, declared as in its TOML file; stopped and resumed like learning."
    add_job(router, service, "campaign", words)

    @router.get("/campaigns", response_model=list[CampaignRow])
    def campaigns() -> list[dict[str, Any]]:
        """Campaigns of this server and the published ones: leaderboard, robustness, trainsets."""
        return evidence.campaign_list(service)

    @router.get("/campaigns/{campaign_id}", response_model=CampaignOut)
    def summary(campaign_id: Key) -> dict[str, Any]:
        """A campaign with statistics by driver, and by driver and disturbance; also while it is computed."""
        return evidence.campaign_out(service, campaign_id)

    @router.get("/campaigns/{campaign_id}/rows", response_model=CampaignRowsOut)
    def rows(  # noqa: PLR0913 (each a parameter of the query)
        campaign_id: Key,
        *,
        driver: Value = None,
        disturbance: Value = None,
        outcome: Value = None,
        line: Value = None,
        trainset: Value = None,
        load: Value = None,
        success: bool | None = None,
        sort: Column = "row",
        ascending: bool = True,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
        offset: Annotated[int, Query(ge=0, lt=2**31)] = 0,
    ) -> dict[str, Any]:
        """Rows of a campaign, sorted by a column of `results.parquet`."""
        given = {"driver": driver, "disturbance": disturbance, "outcome": outcome, "line": line}
        given |= {"trainset": trainset, "load": load}
        given |= {"success": None if success is None else str(success).lower()}
        wanted = {name: value for name, value in given.items() if value is not None}
        order = {"sort": sort, "ascending": ascending, "limit": limit, "offset": offset}
        return evidence.campaign_rows(service, campaign_id, wanted, **order)

    @router.get("/campaigns/{campaign_id}/rows/{row}", response_model=DriveIn)
    def row_request(campaign_id: Key, row: Annotated[int, Path(ge=0, lt=2**31)]) -> dict[str, Any]:
        """A row as the request of a drive, to be driven again by `POST /api/jobs/drive`."""
        return evidence.row_request(service, campaign_id, row)

    return router
