"""Words that the scripts of the pages say, handed over to them in the language of the page."""

from __future__ import annotations

import json

from metropilot.web.words.language import ENGLISH, N_, gettext, present_language
from metropilot.web.words.said import AND, JOINTS, NUMBER, NUMBERS, SENTENCES, WORDS

SCRIPTS = (
    N_("under way"),
    N_("paused"),
    N_("not sent yet"),
    N_("scheduled {time} s"),
    N_("Pause (space)"),
    N_("Go on (space)"),
    N_("watching"),
    N_("silent"),
    N_("coast"),
    N_("% power"),
    N_("% brake"),
    N_("of {count}"),
    N_("{delay} s, {loss} % lost"),
    N_("all stopped"),
    N_(
        "{time} s, {position} m, {speed} km/h, permitted {permitted} km/h, {command}, {power} kW, "
        "{energy} kWh, protection: {level}"
    ),
    N_("at its end"),
    N_("arrived at its end"),
    N_("ended: {outcome}"),
    N_("stopped; it can be resumed"),
    N_("failed: {message}"),
    N_("waiting: place {place} in the queue; it starts by itself"),
    N_("the server does not answer; reload the page"),
    N_("manual: {share} %"),
    N_("held by {holder} since {time} s"),
    N_("the driver has it"),
    N_("Give the lever back (Esc)"),
    N_("Take the lever over"),
    N_("Take the lever (M)"),
    N_("this page is {holder}"),
    N_("Sort by {column}"),
    N_("Select all"),
    N_("Select {row}"),
    N_("{action} {row}"),
)


def words_script() -> str:
    """Script that gives the pages' scripts their words; empty in English, which they have themselves."""
    if present_language() == ENGLISH:
        return ""
    told = {message: gettext(message) for message in (*SCRIPTS, *WORDS, *SENTENCES, *JOINTS)}
    rules = {"joints": JOINTS, "and": AND, "numbers": sorted(NUMBERS), "number": NUMBER}
    text = json.dumps({"words": told, "sentences": SENTENCES, **rules}, ensure_ascii=False)
    safe = text.replace("</", "<\\/")
    return f"<script>window.metropilotWords = {safe}</script>"
