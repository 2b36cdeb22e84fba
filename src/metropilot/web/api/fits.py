"""Routes of fits: a trainset from uploaded logs, and where it is saved."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from metropilot.web.api.catalogue import Key
from metropilot.web.api.jobs import add_job, add_result
from metropilot.web.schemas.requests import FitSaveIn
from metropilot.web.schemas.responses import SavedOut
from metropilot.web.service import Service


def routes(service: Service) -> APIRouter:
    """Make the routes of fits."""
    router = APIRouter(tags=["fits"])

    words = "Fit a trainset to uploaded logs; logs that do not determine it fail with the reason."
    add_job(router, service, "fit", words)
    words = "Result of a fit: parameters with intervals, what cannot be told apart, residuals."
    add_result(router, service, "fit", words)

    @router.post("/jobs/{job_id}/fit/trainset", response_model=SavedOut, status_code=201)
    async def save_fit(job_id: Key, body: FitSaveIn) -> dict[str, Any]:
        """Save the fitted trainset as a new entry, or as the next version of an own trainset."""
        key, version = await service.save_fit(job_id, body.upload)
        return {"id": key, **vars(version)}

    return router
