"""Rows of the tables of a run in the language of the answer, for pages and reports."""

from __future__ import annotations

from typing import Any

from metropilot import evaluate
from metropilot.units import J_PER_KWH, KMH_PER_MPS
from metropilot.web.words.language import _
from metropilot.web.words.said import retell


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """Format a number with its unit; a dash for None."""
    if value is None:
        return "–"
    return f"{value:.{digits}f}".replace("-", "−") + (f" {unit}" if unit else "")


def check_rows(checks: list[dict[str, Any]]) -> list[tuple[str, str, str, bool]]:
    """Requirements: name, measured, allowed, whether it is met."""
    return [(retell(c["name"]), retell(c["value"]), retell(c["wanted"]), c["passed"]) for c in checks]


def translate_kpis(kpis: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Main KPIs: name, value, remark."""
    return [
        (retell(row.name), row.value.replace("-", "−"), retell(row.remark)) for row in evaluate.kpi_rows(kpis)
    ]


def regime_table(told: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings, and regimes of a drive: where, when, what bound it, energy, loss to trainset and driver."""
    columns = (
        _("regime"),
        _("place (m)"),
        _("time (s)"),
        _("mostly bound by"),
        _("energy (kWh)"),
        _("trainset"),
        _("driver"),
    )
    rows = [
        (
            retell(span["regime"]),
            f"{span['from_m']:.0f} – {span['to_m']:.0f}",
            f"{span['from_s']:.1f} – {span['to_s']:.1f}",
            retell(span["bound"]),
            number(span["energy_wheel_j"] / J_PER_KWH, 2),
            *(
                number(None if span[name] is None else span[name] / J_PER_KWH, 3)
                for name in ("trainset_loss_j", "driver_loss_j")
            ),
        )
        for span in told["regimes"]
    ]
    return columns, rows


def hit_table(told: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings, and interventions of protection."""
    columns = (
        _("guard"),
        _("place (m)"),
        _("time (s)"),
        _("speed (km/h)"),
        _("permitted"),
        _("falls until (m)"),
    )
    rows = [
        (
            retell(hit["guard"]),
            f"{hit['from_m']:.0f} – {hit['to_m']:.0f}",
            f"{hit['from_s']:.1f} – {hit['to_s']:.1f}",
            number(KMH_PER_MPS * hit["speed_mps"], 1),
            number(KMH_PER_MPS * hit["permitted_mps"], 1),
            number(hit["ahead_m"], 0),
        )
        for hit in told["interventions"]
    ]
    return columns, rows


def explain_words(told: dict[str, Any], kpis: dict[str, Any]) -> str:
    """Sum up what bound a drive, and where the driver lost most."""
    whole = sum(span["to_s"] - span["from_s"] for span in told["bounds"])
    times: dict[str, float] = {}
    for span in told["bounds"]:
        times[span["bound"]] = times.get(span["bound"], 0.0) + span["to_s"] - span["from_s"]
    parts = [
        f"{retell(words)} {100 * time_s / whole:.0f} %"
        for words, time_s in sorted(times.items(), key=lambda item: -item[1])
        if time_s >= 0.005 * whole > 0
    ]
    said = [_("Bound by {parts} of the time.", parts=", ".join(parts))]
    lost = [span for span in told["regimes"] if span["driver_loss_j"] is not None]
    if lost and kpis["trainset_gap_percent"] is not None:
        worst = max(lost, key=lambda span: span["driver_loss_j"])
        said.append(
            _(
                "Above the optimum: {trainset} % trainset, {driver} % driver, most of it in {regime} from "
                "{begin} to {end} m.",
                trainset=f"{kpis['trainset_gap_percent']:.1f}",
                driver=f"{kpis['driver_gap_percent']:.1f}",
                regime=retell(worst["regime"]),
                begin=f"{worst['from_m']:.0f}",
                end=f"{worst['to_m']:.0f}",
            )
        )
    count = len(told["interventions"])
    said.append(
        _("Protection stepped in {count} times.", count=count) if count else _("Protection never stepped in.")
    )
    return " ".join(said)
