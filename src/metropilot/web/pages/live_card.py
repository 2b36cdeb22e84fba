"""Session, pace, events, list of news and result at the end: what the cards of live runs share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from nicegui import events, ui

from metropilot.web.errors import Refused
from metropilot.web.live.session import Session
from metropilot.web.pages.frame import for_users, prop_of
from metropilot.web.service import LiveBody, Service
from metropilot.web.words.language import _, translate_each


class AbstractLiveCard(ABC):
    """A card, or page, with a live run that is started, asked and watched.

    Attributes:
        idle: Refusal where no run is under way.
        service: Service of the server.
        run: Id of the run; None without one.
        pace: Field of its pace.
    """

    idle: str
    service: Service
    run: str | None
    pace: ui.select

    def build_pace(self, paces: Mapping[int, str], first: int) -> ui.select:
        """Place the field of the pace."""
        words = translate_each(paces)
        self.pace = ui.select(words, value=first, label=_("Pace"), on_change=self.change_pace)
        return for_users(self.pace)

    @staticmethod
    def build_log(name: str) -> None:
        """Place the list of news, which the browser fills."""
        log = ui.element("ul").classes("mp-log").props('data-mp="log" aria-live=polite')
        log.props(prop_of("aria-label", name))

    @abstractmethod
    async def change_pace(self) -> None:
        """Send the pace of the field."""

    @abstractmethod
    def show_summary(self, run: str, found: dict[str, Any]) -> None:
        """Show the result of a run."""

    def session(self) -> Session | None:
        """Session of the run, None if the server has none."""
        return self.service.sessions.get(self.run or "")

    def live(self) -> Session | None:
        """Session of the run while it waits or runs, else None."""
        session = self.session()
        return session if session is not None and not session.over else None

    def under_way(self) -> Session:
        """Session of the run that waits or runs.

        Raises:
            Refused: There is none.
        """
        session = self.live()
        if session is None:
            raise Refused(self.idle, 409)
        return session

    async def go_live(self, body: LiveBody) -> Session:
        """Start a run in the place of the one under way, which is stopped where nobody else watches it."""
        before = self.live()
        if before is not None and before.viewers <= 1:
            await before.stop()
        session = await self.service.go_live(body)
        self.run = session.id
        return session

    async def ask(self, event: dict[str, Any]) -> None:
        """Send the run an event.

        Raises:
            MetropilotError: There is no run, or the event is not possible.
        """
        await self.under_way().ask(event)

    async def send_pace(self, pace: float) -> None:
        """Send a pace to the run, if there is one that does not wait."""
        session = self.live()
        if session is not None and not session.waiting:
            await session.ask({"kind": "pace", "pace": pace})

    def show_result(self, event: events.GenericEventArguments) -> None:
        """Show the result; taken from the session, not from the browser."""
        del event
        session = self.session()
        if session is not None and session.summary is not None:
            self.show_summary(session.id, session.summary)
