"""Routes of live runs: start, watch, send timetable updates, drive manually."""

from __future__ import annotations

from collections.abc import AsyncIterator
from time import monotonic
from typing import Annotated, Any

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from metropilot.web import catalogue
from metropilot.web.api.catalogue import Key
from metropilot.web.live.session import Session
from metropilot.web.schemas import requests, responses
from metropilot.web.service import Service

STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Server-sent events, numbered: `place` (in the queue, while it waits), `scene` "
        "(track, permitted speed, plan, names of the columns), `rows` (one a control period), `event` (in "
        "words), `result` (KPIs), `error`, `end`. "
        "In a scene, `plan` leads from where the trainset was when it was made to the stop; `reference` "
        "leads from departure to the stop for what is in force now, and a run's energy is compared with it: "
        "`plan_energy_wheel_j` of a row is what it has used at that position. "
        "`Last-Event-ID` goes on from there; without it the stream begins at departure.",
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
    }
}


def live_out(session: Session) -> dict[str, Any]:
    """A live run at a glance."""
    about = {name: getattr(session, name) for name in ("id", "user", "request", "viewers")}
    return vars(session.known) | about


def routes(service: Service) -> APIRouter:
    """Make the routes of live runs and live convoys."""
    router = APIRouter(tags=["live"])

    async def tell(live_id: str, kind: str, body: requests.RequestBody) -> dict[str, Any]:
        at = await service.session(live_id).ask({"kind": kind, **body.model_dump()})
        return {"id": live_id, "at_s": at}

    def add_event(kind: str, body: type[requests.RequestBody], words: str) -> None:
        async def send(live_id: Key, body: Any) -> dict[str, Any]:  # noqa: ANN401 (the body of the kind)
            return await tell(live_id, kind, body)

        send.__annotations__["body"] = body
        told: dict[str, Any] = {"name": kind, "description": words}
        router.post(f"/live/{{live_id}}/{kind}", response_model=responses.EventOut, **told)(send)

    @router.post("/live", response_model=responses.LiveOut, status_code=201)
    async def start(body: requests.LiveIn) -> dict[str, Any]:
        """Start a live run; one that is `queued` waits at `place` of the queue and starts by itself."""
        return live_out(await service.go_live(body))

    @router.post("/convoys", response_model=responses.LiveOut, status_code=201)
    async def convoy(body: requests.ConvoyIn) -> dict[str, Any]:
        """Start a live convoy; watched, paced and stopped like any live run."""
        return live_out(await service.go_live(body))

    @router.post("/running-lines", response_model=responses.LiveOut, status_code=201)
    async def running_line(body: requests.RunningLineIn) -> dict[str, Any]:
        """Start a running line with all its trains; watched, paced and stopped like any live run.

        A row has the place and the delay of every train, the energy of all since the beginning and its floor.
        """
        return live_out(await service.go_live(body))

    @router.get("/live/{live_id}/line", response_model=responses.RunningLineOut)
    def line_result(live_id: Key) -> Any:  # noqa: ANN401 (validated by the model)
        """Result of a running line that has come to its end."""
        return catalogue.result_of(service, live_id, ("running",))

    add_event("hold", requests.NewHold, "Hold the next train of a running line that departs from a station.")
    words = "Restrict the speed of a section of a running line for trains that depart from now on."
    add_event("slow", requests.NewSlowSection, words)
    words = "Change delay, jitter and loss of the link of a convoy, or silence it."
    add_event("link", requests.NewLink, words)

    @router.post("/live/{live_id}/emergency", response_model=responses.EventOut)
    async def emergency(live_id: Key) -> dict[str, Any]:
        """Let the head of a convoy make an emergency brake."""
        return await tell(live_id, "emergency", requests.RequestBody())

    @router.get("/live", response_model=list[responses.LiveOut])
    async def runs() -> list[dict[str, Any]]:
        """Live runs of this server, the oldest first."""
        return [live_out(session) for session in service.sessions.values()]

    @router.get("/live/{live_id}", response_model=responses.LiveOut)
    async def one(live_id: Key) -> dict[str, Any]:
        """A live run. A request counts as a viewer; a live run without viewers for 2 min is stopped."""
        session = service.session(live_id)
        session.seen_at = monotonic()
        return live_out(session)

    @router.get("/live/{live_id}/stream", response_class=StreamingResponse, responses=STREAM)
    async def stream(
        live_id: Key, last_event_id: Annotated[int | None, Header(ge=0, le=10**9)] = None
    ) -> StreamingResponse:
        """Watch a live run. The number and speed of its viewers do not delay it."""
        session = service.session(live_id)
        body: AsyncIterator[bytes] = session.listen(-1 if last_event_id is None else last_event_id)
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(body, media_type="text/event-stream", headers=headers)

    add_event("arrival", requests.NewArrival, "Send the driver a new arrival time.")
    add_event("restriction", requests.NewRestriction, "Add a temporary speed restriction on the track ahead.")
    add_event(
        "lever",
        requests.Lever,
        "Drive manually under protection; without renewal within 3 s the driver takes over.\n\n"
        "The lever has one holder. A second one is refused (409); the message names the first.",
    )
    add_event("pace", requests.Pace, "Change the pace of the run: 1 is real time, 0 pauses it.")

    @router.post("/live/{live_id}/step", response_model=responses.EventOut)
    async def step(live_id: Key) -> dict[str, Any]:
        """Pause the run and simulate one second of it; a pace other than 0 lets it go on."""
        return await tell(live_id, "step", requests.RequestBody())

    @router.post("/live/{live_id}/stop", response_model=responses.EventOut)
    async def stop(live_id: Key) -> dict[str, Any]:
        """End a live run, or take it out of the queue; it can be resumed."""
        return {"id": live_id, "at_s": await service.session(live_id).stop()}

    @router.post("/live/{live_id}/resume", response_model=responses.LiveOut, status_code=201)
    async def resume(live_id: Key) -> dict[str, Any]:
        """Resume a live run that was stopped or that a restart interrupted, from where it was."""
        return live_out(await service.resume_live(live_id))

    return router
