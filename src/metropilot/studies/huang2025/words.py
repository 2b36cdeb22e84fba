"""What a reader must know of the results: what was reached, what was missed, and why."""

from __future__ import annotations

from collections.abc import Sequence

from metropilot.studies.huang2025.drives import ABOVE
from metropilot.studies.huang2025.published import (
    BY_ID,
    COAST,
    EITOE,
    EITOP,
    IC,
    IE,
    RELATIVE,
    TABLE3,
    TOOK,
    TOP,
)
from metropilot.studies.report import ReportRow

COMPARED = ("95", "101", "115", "sjz", "xc")


def _value(rows: Sequence[ReportRow], case: str, driver: str, kpi: str) -> ReportRow | None:
    name = BY_ID[case].name
    return next((r for r in rows if (r.case, r.driver, r.kpi) == (name, driver, kpi)), None)


def _said(rows: Sequence[ReportRow], case: str, driver: str, kpi: str, digits: int = 1) -> str:
    row = _value(rows, case, driver, kpi)
    return "–" if row is None or row.ours is None else f"{row.ours:.{digits}f}"


def _ranged(rows: Sequence[ReportRow], case: str, driver: str, kpi: str) -> str:
    row = _value(rows, case, driver, kpi)
    if row is None or row.ours is None or row.high is None:
        return "–"
    return f"{row.ours:.1f} % ({row.high:.1f} %; {BY_ID[case].name})"


def remarks(rows: Sequence[ReportRow], *, budget: str) -> list[str]:
    """What was reached and missed, from the rows themselves.

    Args:
        rows: Every row of the study.
        budget: quick or paper.
    """
    peak, ie, coast = (_said(rows, "101", EITOE, kpi, d) for kpi, d in ((TOP, 2), (IE, 1), (COAST, 0)))
    over = {case: _ranged(rows, case, EITOP, ABOVE) for case in COMPARED}
    found = [
        _met(rows),
        (
            f"EITOE drives case 1 with {ie} J/kg and {peak} m/s at most (published 380 and 19.49) and "
            f"coasts {coast} m (published 899.78)."
        ),
        (
            f"EITOP: {_said(rows, '101', EITOP, IE)} J/kg (published 364), {_share(rows, '101')} against "
            "EITOE (published -4.3 %)."
        ),
        (
            "EITOP above the optimum under its own limits (largest of all seeds): "
            f"{', '.join(over.values())}. Wanted: at most 5 % in cases 1 and 2, 6 % in case 3. The plan "
            "knows no actuation; the row below it takes the dead time off."
        ),
        (
            "After late news the optimum in hindsight is out of reach: what was driven before the news "
            "cannot be taken back; the row below it counts from the news on. Arrivals: "
            f"{_arrivals(rows)}."
        ),
        (
            f"Against our manual surrogate EITOE saves {_saved(rows, EITOE)} of Ie and EITOP "
            f"{_saved(rows, EITOP)} at 101 s (published 34.9 and 37.7 %): the surrogate knows timetable "
            "and route and coasts, far below the 584 J/kg that the published percentages imply."
        ),
        (
            "The published order of comfort is not reproduced: Ic of EITOP is "
            f"{_said(rows, '101', EITOP, IC, 2)}, of EITOE {_said(rows, '101', EITOE, IC, 2)}; it "
            "accelerates harder."
        ),
    ]
    if budget == "quick":
        found.append("Learning rows are of short runs; the drives are of the policies shipped.")
    return found


def _met(rows: Sequence[ReportRow]) -> str:
    """Which of the three indices were missed, by whom."""
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
    words = (
        "Is, It and Ip are met by every driver in every case"
        if not missed
        else "Missed: " + "; ".join(missed)
    )
    spells = f"an intervention in some drive of {'; '.join(overruled)}" if overruled else "no intervention"
    return (
        f"{words} and every seed ({spells}), apart from the restriction in 101 s, where they cannot be: "
        "even flat out it takes longer, see the earliest arrival there."
    )


def _share(rows: Sequence[ReportRow], case: str) -> str:
    mine, other = _value(rows, case, EITOP, IE), _value(rows, case, EITOE, IE)
    if mine is None or other is None or not mine.ours or not other.ours:
        return "–"
    return f"{100.0 * (mine.ours / other.ours - 1.0):+.1f} %"


def _saved(rows: Sequence[ReportRow], driver: str) -> str:
    row = _value(rows, "101", driver, RELATIVE)
    return "–" if row is None or row.ours is None else f"{-row.ours:.1f} %"


def _arrivals(rows: Sequence[ReportRow]) -> str:
    """Running time of each late news beside the time that was asked for."""
    parts = [
        f"{row.ours:.1f} s (`{row.driver}`, {row.case})"
        for row in rows
        if row.table == TABLE3 and row.kpi == TOOK and row.ours is not None
    ]
    return ", ".join(parts)
