"""Frame of every page (head, navigation, theme) and small elements shared by pages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from typing import Any, Protocol, runtime_checkable

from fastapi import Request
from nicegui import Client, ui
from nicegui.slot import Slot

from metropilot.errors import MetropilotError
from metropilot.web.errors import detail_of
from metropilot.web.users import present_user
from metropilot.web.words.browser import words_script
from metropilot.web.words.language import COOKIE, LANGUAGES, N_, _, present_language
from metropilot.web.words.said import retell

PAGES = (
    ("/", N_("Drive")),
    ("/compare", N_("Compare")),
    ("/journey", N_("Journey")),
    ("/line", N_("Line")),
    ("/convoy", N_("Convoy")),
    ("/learn", N_("Learn")),
    ("/lines", N_("Lines")),
    ("/runs", N_("Runs")),
    ("/campaigns", N_("Campaigns")),
)
THEME = "metropilot_theme"
THEMES = {"auto": None, "light": False, "dark": True}
HEAD = (
    '<link rel="stylesheet" href="/static/console.css">'
    '<script src="/static/words.js"></script>'
    '<script src="/static/access.js" defer></script><script src="/static/stream.js" defer></script>'
    '<script src="/static/moments.js" defer></script><script src="/static/copies.js" defer></script>'
    '<script src="/static/arrival.js" defer></script><script src="/static/handles.js" defer></script>'
    '<script src="/static/live.js" defer></script><script src="/static/convoy.js" defer></script>'
    '<script src="/static/line.js" defer></script>'
)
UPLOAD_HEADER = """<div class="row items-center no-wrap q-pa-sm q-gutter-sm">
    <q-btn outline no-caps icon="upload_file" label="%s" :disable="props.disable" @click="props.pickFiles" />
    <span class="mp-soft">%s</span>
    <div style="display: none"><q-uploader-add-trigger /></div></div>"""
COPIES = {"svg": N_("Plot as SVG"), "png": N_("Plot as PNG"), "csv": N_("Values of the plot as CSV")}
THEME_WORDS = {"auto": N_("auto"), "light": N_("light"), "dark": N_("dark")}
NEXT_THEME = {"auto": "light", "light": "dark", "dark": "auto"}


READS_ONLY = N_("You are signed in as {name}, who reads only: everything can be looked at, nothing changed.")


class ActionButton(ui.button):
    """Button that changes something on the server; disabled for a viewer, whatever the page says."""

    def __init__(self, *args: Any, **values: Any) -> None:  # noqa: ANN401 (those of a button)
        self.allowed = present_user().may_change
        super().__init__(*args, **values)
        if not self.allowed:
            self.set_enabled(False)
            self.props(prop_of("title", _("{name} reads only", name=present_user().name)))

    def set_enabled(self, value: bool) -> ActionButton:
        """Enable or disable the button; a viewer's stays disabled."""
        return super().set_enabled(value and self.allowed)

    def enable(self) -> ActionButton:
        """Enable the button, unless it is a viewer's."""
        return self.set_enabled(True)


def for_users(element: Any) -> Any:  # noqa: ANN401 (any field of NiceGUI)
    """Disable a field that changes something on the server where a viewer looks at it; return it."""
    if not present_user().may_change:
        element.disable()
    return element


@contextmanager
def frame(request: Request, active: str) -> Iterator[None]:
    """Place the frame of a page; the body of the context is its main part. Its tasks end with the page."""
    ui.context.client.on_delete(_end_with)
    theme = request.cookies.get(THEME, "auto")
    theme = theme if theme in THEMES else "auto"
    ui.dark_mode(THEMES[theme])
    ui.colors(primary="#0072b2", positive="#00785a", negative="#b84300", warning="#b84300")
    ui.add_head_html(words_script() + HEAD)
    language = present_language()
    name = _((ui.context.client.page.title or "metropilot").partition(" · ")[0])
    _speak(ui.context.client, language, name)
    # NiceGUI puts what is placed here inside its <main>: the header is to be a landmark beside it.
    with ui.context.client.layout, ui.element("header") as header:
        header.classes("mp-header q-header flex no-wrap items-center").move(target_index=0)
        ui.link(_("Skip to content"), "#main").classes("mp-skip")
        ui.link("metropilot", "/").classes("mp-brand")
        with ui.element("nav").classes("mp-nav").props(prop_of("aria-label", _("Pages"))):
            for path, words in PAGES:
                link = ui.link(_(words), path)
                if path == active:
                    link.props("aria-current=page")
        user = present_user()
        if user.name is not None:
            ui.label(user.name).classes("mp-user").props('data-test="user"')
        _language_button(language)
        _theme_button(theme)
    with ui.element("div").classes("mp-main").props("id=main tabindex=-1"):
        ui.label(name).classes("mp-unseen").props("role=heading aria-level=1")
        if not user.may_change:
            said = ui.label(_(READS_ONLY, name=user.name)).classes("mp-card mp-notice mp-wide")
            said.props('role=note data-test="reads-only"')
        yield


def _end_with(client: Client) -> None:
    """Cancel the tasks of a page that was closed."""
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        for slot in Slot.stacks.get(id(task), ()):
            with suppress(RuntimeError):  # of a slot that is gone already
                if slot.parent.client is client:
                    task.cancel()


def _speak(client: Client, language: str, name: str) -> None:
    """Set title, ``<html lang>`` and Quasar's own texts of a page; NiceGUI has them of the route, for all."""
    client.title = f"{name} · metropilot"
    client.page = copy(client.page)
    client.page.language = LANGUAGES[language].tag


def _keep(cookie: str, value: str) -> None:
    """Keep a choice in a cookie and load the page anew."""
    text = f"{cookie}={value}; path=/; max-age=31536000; samesite=strict"
    ui.run_javascript(f"document.cookie = {text!r}; location.reload()")


def _language_button(language: str) -> None:
    """Place the button of the language, which says the other one's name in itself."""
    names = list(LANGUAGES)
    other = names[(names.index(language) + 1) % len(names)]
    button = ui.button(LANGUAGES[other].name, on_click=lambda: _keep(COOKIE, other))
    button.props(f'flat dense no-caps color=white lang={LANGUAGES[other].tag} data-test="language"')


def _theme_button(theme: str) -> None:
    """Place the button of the theme: system, light, dark, kept in a cookie."""
    wanted = NEXT_THEME[theme]
    icon = {"auto": "brightness_auto", "light": "light_mode", "dark": "dark_mode"}[theme]
    button = ui.button(icon=icon, on_click=lambda: _keep(THEME, wanted)).props("flat round dense color=white")
    words = _("Theme: {theme}; change to {next}", theme=_(THEME_WORDS[theme]), next=_(THEME_WORDS[wanted]))
    button.props(prop_of("aria-label", words))


@runtime_checkable
class Filled(Protocol):
    """A part of a page whose fields are also changed by the page itself."""

    filling: bool


@contextmanager
def set_quietly(part: Filled) -> Iterator[None]:
    """Change the fields of a part without its answers to a change by hand."""
    before, part.filling = part.filling, True
    try:
        yield
    finally:
        part.filling = before


@contextmanager
def card(title: str = "", note: str = "", *, late: bool = False) -> Iterator[ui.element]:
    """Place a card with a heading; a late one comes last on a narrow screen."""
    with (
        ui.element("section").classes("mp-card" + (" mp-late" if late else "")) as made,
        ui.element("div").classes("mp-stack"),
    ):
        if title:
            heading(title)
        if note:
            ui.label(note).classes("mp-soft")
        yield made


@contextmanager
def question(title: str) -> Iterator[ui.dialog]:
    """Place a dialog with a heading, which is its name, too; Escape closes it."""
    with ui.dialog() as made, ui.card().classes("mp-card"):
        made.props(prop_of("aria-label", title))
        heading(title)
        yield made


def heading(text: str) -> ui.label:
    """Place the heading of a card."""
    return ui.label(text).classes("mp-h").props("role=heading aria-level=2")


def strip(name: str, content: str = "") -> ui.html:
    """Place a drawing of the track, which is scrolled by keyboard, too, where it is wider than its card."""
    made = ui.html(content).classes("mp-strip")
    return made.props("tabindex=0 role=group").props(prop_of("aria-label", name))


def plot(drawn: dict[str, Any]) -> ui.plotly:
    """Place a figure of Plotly; below it stand buttons that copy it as SVG, PNG or CSV."""
    made = ui.plotly(drawn).classes("mp-plot")
    with ui.element("div").classes("mp-copies"):
        for kind, words in COPIES.items():
            button = ui.element("button").props(f'type=button data-copy={kind} data-plot="{made.id}"')
            button.props(prop_of("aria-label", _(words))).props["innerText"] = kind.upper()
    return made


def upload_field(
    words: str, kinds: Sequence[str], most_bytes: int, take: Callable[..., Any], refuse: Callable[[], Any]
) -> ui.upload:
    """Place a field that takes a file by a button or a drop.

    Args:
        words: What the button says.
        kinds: Endings of the files that it takes.
        most_bytes: Largest file.
        take: Called with the event of a file.
        refuse: Called where the file is too large or of another kind.
    """
    made = ui.upload(on_upload=take, on_rejected=refuse, max_file_size=most_bytes, auto_upload=True)
    made.props(f'accept="{",".join(kinds)}" flat bordered').classes("w-full")
    # Quasar's own header has an input without a name inside a button without one.
    made.add_slot("header", UPLOAD_HEADER % (words, _("or drop it here")))
    return for_users(made)


def reads(items: Sequence[tuple[str, str, str]]) -> None:
    """Place numbers side by side: name in English or translated, value, key by which the browser fills it."""
    with (
        ui.element("div")
        .classes("mp-reads")
        .style(f"--mp-columns: {next(n for n in (6, 5, 4, 3, 1) if len(items) % n == 0)}")
    ):
        for name, value, part in items:
            with ui.element("div").classes("mp-read"):
                ui.label(_(name)).classes("k")
                shown = ui.label(value).classes("v")
                if part:
                    shown.props(f'data-mp="{part}"')


def table(
    columns: Sequence[str], rows: Sequence[Sequence[Any]], *, right: Sequence[int] = (), name: str = ""
) -> None:
    """Place a table of texts; a cell may be (text, class)."""
    with ui.element("div").classes("mp-scroll") as scrolled, ui.element("table").classes("mp-table") as made:
        if name:
            scrolled.props("tabindex=0 role=group")
            scrolled.props(prop_of("aria-label", _("{name}, scrolled", name=name)))
            made.props(prop_of("aria-label", name))
        with ui.element("thead"), ui.element("tr"):
            for k, column in enumerate(columns):
                # a cell without words is no heading
                with ui.element("th" if column else "td").classes("n" if k in right else ""):
                    ui.label(column)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for k, cell in enumerate(row):
                        words, style = cell if isinstance(cell, tuple) else (cell, "")
                        with ui.element("td").classes(f"{style} n" if k in right else style):
                            ui.label(str(words))


def empty(words: str) -> ui.label:
    """Place the words of an empty list or result."""
    return ui.label(words).classes("mp-empty w-full")


def clock(seconds: float) -> str:
    """Format minutes and seconds; rounding comes first, so that 60.0 s carries over."""
    minutes, tenths = divmod(round(10 * seconds), 600)
    return f"{minutes}:{tenths / 10:04.1f}"


def links(items: Sequence[tuple[str, str]]) -> None:
    """Place links to files."""
    with ui.element("div").classes("mp-links"):
        for words, target in items:
            ui.link(words, target, new_tab=True)


class Problem:
    """Display of errors: beside the field concerned, or in a separate line."""

    def __init__(self) -> None:
        self.fields: dict[str, Any] = {}
        self.folds: dict[str, ui.expansion] = {}
        self.label = ui.label().classes("mp-error").props('role=alert data-test="problem"')

    def beside(self, name: str, element: Any, fold: ui.expansion | None = None) -> Any:  # noqa: ANN401 (any field of NiceGUI)
        """Show errors of a field at an element, and open its expansion."""
        self.fields[name] = element
        if fold is not None:
            self.folds[name] = fold
        return element

    def clear(self) -> None:
        """Remove all errors."""
        self.label.text = ""
        for element in self.fields.values():
            element.props(remove="error error-message")

    def show(self, error: MetropilotError) -> None:
        """Show an error with its place and allowed values."""
        told = detail_of(error)
        allowed, message = allowed_words(told["allowed"]), retell(told["message"])
        words = f"{message}{allowed}"
        name = (told["field"] or "").split("[")[0]
        while name not in self.fields and "." in name:
            name = name.rpartition(".")[0]
        element = self.fields.get(name)
        if element is None:
            where = ": ".join(str(told[k]) for k in ("file", "field") if told[k])
            value = (
                ""
                if told["value"] is None
                else f": {told['value']}" + (f" {told['unit']}" if told["unit"] else "")
            )
            self.label.text = (f"{where}: " if where else "") + message + value + allowed
            return
        if name in self.folds:
            self.folds[name].open()
        element.props("error").props(prop_of("error-message", words))

    @contextmanager
    def show_errors(self) -> Iterator[None]:
        """Show an error raised in the body of the context."""
        self.clear()
        try:
            yield
        except MetropilotError as error:
            self.show(error)


def allowed_words(allowed: object) -> str:
    """Words on what is allowed, to follow those of an error; empty if it does not say."""
    return " " + _("(allowed: {allowed})", allowed=retell(str(allowed))) if allowed else ""


def prop_of(name: str, text: str) -> str:
    """Write a text as a property of an element, in which neither quotes nor line ends may stand."""
    return f'{name}="{text.replace(chr(34), "”").replace(chr(10), " ")}"'


def refresh_while(alive: Callable[[], bool], every_s: float, act: Callable[[], Any]) -> ui.timer:
    """Call a function at an interval while a condition holds."""

    async def tick() -> None:
        if not alive():
            timer.deactivate()
            return
        result = act()
        if hasattr(result, "__await__"):
            await result

    timer = ui.timer(every_s, tick)
    return timer
