"""List of live runs, by which a run can be found again after its page was left."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from nicegui import ui

from metropilot.web.pages.frame import Problem, card, clock, empty
from metropilot.web.service import ABANDONED_S, Service
from metropilot.web.store import JobRow

EVERY_S = 2.0


class RunList:
    """Running and resumable live runs, refreshed while the page is open.

    Args:
        service: Service of the server.
        run: Id of the run of this page.
    """

    def __init__(self, service: Service, run: str | None) -> None:
        self.service = service
        self.run = run
        self.shown: list[tuple[Any, ...]] | None = None

    def build(self) -> None:
        """Place the list."""
        with card("Live runs", f"One that no viewer for {ABANDONED_S / 60:g} min is stopped.", late=True):
            self.problem = Problem()
            self.rows = ui.element("div").classes("mp-stack").props('data-test="runs"')
        self.refresh()
        ui.timer(EVERY_S, self.refresh)

    def refresh(self) -> None:
        """Draw the rows anew where one has changed, else only the times."""
        found = self.service.live_runs()
        shown = [(row.id, row.status, row.words) for row in found]
        if shown != self.shown:
            self.shown = shown
            self.rows.clear()
            with self.rows:
                self.words = {row.id: self.row(row) for row in found}
                if not found:
                    empty("No run is under way.")
        for row in found:
            self.words[row.id].text = self.state(row)

    def state(self, row: JobRow) -> str:
        """Describe the state of a run."""
        session = self.service.sessions.get(row.id)
        if session is None or session.over:
            return f"{row.status}: {row.words}" if row.words else f"{row.status}; it can be resumed"
        known = session.known
        watched = f" · {session.viewers} watching" if session.viewers else " · no viewer"
        lever = "" if known.lever is None else f" · lever: {known.lever['holder']}"
        return f"{clock(known.time_s)} · {f'{known.pace:g} ×' if known.pace else 'waiting'}{watched}{lever}"

    def row(self, row: JobRow) -> ui.label:
        """Place the row of a run; return the label of its state."""
        convoy = "follower" in row.request
        body, path = row.request, f"/convoy?run={row.id}" if convoy else f"/?run={row.id}"
        what = f"convoy of {body['trainsets']}" if convoy else body["driver"]
        name = f"{body['origin']} – {body['destination']} · {what}"
        if body["time_s"] is not None:
            name += f" · {body['time_s']:g} s"
        with ui.element("div").classes("mp-run").props(f'data-run="{row.id}" data-status="{row.status}"'):
            ui.label(name + (" (this one)" if row.id == self.run else ""))
            words = ui.label("").classes("mp-soft")
            with ui.element("div").classes("mp-links"):
                if row.status == "running":
                    ui.link("Open", path).props(f'aria-label="Open {name}"')
                    self.button("Stop", name, partial(self.stop, row.id))
                else:
                    ui.link("Show", path).props(f'aria-label="Show {name}"')
                    self.button("Resume", name, partial(self.resume, row.id, path))
        return words

    @staticmethod
    def button(words: str, name: str, act: Callable[[], Awaitable[None]]) -> None:
        """Place a small button of a row."""
        ui.button(words, on_click=act).props(f'flat dense no-caps aria-label="{words} {name}"')

    async def stop(self, run: str) -> None:
        """Stop a run; it can be resumed."""
        with self.problem.show_errors():
            await self.service.session(run).stop()

    async def resume(self, run: str, path: str) -> None:
        """Resume a run and open it."""
        # Until it is ready the list may be drawn anew: this button, and what belongs to it, is gone by then.
        client = ui.context.client
        with self.problem.show_errors():
            await self.service.resume_live(run)
            client.open(path)
