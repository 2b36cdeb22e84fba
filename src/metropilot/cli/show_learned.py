"""`metropilot show` of learned results: a run, a policy file, the provenance of a learned driver."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from metropilot.cli.console import console, heading, print_json, table

if TYPE_CHECKING:
    from metropilot.learn import RunRecord
    from metropilot.policy import Policy

APART = ("perception", "kpis", "config", "provenance")
"""Metadata keys of a policy file that have their own heading."""


class PolicyFile(NamedTuple):
    """Contents of a policy file.

    Attributes:
        path: Path of the file.
        policy: The policy.
        about: Metadata of the file.
    """

    path: Path
    policy: Policy
    about: Mapping[str, Any]


def read_policy(path: Path) -> PolicyFile:
    """Read a policy file of a driver or of another user of policies.

    Raises:
        InputError: The file cannot be used.
    """
    from metropilot.policy import load_policy

    return PolicyFile(path, *load_policy(path))


def show_learning_run(record: RunRecord, folder: Path, *, as_json: bool) -> int:
    """Show task, configuration and results of a learning run."""
    from metropilot.cli.learn_report import clock, kpi_rows, run_as_json

    if as_json:
        print_json(run_as_json(record, folder))
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
        out.print(f"\nResume with: metropilot learn --resume {folder}")
    return 0


def show_policy(file: PolicyFile, *, as_json: bool) -> int:
    """Show interface and provenance of a policy file."""
    if as_json:
        print_json({"kind": "policy", **policy_json(file)})
        return 0
    out = console()
    out.print(str(file.path), style="bold")
    say_policy(file)
    return 0


def policy_json(file: PolicyFile) -> dict[str, Any]:
    """A policy file as plain values."""
    return {"file": str(file.path), "network": file.policy.spec.as_dict(), **file.about}


def say_policy(file: PolicyFile) -> None:
    """Print network, policy interface, KPIs and provenance."""
    from metropilot.cli.learn_report import kpi_rows

    out, about, spec = console(), file.about, file.policy.spec
    layers = " - ".join(str(width) for width in (spec.observation_size, *spec.hidden, spec.width))
    network = [f"network: {layers}, {spec.activation}"]
    heading(out, "policy", network + _lines(about.get("perception")))
    kpis = about.get("kpis")
    known = kpi_rows(kpis) if isinstance(kpis, Mapping) else []
    rows = [f"{words}: {value} {unit}".rstrip() for words, value, unit in known]
    heading(out, "KPIs on its task", rows or _lines(kpis))
    told = {name: value for name, value in about.items() if name not in APART}
    heading(out, "training", _lines(told) + _lines(about.get("provenance")))
    heading(out, "settings", _lines(about.get("config")))


def _lines(values: object) -> list[str]:
    """Lines of a table of plain values, empty entries left out."""
    told = values if isinstance(values, Mapping) else {}
    return [f"{name}: {_words(value)}" for name, value in told.items() if value is not None and value != ""]


def _words(value: Any) -> str:  # noqa: ANN401 (whatever JSON holds)
    """Format a plain value."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(inner)}" for name, inner in value.items())
    if isinstance(value, list):
        return ", ".join(_words(inner) for inner in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else json.dumps(value)
