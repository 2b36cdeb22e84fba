"""Words and sentences of the library and of stored jobs: English there, translated when they are shown."""

from __future__ import annotations

import re
from functools import cache

from metropilot.web.words import refusals, studies
from metropilot.web.words.language import ENGLISH, N_, gettext, present_language

WORDS = (
    # status of a job
    N_("queued"),
    N_("running"),
    N_("done"),
    N_("failed"),
    N_("stopped"),
    N_("interrupted"),
    N_("not started"),
    N_("published"),
    N_("computed"),
    N_("leaderboard"),
    N_("robustness"),
    N_("trainsets"),
    # outcome of a drive and its requirements
    N_("arrived"),
    N_("early"),
    N_("late"),
    N_("overshot"),
    N_("overspeed"),
    N_("stalled"),
    N_("out of time"),
    N_("contact"),
    N_("link silent"),
    N_("intervention"),
    N_("arrived safely and on time"),
    N_("arrived on time"),
    N_("every train is on time"),
    N_("stops at the mark"),
    N_("on time"),
    N_("no overspeed"),
    N_("no intervention"),
    N_("jerk"),
    N_("no limit"),
    N_("no contact"),
    N_("couples and parts in time"),
    N_("all, before the stop or place"),
    # main KPIs
    N_("running time"),
    N_("energy at the wheel"),
    N_("energy at the line"),
    N_("optimum at the wheel"),
    N_("optimum at the line"),
    N_("above the optimum"),
    N_("attainable"),
    N_("lost by the trainset"),
    N_("lost by the driver"),
    N_("highest speed"),
    N_("largest jerk"),
    N_("change within 2 s"),
    N_("sum of command changes"),
    N_("coasting"),
    N_("decision time"),
    N_("traction"),
    N_("for the running time achieved"),
    N_("with jerk limit, dead time, lag and protection"),
    N_("attainable above the optimum"),
    N_("this run above the attainable"),
    N_("the stop included"),
    N_("jerk as in Cheng23"),
    N_("comfort as in Huang25"),
    N_("median"),
    # comfort
    N_("not uncomfortable"),
    N_("a little uncomfortable"),
    N_("fairly uncomfortable"),
    N_("uncomfortable"),
    N_("very uncomfortable"),
    N_("extremely uncomfortable"),
    # protection
    N_("none"),
    N_("traction cut-off"),
    N_("service brake"),
    N_("emergency brake"),
    N_("not a command"),
    # features of a learned driver
    N_("position on the section"),
    N_("position"),
    N_("speed"),
    N_("acceleration"),
    N_("last command"),
    N_("distance to the stop"),
    N_("time left"),
    N_("time since departure"),
    N_("running-time reserve"),
    N_("mean speed that the timetable needs"),
    N_("braking rate that the stop needs"),
    N_("margin to the permitted speed"),
    N_("permitted speed up to 1 km ahead"),
    N_("permitted speed further ahead"),
    N_("gradients up to 1 km ahead"),
    N_("gradients further ahead"),
    N_("tractive effort, braking effort, resistance"),
    N_("tractive effort and resistance at higher speeds"),
    N_("time to spare when coasting from here"),
    N_("time to spare when coasting later"),
    N_("time to spare at constant speed"),
    N_("speed to hold for the timetable"),
    N_("load"),
    N_("dead time and lag"),
    N_("jerk limit"),
    N_("state of the expert system"),
    N_("speed error"),
    N_("position error"),
    N_("a higher proportional gain"),
    N_("the notch chosen"),
    N_("a higher speed"),
    N_("more power"),
    # parameters of a fit, and what a log has
    N_("mass / nominal"),
    N_("service brake / nominal"),
    N_("resistance / nominal"),
    N_("Davis, constant"),
    N_("Davis, linear"),
    N_("Davis, quadratic"),
    N_("dead time"),
    N_("lag"),
    N_("mass"),
    N_("resistance"),
    N_("brake"),
    N_("delay"),
    N_("command"),
    N_("effort"),
    N_("gradient"),
    N_("neither command nor effort"),
    # disturbances and verdicts of what is published
    N_("nominal"),
    N_("disturbed"),
    N_("trainset with dead time"),
    N_("everything at once"),
    N_("wind"),
    N_("wheel slip"),
    N_("light, less resistance"),
    N_("light, more resistance"),
    N_("heavy, less resistance"),
    N_("heavy, more resistance"),
    N_("a restriction on the way"),
    N_("beaten"),
    N_("matched"),
    N_("missed"),
    N_("cannot be tested"),
    N_("adds"),
    N_("adds little"),
    N_("adds nothing"),
    N_("not measured with this budget"),
    N_("too few runs reach it for a median"),
    # kinds of what is uploaded, directions, places
    N_("line"),
    N_("trainset"),
    N_("policy"),
    N_("log"),
    N_("forward"),
    N_("backward"),
    N_("station"),
    N_("section"),
    N_("every station"),
    N_("planned"),
    N_("own"),
    # learning
    N_("learned"),
    N_("quick"),
    N_("paper"),
    # regimes of a drive
    N_("power"),
    N_("cruise"),
    N_("coast"),
    # progress of a job
    N_("driving"),
    N_("comparing with the optimum"),
    N_("explaining"),
    N_("drawing"),
    N_("tracing"),
    N_("writing"),
    N_("reading the logs"),
    N_("fitting"),
    N_("compiling"),
    N_("beginning"),
    N_("planning the trips"),
    N_("searching the timetable"),
    N_("choosing the timetable"),
    N_("checking headways and feeding"),
    N_("adding up the day"),
    N_("its record was not kept"),
    N_("it can be resumed"),
    # live runs
    N_("the lever is returned to the driver"),
    N_("the head makes an emergency brake"),
    N_("the link is silent"),
    N_("no plan from here meets it"),
    N_("the process of the run ended before the run did, most likely of too little memory"),
    # refusals that the pages show beside their fields
    N_("out of range"),
    N_("not a number"),
    N_("thousands or decimals"),
    N_("no such job"),
    N_("no such run"),
    N_("no such live run"),
    N_("no such line"),
    N_("no such trainset"),
    N_("no such policy"),
    N_("no such project"),
    N_("no such version"),
    N_("no run is under way; depart first"),
    N_("no convoy is under way; depart first"),
    N_("no line is running; press Run"),
    N_("choose a section first"),
    N_("a time is needed"),
    N_("no log is ticked"),
    N_("one or more"),
    N_("two runs are needed"),
    N_("the run is over"),
    N_("the run does not answer"),
    N_("the run is still being planned; try again"),
    N_("no row is computed yet"),
    N_("that time has passed"),
    N_("lies behind the trainset"),
    N_("too near for this speed: no brake could keep it"),
    N_("runs of different sections cannot be compared"),
    N_("needs too much memory; use a smaller request"),
    N_("the worker died, most likely of too little memory"),
    N_("each time later than the one before"),
    N_("a finite number, or an empty cell for a gap"),
    N_("three coefficients: constant, linear, quadratic in speed"),
    N_("letters, digits and . _ - @ , +"),
    N_("text without quotation marks, backslashes, */ and control characters"),
    N_("a JSON object"),
    N_("minimum running time"),
)
SENTENCES = (
    # status and progress of a job
    N_("place {place} in the queue"),
    N_("no viewer for {seconds} s"),
    N_("not started: the server was restarted"),
    N_("the server was restarted"),
    N_("{done} of {total} rows"),
    N_("{steps} of {total} steps"),
    N_("{rate} steps/s"),
    N_("{share} of the demonstrations collected"),
    N_("{met} of {count} drivers met every requirement"),
    N_("{count} files"),
    N_("residuals {noise} m/s"),
    N_("seed {seed}"),
    # outcome of a drive and its requirements
    N_("arrived {seconds} s early"),
    N_("arrived {seconds} s late"),
    N_("{seconds} s late in all"),
    N_("but {count} interventions"),
    N_("but {count} intervention"),
    N_("{count} interventions"),
    N_("{count} intervention"),
    N_("but jerk {jerk} m/s³"),
    N_("jerk {jerk} m/s³"),
    N_("{number} more failed"),
    N_("trainset {number} {verdict}"),
    N_("within {distance} m"),
    N_("within {time} s"),
    N_("at most {jerk} m/s³"),
    N_("{value} (trainset {number})"),
    # main KPIs
    N_("scheduled {time} s"),
    N_("minimum {time} s"),
    N_("under protection {time} s"),
    N_("net of {number} kWh regenerated"),
    N_("certified within {number} %"),
    N_("at least {number} kWh"),
    N_("r.m.s. {number} m/s²"),
    N_("{count} changes of regime"),
    # live runs
    N_("new arrival time, earlier: after {time} s"),
    N_("new arrival time, later: after {time} s"),
    N_("earliest possible arrival from here: after {time} s"),
    N_("latest possible arrival from here: after {time} s"),
    N_("restriction announced: {speed} km/h from {begin} to {end} m"),
    N_("the lever is taken by hand by {holder}"),
    N_("the lever is taken over from {before} by {holder}"),
    N_("the lever is held by {holder} since {time} s after departure"),
    N_("link: {delay} s late, {jitter} s uneven, {loss} % lost"),
    N_("the next train at {station} is held for {time} s"),
    N_("train {number} is held at {station} for {time} s"),
    N_("{section}: {speed} km/h for {time} s"),
    N_("every train is on time again, {time} s after the last event"),
    N_("train {number} is stopped before {station}"),
    N_("train {number} waits at {station} for train {ahead}"),
    N_("train {number} drives on"),
    # logs and fits
    N_("{samples} samples, {minutes} min, up to {speed} km/h"),
    N_("resistance at {speed} km/h"),
    N_("no gradient in {logs}: level track assumed; --line gives a section's gradients"),
    N_("{count} of {logs} logs"),
    N_("{count} of {runs} runs begin at speed, which is estimated"),
    N_(
        "The mass is that with the trainset's traction curve; a traction of {share} of the curve at the "
        "nominal mass accelerates alike, and commands cannot tell them apart."
    ),
    N_("The {parameter} is known to ±{width} only: the logs hardly tell it from {others}."),
    N_("The {parameter} is known to ±{width} only."),
    N_("residuals of {noise} m/s: trainset, units or track may not be those of the logs"),
    N_("task {task}"),
    # sources of drivers
    N_("own, after {source}"),
    N_("own ({source}'s recorded drives are not public)"),
    N_("own; convex plan in receding horizon"),
    N_("own; convex plan"),
    N_("{source} ({short}); textbook rules"),
    N_("{source} ({short}); textbook network"),
    N_("{source}, compared in {other}"),
    # axes of a campaign
    N_("{count} drivers"),
    N_("{count} sections"),
    N_("{count} trainsets and loads"),
    N_("{count} times"),
    N_("{count} control periods"),
    N_("{count} disturbances"),
    N_("{count} seeds"),
    N_("{count} actuations"),
    N_("a sample of {count} combinations with every driver and actuation"),
    # jobs in words
    N_("every {headway} s"),
    N_("convoy of {count}"),
    N_("logs: {count}"),
    # what is published
    N_(
        "Written by {command}: {count} seeds, {minutes} minutes (without learning runs of earlier "
        "calls). {how}."
    ),
    N_("Written by {command}: {how}."),
    N_("{rows} rows, {seconds} s in the last call, {processor} s of processor time"),
    N_("{count} cores"),
    N_("date {date}"),
    N_("date: {date}"),
    N_("commit {commit}"),
    N_("commit: {commit}"),
    N_("versions: {versions}"),
    N_("machine: {machine}"),
    N_(
        "{verdicts}. Learning {adds}: beside the strongest simple rival it is better in {better}, worse in "
        "{worse}, and the same, not distinguishable or not tested in {same} of {claims} claims."
    ),
    N_("worse than {rival} (p = {p})"),
    N_("better than {rival} (p = {p})"),
    N_("not distinguishable from {rival} (p = {p})"),
    N_("the difference may be chance (p = {p})"),
    N_("too few seeds for a test"),
    N_("p = {p}"),
    N_("{count} beaten"),
    N_("{count} matched"),
    N_("{count} missed"),
    N_("{count} cannot be tested"),
    # refusals that the pages show beside their fields
    N_("{station} cannot be reached before {time} s"),
    N_("the job is a {kind}, no comparison"),
    N_("the job is a {kind}, no convoy"),
    N_("the job is a {kind}, no fit"),
    N_("the job is a {kind}, no line in operation"),
    N_("the job is a {kind}"),
    N_("{name} reads only"),
    N_("{name} has {count} jobs that wait or run; stop one, or wait"),
    N_("{name} keeps {size} MB of runs and uploads; delete some"),
    N_("{name} keeps {size} MB of runs and uploads, {more} MB more do not fit; delete some"),
    N_("at most {count}"),
    N_("at most {size} MB"),
    N_("took longer than {time} s; use a smaller request"),
    # what is allowed
    N_(">= {number} m/s^2 left on the fall"),
    N_("{distance} m or further"),
    N_("1 to {count}, one for each section"),
    N_("{names} cannot be told apart"),
    N_("{names} cannot be estimated"),
    N_("longer logs with traction, coasting and braking, or keep: {names}"),
    N_("the plan's solver stopped: {reason}"),
    N_("{first} or {second}"),
    N_("one case"),
)
JOINTS = (N_("; "), N_(": "), N_(", "), " · ", " × ", N_(" and "))
"""Separators of sentences, and of words in a row; what they part is translated as far as it is known."""
NUMBERS = frozenset(
    {
        "place",
        "seconds",
        "done",
        "total",
        "steps",
        "rate",
        "seed",
        "count",
        "number",
        "distance",
        "time",
        "jerk",
        "speed",
        "begin",
        "end",
        "delay",
        "jitter",
        "loss",
        "samples",
        "minutes",
        "met",
        "noise",
        "rows",
        "processor",
        "better",
        "worse",
        "same",
        "claims",
        "headway",
    }
)
"""Names in braces that stand for numbers only."""
NUMBER = r"[-+−\d.,]+"
AND = JOINTS[-1]
"""The separator that prose has, too: it parts only what is known altogether."""


@cache
def sentence_patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """Sentences with the expressions that find them."""
    found = []
    for message in (*SENTENCES, *studies.SENTENCES, *refusals.SENTENCES):
        parts = re.split(r"\{(\w+)\}", message)
        for k in range(1, len(parts), 2):
            parts[k] = f"(?P<{parts[k]}>{NUMBER if parts[k] in NUMBERS else '.+?'})"
        parts[::2] = map(re.escape, parts[::2])
        found.append((message, re.compile("".join(parts))))
    return tuple(found)


def retell(text: str) -> str:
    """Translate what the library or a stored job says; what is unknown, a name maybe, stays as it is."""
    if present_language() == ENGLISH or not text:
        return text
    found = gettext(text)
    if found != text:
        return found
    for message, pattern in sentence_patterns():
        if match := pattern.fullmatch(text):
            return gettext(message, **{name: retell(value) for name, value in match.groupdict().items()})
    for joint in JOINTS:
        parts = text.split(joint)
        told = [retell(part) for part in parts] if len(parts) > 1 else parts
        changed = [one != other for one, other in zip(told, parts, strict=True)]
        if all(changed) if joint == AND else any(changed):
            return gettext(joint).join(told)
    return text
