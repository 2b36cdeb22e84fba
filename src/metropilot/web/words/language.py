"""Language in which a page is answered, and its texts in that language, by gettext.

English texts in the sources are the message ids; ``tools/words.py`` gathers them into the catalogue.
"""

from __future__ import annotations

import gettext as library
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import NamedTuple, TypeVar

from starlette.datastructures import Headers

FOLDER = Path(__file__).parent
DOMAIN = "metropilot"
COOKIE = "metropilot_language"


class Language(NamedTuple):
    """A language of the pages.

    Attributes:
        name: Its name in itself.
        tag: Tag of ``<html lang>`` and of Quasar's texts.
    """

    name: str
    tag: str


LANGUAGES = {"en": Language("English", "en-US"), "zh": Language("中文", "zh-CN")}
ENGLISH = "en"
_PRESENT: ContextVar[str] = ContextVar("language", default=ENGLISH)
Key = TypeVar("Key")
N_ = str
"""Mark of a text that is translated where it is shown."""


def present_language() -> str:
    """Language in which the present request, page or event is answered, one of ``LANGUAGES``."""
    return _PRESENT.get()


@contextmanager
def answer_in(language: str) -> Iterator[None]:
    """Answer in a language in the body of the context, and in every task that begins there."""
    before = _PRESENT.set(language)
    try:
        yield
    finally:
        _PRESENT.reset(before)


def language_of(headers: Headers) -> str:
    """Language of a request: that of its cookie, else the first of Accept-Language that there is."""
    try:
        chosen = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        chosen = None
    if chosen is not None and chosen.value in LANGUAGES:
        return chosen.value
    return _choose_accepted(headers.get("accept-language", ""))


def _choose_accepted(text: str) -> str:
    """Best language of an Accept-Language header that there is; English if none is."""
    best, weight = ENGLISH, 0.0
    for part in text.split(","):
        tag, _sep, parameters = part.partition(";")
        found = re.fullmatch(r"\s*q\s*=\s*([01](?:\.\d{0,3})?)\s*", parameters)
        q = float(found[1]) if found else 0.0 if parameters.strip() else 1.0
        name = tag.strip().lower().partition("-")[0]
        if name in LANGUAGES and q > weight:
            best, weight = name, q
    return best


@cache
def catalogue(language: str) -> library.NullTranslations:
    """Texts of a language."""
    if language == ENGLISH:
        return library.NullTranslations()
    return library.translation(DOMAIN, FOLDER, [language])


def gettext(message: str, /, **values: object) -> str:
    """Translate a text; values take the place of the names in its braces."""
    found = catalogue(present_language()).gettext(message) if message else ""
    return found.format(**values) if values else found


def ngettext(one: str, many: str, count: int, /, **values: object) -> str:
    """Translate a text about one or many; ``{count}`` stands for how many."""
    return catalogue(present_language()).ngettext(one, many, count).format(count=count, **values)


_ = gettext


def translate_each(messages: Mapping[Key, str]) -> dict[Key, str]:
    """Translate the values of the options of a list."""
    return {key: gettext(message) for key, message in messages.items()}
