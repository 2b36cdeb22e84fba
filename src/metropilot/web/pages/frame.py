"""What every page has: head, navigation, light and dark; and small parts used on several."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from fastapi import Request
from nicegui import Client, ui
from nicegui.slot import Slot

from metropilot.errors import MetropilotError
from metropilot.web.refusals import detail_of

PAGES = (
    ("/", "Drive"),
    ("/compare", "Compare"),
    ("/journey", "Journey"),
    ("/convoy", "Convoy"),
    ("/learn", "Learn"),
    ("/lines", "Lines"),
)
THEME = "metropilot_theme"
THEMES = {"auto": None, "light": False, "dark": True}
HEAD = (
    '<link rel="stylesheet" href="/static/console.css">'
    '<script src="/static/live.js" defer></script><script src="/static/convoy.js" defer></script>'
)
NEXT_THEME = {"auto": "light", "light": "dark", "dark": "auto"}


@contextmanager
def frame(request: Request, active: str) -> Iterator[None]:
    """A page: everything inside is its main part. What is under way for it ends with it."""
    ui.context.client.on_delete(_end_with)
    theme = request.cookies.get(THEME, "auto")
    theme = theme if theme in THEMES else "auto"
    ui.dark_mode(THEMES[theme])
    ui.colors(primary="#0072b2", positive="#00785a", negative="#b84300", warning="#b84300")
    ui.add_head_html(HEAD)
    with ui.element("header").classes("mp-header q-header flex no-wrap items-center").props("role=banner"):
        ui.link("Skip to content", "#main").classes("mp-skip")
        ui.link("metropilot", "/").classes("mp-brand")
        with ui.element("nav").classes("mp-nav").props('aria-label="Pages"'):
            for path, name in PAGES:
                link = ui.link(name, path)
                if path == active:
                    link.props("aria-current=page")
        _theme_button(theme)
    with ui.element("div").classes("mp-main").props("id=main tabindex=-1"):
        yield


def _end_with(client: Client) -> None:
    """Cancel what a page that was left still waits for: there is nothing any more that it could change."""
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        for slot in Slot.stacks.get(id(task), ()):
            with suppress(RuntimeError):  # of a slot that is gone already
                if slot.parent.client is client:
                    task.cancel()


def _theme_button(theme: str) -> None:
    """Steps from the system's choice to light to dark; the browser remembers."""

    def change() -> None:
        wanted = NEXT_THEME[theme]
        cookie = f"{THEME}={wanted}; path=/; max-age=31536000; samesite=strict"
        ui.run_javascript(f"document.cookie = {cookie!r}; location.reload()")

    icon = {"auto": "brightness_auto", "light": "light_mode", "dark": "dark_mode"}[theme]
    button = ui.button(icon=icon, on_click=change).props("flat round dense color=white")
    button.props(f'aria-label="Theme: {theme}; change to {NEXT_THEME[theme]}"')


@contextmanager
def card(title: str = "", note: str = "", *, late: bool = False) -> Iterator[None]:
    """A card with a heading; a late one comes last on a narrow screen."""
    with (
        ui.element("section").classes("mp-card" + (" mp-late" if late else "")),
        ui.element("div").classes("mp-stack"),
    ):
        if title:
            heading(title)
        if note:
            ui.label(note).classes("mp-soft")
        yield


def heading(text: str) -> ui.label:
    """A heading of a card."""
    return ui.label(text).classes("mp-h").props("role=heading aria-level=2")


def reads(items: Sequence[tuple[str, str, str]]) -> None:
    """Numbers side by side: name, value, and what the browser fills (empty: nothing)."""
    with (
        ui.element("div")
        .classes("mp-reads")
        .style(f"--mp-columns: {next(n for n in (5, 4, 3, 1) if len(items) % n == 0)}")
    ):
        for name, value, part in items:
            with ui.element("div").classes("mp-read"):
                ui.label(name).classes("k")
                shown = ui.label(value).classes("v")
                if part:
                    shown.props(f'data-mp="{part}"')


def table(
    columns: Sequence[str], rows: Sequence[Sequence[Any]], *, right: Sequence[int] = (), name: str = ""
) -> None:
    """A table of texts; a cell may be (text, class)."""
    with ui.element("div").classes("mp-scroll"), ui.element("table").classes("mp-table") as made:
        if name:
            made.props(f'aria-label="{name}"')
        with ui.element("thead"), ui.element("tr"):
            for k, column in enumerate(columns):
                with ui.element("th").classes("n" if k in right else ""):
                    ui.label(column)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for k, cell in enumerate(row):
                        words, style = cell if isinstance(cell, tuple) else (cell, "")
                        with ui.element("td").classes(f"{style} n" if k in right else style):
                            ui.label(str(words))


def empty(words: str) -> ui.label:
    """What stands where there is nothing yet."""
    return ui.label(words).classes("mp-empty w-full")


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """A number with its unit, a dash where there is none."""
    if value is None:
        return "–"
    return f"{value:.{digits}f}".replace("-", "−") + (f" {unit}" if unit else "")


def clock(seconds: float) -> str:
    """Minutes and seconds, rounded to a tenth before they are parted: never ``39:60.0``."""
    minutes, tenths = divmod(round(10 * seconds), 600)
    return f"{minutes}:{tenths / 10:04.1f}"


def links(items: Sequence[tuple[str, str]]) -> None:
    """Files to take home."""
    with ui.element("div").classes("mp-links"):
        for words, target in items:
            ui.link(words, target, new_tab=True)


class Problem:
    """Where a page says what is wrong: beside the field it is about, or in a line of its own."""

    def __init__(self) -> None:
        self.fields: dict[str, Any] = {}
        self.folds: dict[str, ui.expansion] = {}
        self.label = ui.label().classes("mp-error").props('role=alert data-test="problem"')

    def beside(self, name: str, element: Any, fold: ui.expansion | None = None) -> Any:  # noqa: ANN401 (any field of NiceGUI)
        """Show errors about a field there; what it is folded into is opened then."""
        self.fields[name] = element
        if fold is not None:
            self.folds[name] = fold
        return element

    def clear(self) -> None:
        """Nothing is wrong."""
        self.label.text = ""
        for element in self.fields.values():
            element.props(remove="error error-message")

    def show(self, error: MetropilotError) -> None:
        """What is wrong, where, and what is allowed."""
        told = detail_of(error)
        allowed = f" (allowed: {told['allowed']})" if told["allowed"] else ""
        words = f"{told['message']}{allowed}"
        name = (told["field"] or "").split("[")[0].split(".")[0]
        element = self.fields.get(name)
        if element is None:
            where = ": ".join(str(told[k]) for k in ("file", "field") if told[k])
            value = (
                ""
                if told["value"] is None
                else f": {told['value']}" + (f" {told['unit']}" if told["unit"] else "")
            )
            self.label.text = (f"{where}: " if where else "") + told["message"] + value + allowed
            return
        if name in self.folds:
            self.folds[name].open()
        element.props("error").props(f'error-message="{_attribute(words)}"')

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Show what goes wrong inside."""
        self.clear()
        try:
            yield
        except MetropilotError as error:
            self.show(error)


def _attribute(text: str) -> str:
    return text.replace('"', "”").replace("\n", " ")


def refresh_while(alive: Callable[[], bool], every_s: float, act: Callable[[], Any]) -> ui.timer:
    """Call again and again while something goes on."""

    async def tick() -> None:
        if not alive():
            timer.deactivate()
            return
        result = act()
        if hasattr(result, "__await__"):
            await result

    timer = ui.timer(every_s, tick)
    return timer
