"""`metropilot show` of what was learned: a run, a policy file, the provenance of a learned driver."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot.cli.console import console, heading, print_json, table

if TYPE_CHECKING:
    from metropilot.drivers.policy.loaded import LoadedPolicy
    from metropilot.learn import RunRecord

PROVENANCE = ("task", "algorithm", "seed", "steps", "seconds", "command", "commit", "created", "machine")


def show_learning_run(record: RunRecord, folder: Path, *, as_json: bool) -> int:
    """What was learned, from what, and how good it is."""
    from metropilot.cli.learn_report import clock, kpi_rows, learned_json

    if as_json:
        print_json(learned_json(record, folder))
        return 0
    out = console()
    told = [
        ("driver", record.driver or record.algorithm),
        ("task", record.task),
        ("seed", str(record.seed)),
        ("status", record.status),
        ("steps", f"{record.steps:,}".replace(",", " ")),
        ("time", clock(record.seconds)),
        ("begun", record.created),
        ("command", record.command),
        ("commit", record.commit_id),
        ("machine", record.machine),
        ("versions", ", ".join(f"{name} {number}" for name, number in record.versions.items())),
    ]
    out.print(table(str(folder), ("learning run", ""), [row for row in told if row[1]]))
    out.print(table("", ("KPI of the policy kept", "value", ""), kpi_rows(record.kpis), right=(1,)))
    settings = [f"{name} = {json.dumps(value)}" for name, value in record.config.items()]
    heading(out, "settings", settings)
    if record.status == "interrupted":
        out.print(f"\nGo on with: metropilot learn --resume {folder}")
    return 0


def show_policy(loaded: LoadedPolicy, *, as_json: bool) -> int:
    """A policy file: what it does and where it comes from."""
    if as_json:
        print_json({"kind": "policy", **policy_json(loaded)})
        return 0
    out = console()
    out.print(str(loaded.path), style="bold")
    say_policy(loaded)
    return 0


def policy_json(loaded: LoadedPolicy) -> dict[str, Any]:
    """A policy file as plain values."""
    told = {"file": str(loaded.path), "network": loaded.policy.policy.spec.as_dict(), **loaded.about}
    return told | {"perception": loaded.perception.as_dict()}


def say_policy(loaded: LoadedPolicy) -> None:
    """Network, perception, KPIs and provenance on the screen."""
    from metropilot.cli.learn_report import kpi_rows

    out, about, seen = console(), loaded.about, loaded.perception.as_dict()
    spec = loaded.policy.policy.spec
    layers = " - ".join(str(width) for width in (spec.observation_size, *spec.hidden, spec.width))
    assists = seen["assists"]
    heading(
        out,
        "policy",
        [
            f"network {layers}, {spec.activation}",
            f"sees {', '.join(seen['features'])}",
            f"decides every {seen['period_s']:g} s, action {_words(seen['action'])}",
            f"assists {_words(assists)}",
        ],
    )
    kpis = about.get("kpis")
    rows = kpi_rows(kpis) if isinstance(kpis, Mapping) else []
    heading(out, "KPIs on its task", [f"{words}: {value} {unit}" for words, value, unit in rows])
    told = [(name, about.get(name)) for name in PROVENANCE]
    lines = [f"{name}: {_words(value)}" for name, value in told if value is not None and value != ""]
    heading(out, "how it was learned", lines)


def _words(value: Any) -> str:  # noqa: ANN401 (whatever JSON holds)
    """A plain value in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(inner)}" for name, inner in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else json.dumps(value)
