"""`metropilot learn`."""

from __future__ import annotations

import shlex
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import print_json
from metropilot.env import TaskSite
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.learn import PolicyEvaluation, RunRecord, RunRequest, RunStore

ASKED = "What to learn"
EXAMPLES = {
    "learn": (
        "metropilot learn ppo_scaled --budget quick --out mine",
        "metropilot learn sac --task drive_jerk --steps 200000 --set batch_size=128 --seed 1",
        "metropilot learn ppo --line zurich-stadelhofen --trainset ch_stadler_flirt_tpf --out zurich",
        "metropilot learn --resume mine",
    ),
}


@opt.with_run_options(only=(), more=opt.options_of(TaskSite, ASKED))
def learn_command(
    driver: Annotated[
        str | None, typer.Argument(help="Driver to learn: ppo, ppo_scaled, ddpg, sac, naf, dqn, ...")
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            help="Task to learn; see `metropilot tasks`. The driver's own if not given.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(help="quick (two minutes, the default) or paper (as shipped).", rich_help_panel=ASKED),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Environment steps, in place of the budget's.", rich_help_panel=ASKED)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of everything random; 0.", rich_help_panel=ASKED)
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="A field of the learner's configuration; repeatable.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the run; among your runs if not given.", rich_help_panel=opt.OUTPUT),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(metavar="RUN", help="Resume a run: its folder or id.", rich_help_panel=opt.OUTPUT),
    ] = None,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Write event files, too.", rich_help_panel=opt.OUTPUT)
    ] = False,
    as_json: opt.Json = False,
    **site: str | None,
) -> int:
    """Learn a driver, or resume a run.

    An interrupted run continues with --resume and ends with the same policy. The policy kept is the one with
    the most drives from standstill that arrive safely and on time, and then the lowest cost. Exit code 0:
    learned; 2: invalid input; 130: interrupted.
    """
    from dataclasses import replace

    from metropilot.learn import TeacherConfig, evaluation_of, new_request, resume_request

    if resume is not None:
        new = {"driver": driver, "task": task, "seed": seed, "steps": steps, "budget": budget, "out": out}
        store, record = find_run(resume)
        _check_unchanged(new | site | {"set": settings or None}, record)
        if record.status == "done":
            return report_done(store, record, as_json=as_json)
        request = replace(resume_request(record, store.folder(record.id)), tensorboard=tensorboard)
        return learn_and_report(store, request, record, evaluation_of(request), as_json=as_json)
    if driver is None:
        from metropilot.learn import RECIPES

        raise InputError("missing", field="driver", allowed=", ".join(RECIPES) + ", or --resume RUN")
    budget, seed = budget or "quick", seed or 0
    if not 0 <= seed < 2**31:
        raise InputError("out of range", field="seed", value=seed, allowed="0 to 2^31 - 1")
    told = dict(map(parse_setting, settings or ())) | ({} if steps is None else {"steps": steps})
    given = {"task": task} | site | {"budget": budget, "steps": steps, "seed": seed}
    command = shlex.join(["metropilot", "learn", driver, *_policy_options(given, settings)])
    chosen = TaskSite(**site)
    request = new_request(driver, budget=budget, task=task, site=chosen, seed=seed, command=command, **told)
    request = replace(request, tensorboard=tensorboard)
    if out is not None and (out / "run.toml").exists():
        words, allowed = "the folder holds a run already", f"another, or --resume {out}"
        raise InputError(words, file=out, field="out", allowed=allowed)
    evaluate = evaluation_of(request)
    if "steps" in told and not isinstance(request.config, TeacherConfig):
        _check_steps(request, evaluate)
    store, record = create_run(request, out)
    return learn_and_report(store, request, record, evaluate, as_json=as_json)


def _policy_options(given: dict[str, Any], settings: list[str] | None) -> list[str]:
    """Options that were given and that change the learned policy."""
    told = given.items()
    words = [str(word) for name, value in told if value is not None for word in (f"--{name}", value)]
    return words + [word for text in settings or () for word in ("--set", text)]


def parse_setting(text: str) -> tuple[str, Any]:
    """Parse ``KEY=VALUE``, the value as in TOML; text needs no quotes, a list no brackets.

    Raises:
        InputError: Not of that form.
    """
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier() and value):
        raise InputError("not a setting", field="set", value=text, allowed="KEY=VALUE")
    for written in (value, f"[{value}]"):
        try:
            found = tomllib.loads(f"value = {written}")
        except tomllib.TOMLDecodeError:
            continue
        if set(found) == {"value"}:
            number = found["value"]
            whole = isinstance(number, float) and number.is_integer() and "e" in value.lower()
            return name, int(number) if whole else number
    return name, value


def _check_steps(request: RunRequest, evaluate: PolicyEvaluation) -> None:
    """Reject fewer steps than a run can have, and report more steps than requested.

    Raises:
        InputError: Fewer steps than every evaluation has after one iteration.
    """
    from metropilot.learn import make_loop

    loop = make_loop(request.config, request.task, evaluate)
    asked, whole = request.config.steps, loop.learner.iteration_steps
    least = whole * loop.chunks
    what = f"{loop.chunks} evaluations after whole iterations of {whole} steps"
    if asked < least:
        more = f"; {whole} with --set evaluations=1" if loop.chunks > 1 else ""
        raise InputError(f"too few for {what}", field="steps", value=asked, allowed=f"{least} or more{more}")
    if loop.steps > asked:
        sys.stderr.write(f"metropilot: --steps {asked} is rounded up to {loop.steps}: {what}\n")


def _check_unchanged(new: dict[str, Any], record: RunRecord) -> None:
    """Reject options that differ from those of the resumed run.

    Raises:
        InputError: An option differs.
    """
    for name, value in new.items():
        same = {"driver": record.driver, "task": record.task, "seed": record.seed}
        if value is not None and value != same.get(name):
            words = "a resumed run keeps its settings"
            raise InputError(words, field=name, value=str(value), allowed="only --resume RUN")


def create_run(request: RunRequest, out: Path | None) -> tuple[RunStore, RunRecord]:
    """Create a run's folder and record.

    Raises:
        InputError: The folder cannot be written.
    """
    from metropilot._dirs import runs_folder
    from metropilot.learn import RunStore, begin_run

    if out is None:
        store = RunStore(runs_folder())
        return store, begin_run(store, request)
    out = out.expanduser().resolve()
    store = RunStore(out.parent, indexed=False)
    return store, begin_run(store, request, out.name)


def find_run(text: str) -> tuple[RunStore, RunRecord]:
    """Find a run by its folder or by the beginning of its id.

    Raises:
        InputError: No such run.
    """
    from metropilot._dirs import runs_folder
    from metropilot.learn import RunStore

    folder = Path(text).expanduser()
    if folder.is_dir():
        folder = folder.resolve()
        store = RunStore(folder.parent, indexed=folder.parent == runs_folder().resolve())
        return store, store.show(folder.name)
    store = RunStore(runs_folder())
    return store, store.show(text)


def report_done(store: RunStore, record: RunRecord, *, as_json: bool) -> int:
    """Print the result of a run; return the exit code."""
    from metropilot.cli.learn_report import report_learned, run_as_json

    folder = store.folder(record.id)
    if as_json:
        print_json(run_as_json(record, folder))
    else:
        report_learned(record, folder)
    return 0


def learn_and_report(
    store: RunStore, request: RunRequest, record: RunRecord, evaluate: PolicyEvaluation, *, as_json: bool
) -> int:
    """Learn with progress and print the result; return the exit code."""
    from metropilot.cli.learn_report import LearnReport
    from metropilot.learn import TrainingOptions, learn_run

    folder = store.folder(record.id)
    with LearnReport(request, folder, quiet=as_json) as report:
        try:
            options = TrainingOptions(evaluate=evaluate, on_progress=report.progress)
            record, _ = learn_run(store, request, options, record.id)
        except KeyboardInterrupt:
            report.close()
            done, again = f"{report.steps:,} steps".replace(",", " "), shlex.quote(str(folder))
            told = f"interrupted after {done}; resume with: metropilot learn --resume {again}"
            raise typer.Abort(told) from None
    return report_done(store, record, as_json=as_json)
