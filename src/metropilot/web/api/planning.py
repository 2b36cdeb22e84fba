"""Routes of sections, plans, fronts and journeys, which are answered directly."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from metropilot.web.schemas.requests import JourneyIn, PlanIn, PlantPlanIn, SectionIn
from metropilot.web.schemas.responses import FrontOut, JourneyOut, PlansOut, SectionOut
from metropilot.web.service import Service


def routes(service: Service) -> APIRouter:
    """Make the routes of planning."""
    router = APIRouter(tags=["planning"])

    @router.post("/section", response_model=SectionOut)
    async def section(body: SectionIn) -> dict[str, Any]:
        """A section for a trainset, with the minimum running time."""
        return await service.section(body)

    @router.post("/plan", response_model=PlansOut)
    async def plan(body: PlantPlanIn) -> dict[str, Any]:
        """The energy-optimal plan with its certificate; with a disturbance that of the true plant, too."""
        return await service.plan(body)

    @router.post("/front", response_model=FrontOut)
    async def front(body: PlanIn) -> dict[str, Any]:
        """Optimal energy from 1.02 to 1.6 of the minimum running time; ``time_s`` is not used."""
        return await service.front(body)

    @router.post("/journey", response_model=JourneyOut)
    async def journey(body: JourneyIn) -> dict[str, Any]:
        """A journey that calls at every station; with ``total_s`` its reserve is spread optimally."""
        return await service.journey(body.model_dump())

    return router
