"""Campaigns as plain values: those published with the pages of the documentation, and jobs of this server."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from metropilot.campaign import (
    PUBLISHED,
    AbstractCampaign,
    CampaignRows,
    CampaignStore,
    campaign_from_values,
    campaign_of_folder,
    published_rows,
    rows_of_folder,
)
from metropilot.errors import InputError
from metropilot.railway import list_lines, parse_trainset
from metropilot.web.errors import Refused
from metropilot.web.schemas.requests import CampaignIn, body_of
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.work.campaigns import DECLARED, FOLDER, plain_rows


def campaign_list(service: Service) -> list[dict[str, Any]]:
    """Campaigns of this server, the newest first, then the published ones."""
    own = [_job_row(service, row) for row in service.store.jobs("campaign", limit=1000)]
    return own + [_published_row(name) for name in PUBLISHED]


def _job_row(service: Service, row: JobRow) -> dict[str, Any]:
    rows, done = _counts(service, row)
    told = {"id": row.id, "name": row.name or row.request["name"], "rows": rows, "done": done}
    return told | {"status": row.status, "words": row.words}


def _counts(service: Service, row: JobRow) -> tuple[int, int]:
    """Rows of a job's campaign, and those done; 0 of one that has not begun and whose upload is gone."""
    folder = service.root / "jobs" / row.id / FOLDER
    try:
        campaign = _kept_campaign(folder)
    except InputError:  # it has not begun
        with suppress(InputError):
            values = service.campaign_values(CampaignIn.model_validate(row.request))
            return campaign_from_values(DECLARED, values).rows, 0
        return 0, 0
    done = row.status == "done"
    return campaign.rows, campaign.rows if done else CampaignStore(folder, campaign).finished_rows()


@lru_cache(maxsize=1000)
def _kept_campaign(folder: Path) -> AbstractCampaign:
    """Campaign of a job's folder, which stays the same; reading it takes 10 ms and lists are read often."""
    return campaign_of_folder(folder)


def _published_row(name: str) -> dict[str, Any]:
    found = published_rows(name)
    rows = found.campaign.rows
    return {"id": name, "name": name, "rows": rows, "done": rows, "status": "done", "words": "published"}


def campaign_source(service: Service, key: str) -> CampaignRows:
    """Rows of a campaign.

    Args:
        service: Service of the server.
        key: Name of a published one, or id of a job.

    Raises:
        Refused: No such campaign, or nothing is computed yet (404).
    """
    if key in PUBLISHED:
        return published_rows(key)
    row = service.store.job(key)
    folder = service.root / "jobs" / row.id / FOLDER
    if row.kind != "campaign":
        raise Refused(f"the job is a {row.kind}", 404, field="id", value=key)
    try:
        return rows_of_folder(folder)
    except InputError:
        raise Refused("no row is computed yet", 404, field="id", value=key) from None


def campaign_out(service: Service, key: str) -> dict[str, Any]:
    """A campaign with its statistics.

    Raises:
        Refused: No such campaign, or nothing is computed yet (404).
    """
    found, ids = campaign_source(service, key), service.ids()
    row = _published_row(key) if key in PUBLISHED else _job_row(service, service.store.job(key))
    told = _statistics(found)
    return {
        **row,
        "rows": found.campaign.rows,
        "written": found.written,
        "matrix": found.campaign.matrix_words,
        "drivers": plain_rows(told["drivers"], ids),
        "cells": plain_rows(told["cells"], ids),
    }


def _statistics(found: CampaignRows) -> dict[str, Any]:
    try:
        return found.statistics()
    except InputError as error:
        raise Refused(error.message, 404, field="id", value=found.campaign.name) from None


def campaign_rows(
    service: Service,
    key: str,
    wanted: Mapping[str, str] | None = None,
    **order: Any,  # noqa: ANN401
) -> dict[str, Any]:
    """Rows of a campaign.

    Args:
        service: Service of the server.
        key: The campaign.
        wanted: Value by column, as text.
        order: ``sort, ascending, limit, offset`` of :meth:`metropilot.campaign.CampaignRows.find`.

    Raises:
        MetropilotError: No such campaign or column.
    """
    ids = service.ids()
    files = {key: path for path, key in ids.items()}
    given = {name: files.get(value, value) for name, value in (wanted or {}).items()}
    count, rows = campaign_source(service, key).find(given, **order)
    return {"count": count, "rows": plain_rows(rows, ids)}


def row_request(service: Service, key: str, number: int) -> dict[str, Any]:
    """A row of a campaign as the request of a drive.

    Raises:
        MetropilotError: No such campaign or row.
    """
    spec, ids = campaign_source(service, key).request(number), service.ids()
    trainset = parse_trainset(spec.trainset)
    trainset = trainset._replace(id=ids.get(trainset.id, trainset.id))
    line = spec.line if spec.line in list_lines() else ids.get(spec.line, Path(spec.line).name)
    options = {name: ids.get(str(value), value) for name, value in spec.options.items()}
    return body_of(replace(spec, line=line, trainset=str(trainset), options=options)).model_dump()
