"""Routes of fits: a trainset from uploaded logs, and where it is saved."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from metropilot.web import catalogue
from metropilot.web.api.catalogue import Key
from metropilot.web.schemas.requests import FitIn, FitSaveIn
from metropilot.web.schemas.responses import FitOut, JobOut, SavedOut
from metropilot.web.service import Service
from metropilot.web.store import JobRow


def routes(service: Service) -> APIRouter:
    """Make the routes of fits."""
    router = APIRouter(tags=["fits"])

    @router.post("/jobs/fit", response_model=JobOut, status_code=202)
    def fit(body: FitIn) -> JobRow:
        """Fit a trainset to uploaded logs; logs that do not determine it fail with the reason."""
        return service.store.job(service.submit(body))

    @router.get("/jobs/{job_id}/fit", response_model=FitOut)
    def fit_result(job_id: Key) -> Any:  # noqa: ANN401 (validated by the model)
        """Result of a fit: parameters with intervals, what cannot be told apart, residuals."""
        return catalogue.result_of(service, job_id, ("fit",))

    @router.post("/jobs/{job_id}/fit/trainset", response_model=SavedOut, status_code=201)
    async def save_fit(job_id: Key, body: FitSaveIn) -> dict[str, Any]:
        """Save the fitted trainset as a new entry, or as the next version of an own trainset."""
        key, version = await service.save_fit(job_id, body.upload)
        return {"id": key, **vars(version)}

    return router
