"""The study, start to end: learn, drive the cases, compare with the paper and with the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from metropilot.policy import shipped_policy
from metropilot.studies.huang2025 import drives
from metropilot.studies.huang2025.as_printed import AS_PRINTED
from metropilot.studies.huang2025.beyond import GAINS, beyond_rows, repeat_stops, stop_rows
from metropilot.studies.huang2025.figures import figures
from metropilot.studies.huang2025.setting import (
    BRISK_EITOE,
    BY_ID,
    CASES,
    CITATION,
    COAST,
    EITOE,
    EITOP,
    EQUAL_EITOE,
    EXPERTS,
    IC,
    IE,
    ITOR,
    LEARNED,
    LEARNED_IE,
    MANUAL,
    RELATIVE,
    STOD,
    STON,
    TABLE3,
    TABLE4,
    TOOK,
    TOP,
)
from metropilot.studies.report import ReportRow, StudyReport, make_row, paragraphs
from metropilot.studies.study import Study
from metropilot.studies.verdict import Aim, Claim

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult
    from metropilot.studies.study import Order

DEVIATIONS = paragraphs("""
Manual driving is the model `manual` with ten parameter sets, not the best of 100 recorded drives, which
are not public. Percentages relative to it are therefore not comparable with the published ones.

Most equations and nearly all cells of Tables 1 to 4 exist only as pictures. Ie is sum |a| v dt per kg,
which gives the published 380 J/kg of EITOE for its published 19.49 m/s; Ic is the sum of all changes of
effort over mass, without a threshold; parking tolerance 0.3 m.

Gain 1, dead time 0.6 s and time constant 0.4 s are used for eq. 4, whose values are not printed; there
is no other limit on the change of effort, as in the paper. Gradients and limits hold over the
trainset's length of 118 m, and the sum of eq. 3 over the vehicles is driven; a table at the end gives
the motion of its six vehicles under the same efforts.

The window of eq. 14 compares the mean speed of a trainset that coasts from here, not the speed itself,
always to the destination. With the speed itself, or with a window for each speed-limit interval as
Algorithm 1 prints it, it cannot coast as long as the published drive; the table at the end gives the
energy of the latter.

Rule 4 is implemented as: no power beyond the speed that coasts to the next lower limit at that limit,
while the minimum-time curve leaves time for it.

A trainset that would be early even when coasting brakes gently (0.5 m/s²), as the paper's EITOP does in
Fig. 11; here EITOE does so, too. Traction above the window ends as quickly as the trainset may, not by
steps of eq. 15: what it adds is braked away again. Inside the window, which eqs. 15 and 16 do not define,
EITOE powers until it would arrive on time, then coasts. A trainset slower than 1 m/s counts as late, so
that it neither brakes to a stand before a stop on a climb nor waits there.

One interval of rule 3 is the control period of 0.2 s; the paper decides every 0.02 s, which has a row
of its own. From the safe speed on (eqs. 17 and 18) the brake follows that speed's fall at 0.85 m/s², or
at 95 % of what a weak brake or one on a fall sustains, instead of full braking at once; protection is
asked before each command, which the paper's train does not.

EITOP may accelerate at 0.8 m/s², every other driver of the expert at the 0.6 of rule 2: the published
364 J/kg corresponds to a peak of 19.08 m/s, which needs 0.8. Each is compared with the optimum under
its own limit, braking at most 1 m/s².

The station stop is HOA in the form its description has, with balises 64, 36, 16, 4 and 0 m before the
stop; between them it also learns from the measured deceleration. Position is measured exactly.

EITOP learns on four sections of the line (case 1 among them) and any time from 1.08 to 1.45 of the
minimum, not on case 1 alone, without dead time and lag. The weights of eq. 26 are chosen here: 1 per
kWh, 3 per second of time error at the end, 0.2 for 1 m/s² of change.

ITOR, STON and STOD learn inside the same expert as EITOE, window included: a stronger baseline than the
published ones, whose own expert rules have none. Tables and networks are chosen here, as none are
printed.
""")


EXPERT_RIVALS = (EITOE, BRISK_EITOE, EQUAL_EITOE)
"""The rules without a policy: with the paper's limit, with EITOP's, and at EITOP's arrival."""


def _claim(case: str, driver: str, kpi: str, words: str, aim: Aim = "low") -> Claim:
    """Claim on a driver in a case, without a policy for rival where it is EITOP."""
    rivals = EXPERT_RIVALS if driver == EITOP else ()
    return Claim(words, driver, kpi, BY_ID[case].name, aim, rivals)


def _arrival(case: str, words: str) -> Claim:
    """Claim on the arrival of EITOP: nearer to the time in force is better, within a second is the same."""
    about = BY_ID[case]
    arrival_s = about.scheduled_s if about.news_s is None else about.news_s
    return Claim(words, EITOP, TOOK, about.name, "same", rounding=1.0, target=arrival_s)


CLAIMS = (
    _claim("101", EITOE, IE, "EITOE at 101 s: energy", "same"),
    _claim("101", EITOP, IE, "EITOP needs less energy than EITOE at 101 s"),
    _claim("101", EITOE, RELATIVE, "EITOE saves energy against manual driving at 101 s"),
    _claim("101", EITOP, RELATIVE, "EITOP saves energy against manual driving at 101 s"),
    _claim("95", EITOP, RELATIVE, "the same at 95 s"),
    _claim("115", EITOP, RELATIVE, "the same at 115 s"),
    _claim("95", EITOP, IC, "EITOP is comfortable at 95 s"),
    _claim("101", EITOE, COAST, "EITOE coasts a long way at 101 s", "high"),
    _arrival("later", "EITOP follows a later arrival"),
    _arrival("earlier", "EITOP follows an earlier arrival"),
    _arrival("sjz", "EITOP is on time, Songjiazhuang to Xiaocun"),
    _arrival("xc", "EITOP is on time, Xiaocun to Xiaohongmen"),
    Claim(
        "a decision of EITOP is quick",
        EITOP,
        "time of a decision (range: median and 95 % point)",
        "all cases",
    ),
    Claim("learning lowers the energy of case 1", EITOP, "Ie of case 1", "policy kept"),
)

COMPARED, UPDATED = ("95", "101", "115", "sjz", "xc"), ("later", "earlier", "restricted")
WANTED_PERCENT = {**dict.fromkeys(COMPARED, 2.0), **dict.fromkeys(UPDATED, 5.0)}
"""Most that EITOP should need above what is possible, by case."""


def _value(rows: Sequence[ReportRow], case: str, driver: str, kpi: str) -> ReportRow | None:
    name = BY_ID[case].name
    return next((r for r in rows if (r.case, r.driver, r.kpi) == (name, driver, kpi)), None)


def _text(rows: Sequence[ReportRow], case: str, driver: str, kpi: str, digits: int = 1) -> str:
    row = _value(rows, case, driver, kpi)
    return "–" if row is None or row.ours is None else f"{row.ours:.{digits}f}"


def _percent_range(rows: Sequence[ReportRow], case: str, driver: str, kpi: str) -> str:
    row = _value(rows, case, driver, kpi)
    if row is None or row.ours is None or row.high is None:
        return "–"
    return f"{row.ours:.2f} % ({row.high:.2f} %; {BY_ID[case].name})"


def _name_missed(rows: Sequence[ReportRow], cases: Sequence[str]) -> str:
    """Name the cases in which EITOP needs more than wanted above what is possible, in a sentence."""
    missed, most = [], max(WANTED_PERCENT[case] for case in cases)
    for case in cases:
        row = _value(rows, case, EITOP, drives.LEFT if case in UPDATED else drives.ABOVE_ATTAINABLE)
        if row is None or row.ours is None or round(row.ours, 2) > WANTED_PERCENT[case]:
            missed.append(BY_ID[case].name)
    return f"Wanted: at most {most:g} %; missed: {', '.join(missed) or 'nowhere'}."


def _against_expert(rows: Sequence[ReportRow]) -> str:
    """Energy of EITOP beside the expert alone, at the same acceleration limit and the same arrival."""
    said, gains = [], []
    for case in COMPARED:
        mine, other = (_value(rows, case, driver, IE) for driver in (EITOP, EQUAL_EITOE))
        if mine is None or other is None or not mine.ours or not other.ours:
            continue
        gains.append(100.0 * (mine.ours / other.ours - 1.0))
        said.append(f"{gains[-1]:+.1f} % ({BY_ID[case].name})")
    if not gains:
        return "EITOP was not compared with the expert at its own limit."
    less = sum(gain < 0.0 for gain in gains)
    above = [_value(rows, case, EQUAL_EITOE, drives.ABOVE_ATTAINABLE) for case in COMPARED]
    most = [row.ours for row in above if row is not None and row.ours is not None]
    room = ""
    if most:
        room = (
            f" More than {sum(most) / len(most):.1f} % in the mean ({min(most):.1f} to {max(most):.1f} %) "
            "cannot be gained: so far is the expert above the attainable optimum of the same limits."
        )
    return (
        "EITOP against the expert alone (EITOE) with the same acceleration limit of 0.8 m/s² and the same "
        f"arrival, Ie: {', '.join(said)}; less in {less} of {len(gains)} cases, "
        f"{sum(gains) / len(gains):+.1f} % in the mean.{room}"
    )


ORDERED = (MANUAL, ITOR, STON, STOD, EITOE, EITOP)
ALIKE_PERCENT = 1.0
"""Medians nearer than this are no order."""


def _order(rows: Sequence[ReportRow], case: str) -> str:
    """Finding on the order of the drivers by energy, published and ours."""
    ours, published = {}, {MANUAL: 0.0}
    for driver in ORDERED:
        energy, relative = (_value(rows, case, driver, kpi) for kpi in (IE, RELATIVE))
        if energy is not None and energy.ours is not None:
            ours[driver] = energy.ours
        if relative is not None and relative.published is not None:
            published[driver] = relative.published
    if len(ours) < len(ORDERED):
        return "The order of the drivers by energy was not compared."
    told = sorted(published, key=published.__getitem__, reverse=True)
    found = sorted(ours, key=ours.__getitem__, reverse=True)
    words = [f"`{found[0]}` {ours[found[0]]:.1f}"]
    for before, driver in pairwise(found):
        alike = 100.0 * (ours[before] / ours[driver] - 1.0) < ALIKE_PERCENT
        words.append(f"{'about as' if alike else 'over'} `{driver}` {ours[driver]:.1f}")
    same = [driver for driver in found if driver in published] == told
    return (
        f"Order by Ie in {BY_ID[case].name}: published {' over '.join(f'`{d}`' for d in told)}; ours "
        f"{', '.join(words)} J/kg: {'the same' if same else 'another'}. Alike is what differs by less than "
        f"{ALIKE_PERCENT:g} %."
    )


def remarks(rows: Sequence[ReportRow], *, budget: str) -> list[str]:
    """Findings as sentences made from the rows.

    Args:
        rows: All rows of the study.
        budget: quick or paper.
    """
    peak, ie, coast = (_text(rows, "101", EITOE, kpi, d) for kpi, d in ((TOP, 2), (IE, 1), (COAST, 0)))

    def over(kpi: str, cases: Sequence[str]) -> list[str]:
        return [_percent_range(rows, case, EITOP, kpi) for case in cases]

    found = [
        _against_expert(rows),
        _missed_indices(rows),
        _order(rows, "101"),
        (
            f"EITOE drives case 1 with {ie} J/kg and {peak} m/s at most (published 380 and 19.49) and "
            f"coasts {coast} m (published 899.78)."
        ),
        (
            f"EITOP: {_text(rows, '101', EITOP, IE)} J/kg (published 364), {_share(rows, '101')} against "
            "EITOE (published -4.3 %)."
        ),
        (
            "EITOP above the attainable optimum, which knows its limits, dead time, lag and protection "
            f"(largest of all seeds): {', '.join(over(drives.ABOVE_ATTAINABLE, COMPARED))}. "
            f"{_name_missed(rows, COMPARED)} Above the optimum of its limits alone, which no driver with "
            f"this actuation reaches: {', '.join(over(drives.ABOVE, COMPARED))}."
        ),
        (
            "After a late update the optimum in hindsight is out of reach, because the drive before "
            "the update is already done. EITOP above the least energy still possible under protection once a "
            f"command given at the update acts: {', '.join(over(drives.LEFT, UPDATED))}. "
            f"{_name_missed(rows, UPDATED)} It arrives after {_arrivals(rows)}."
        ),
        (
            f"Compared with the model `manual` EITOE saves {_saving(rows, EITOE)} of Ie and EITOP "
            f"{_saving(rows, EITOP)} at 101 s (published 34.9 and 37.7 %): the model knows timetable "
            "and route and coasts, with far less than the 584 J/kg that the published percentages "
            "imply."
        ),
        (
            "The published order of comfort is not reproduced: Ic of EITOP is "
            f"{_text(rows, '101', EITOP, IC, 2)}, of EITOE {_text(rows, '101', EITOE, IC, 2)}; it "
            "accelerates harder."
        ),
    ]
    if budget == "quick":
        found.append("Learning rows are from short runs; the drives use the shipped policies.")
    return found


def _missed_indices(rows: Sequence[ReportRow]) -> str:
    """Finding on the three indices: those missed, by driver."""
    kpis = ("Is, safe", "It, on time", "Ip, parked")
    missed = [
        f"`{r.driver}`, {r.case}: {r.kpi}"
        for r in rows
        if r.kpi in kpis and r.low is not None and r.low < 1.0 and r.case != BY_ID["restricted-101"].name
    ]
    overruled = [
        f"`{r.driver}`, {r.case}"
        for r in rows
        if r.kpi == "interventions of protection" and r.high is not None and r.high > 0
    ]
    met = (
        f"Is, It and Ip are met by every driver in every case with every seed but {'; '.join(missed)}"
        if missed
        else "Is, It and Ip are met by every driver in every case with every seed"
    )
    spells = f"an intervention in some drive of {'; '.join(overruled)}" if overruled else "no intervention"
    return (
        f"{met} ({spells}). Left out is the restriction in 101 s, where the time is impossible: even flat "
        "out it takes longer, see the earliest arrival there."
    )


def _share(rows: Sequence[ReportRow], case: str) -> str:
    mine, other = _value(rows, case, EITOP, IE), _value(rows, case, EITOE, IE)
    if mine is None or other is None or not mine.ours or not other.ours:
        return "–"
    return f"{100.0 * (mine.ours / other.ours - 1.0):+.1f} %"


def _saving(rows: Sequence[ReportRow], driver: str) -> str:
    row = _value(rows, "101", driver, RELATIVE)
    return "–" if row is None or row.ours is None else f"{-row.ours:.1f} %"


def _arrivals(rows: Sequence[ReportRow]) -> str:
    parts = [
        f"{row.ours:.1f} s ({row.case})"
        for row in rows
        if (row.table, row.driver, row.kpi) == (TABLE3, EITOP, TOOK) and row.ours is not None
    ]
    return ", ".join(parts)


LEARNING = "Learning: its Figs. 5 and 6"
DECISIONS = "Decision time"
MANUAL_SEEDS = 10
Found = dict[tuple[str, str], drives.EvaluatedRun]


def reproduce(order: Order) -> StudyReport:
    """Reproduce the cases of the paper and the comparisons beyond it.

    Args:
        order: ``quick``: shipped policies, a short learning run of each. ``paper``: everything learned with
            ten seeds. Manual drives have ten seeds in both.
    """
    from metropilot.studies.huang2025.learning import jobs

    paper = order.budget == "paper"
    seeds = order.choose_seeds(quick=1, paper=10)
    folder = order.folder / "huang2025"
    results = order.learn(jobs(seeds, order.budget), folder)
    policies = _policies(folder, results, paper=paper)
    found: Found = {}
    for case in CASES:
        for driver in case.drivers:
            found[case.id, driver] = drives.drive_case(case, driver, policies, range(MANUAL_SEEDS))
        if case.told_s is None:
            arrival = float(np.median([one.running_time_s for one in found[case.id, EITOP].drives]))
            found[case.id, EQUAL_EITOE] = drives.drive_at_arrival(case, arrival)
        order.say(f"{case.name} driven")
    stops = [repeat_stops(gain) for gain in GAINS]
    rows = _rows(found)
    learned = [r for r in results if r.job.about["driver"] == EITOP]
    rows += [*_learning_rows(results), *stop_rows(stops), *beyond_rows(policies)]
    drawn = figures(found, learned, stops)
    said = remarks(rows, budget=order.budget)
    return StudyReport(len(seeds), rows, drawn, DEVIATIONS, said, CLAIMS)


def fixed_rows() -> list[ReportRow]:
    """Rows of the drivers that neither learn nor draw."""
    rows: list[ReportRow] = []
    for case in CASES:
        for driver in case.drivers:
            if driver not in (MANUAL, *LEARNED):
                found = drives.drive_case(case, driver, {}, range(1))
                rows += [*drives.rows_of(found, None), *drives.news_rows(found)]
    return rows


def _policies(folder: Path, results: Sequence[SeedResult], *, paper: bool) -> Mapping[str, Sequence[Path]]:
    """Policy files by driver: the shipped ones, or one per seed of the learning runs."""
    from metropilot.studies.huang2025.learning import write_result

    if not paper:
        return {d: [shipped_policy(d)] for d in LEARNED}
    found: dict[str, list[Path]] = {}
    for result in results:
        found.setdefault(str(result.job.about["driver"]), []).append(write_result(folder, result))
    return found


def _rows(found: Found) -> list[ReportRow]:
    """Rows of every case and driver, and of the decision times."""
    rows: list[ReportRow] = []
    for (case_id, _), one in found.items():
        rows += drives.rows_of(one, found.get((case_id, MANUAL)))
        rows += drives.news_rows(one)
    rows += _whole(found)
    drivers = dict.fromkeys(driver for _, driver in found)
    rows += [
        drives.decision_row(DECISIONS, d, [one for one in found.values() if one.driver == d]) for d in drivers
    ]
    return rows


def _whole(found: Found) -> list[ReportRow]:
    """Rows of case 3 over both sections, without the dwell time between them (as in the paper)."""
    rows, said = [], {"eitoe": 300.0, EITOP: 298.0}
    for driver in EXPERTS:
        if ("sjz", driver) not in found:
            continue
        first, second = found["sjz", driver].drives, found["xc", driver].drives
        times = [a.running_time_s + b.running_time_s for a, b in zip(first, second, strict=True)]
        place = (TABLE4, "SJZ to XHM, 298 s", driver)
        rows.append(make_row(*place, "running time", "s", times, said[driver]))
    return rows


def _learning_rows(results: Sequence[SeedResult]) -> list[ReportRow]:
    """Rows of each learner's evaluation, and of EITOP's case 1 at the first and the best evaluation."""
    rows = []
    for driver in LEARNED:
        mine = [r for r in results if r.job.about["driver"] == driver]
        row = partial(make_row, LEARNING, "policy kept", driver)
        kept = [r.kept for r in mine]
        for kpi, column, unit, factor in (
            ("drives that arrive safely and on time", "safe_share", "%", 100.0),
            ("Ie of case 1", "case1_ie_jpkg", "J/kg", 1.0),
            ("running time of case 1", "case1_time_s", "s", 1.0),
        ):
            said = LEARNED_IE[1] if (driver, column) == (EITOP, "case1_ie_jpkg") else None
            each = [r.history[f"evaluation.{column}"][k] for r, k in zip(mine, kept, strict=True)]
            rows.append(row(kpi, unit, [factor * float(value) for value in each], said))
        rows.append(row("time to learn", "s", [r.seconds for r in mine]))
    return rows


STUDY = Study(
    id="huang2025",
    title="Expert driving, and PPO inside it (Huang et al. 2025)",
    citation=CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
