"""Kinds of jobs, each one row: request, check, work and result, and the files that it leaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from metropilot.errors import InputError
from metropilot.evaluate import POLICY, RunSpec
from metropilot.web.schemas import requests, responses
from metropilot.web.words.language import N_
from metropilot.web.work import campaigns, drives, exports, fits, learning, operations

if TYPE_CHECKING:
    from metropilot.web.service import Service

MOST = 6
"""Largest number of trainsets of a live convoy."""
DRIVEN = ("trajectory.csv", "kpis.json", "explanation.json", "profile.svg", "profile.png", "run.toml")


@dataclass(frozen=True, kw_only=True)
class KindRow:
    """A kind of jobs, or of live runs.

    Attributes:
        words: What a list calls it.
        body: Its request.
        result: Its result; None: that of a convoy, which is checked by its keys.
        files: Names of the files that it leaves to be taken one by one.
        check: Checks a request before it waits; raises InputError where the job is not possible.
        work: Function of its worker, after folder and id called with ``values``; None: not computed by one.
        values: Values for the worker, of a request and of the learning run that goes on.
        long: True if it takes hours: it has the worker without a bound on its memory.
        checkpoints: True if it ends by itself when it is stopped, and goes on from there.
    """

    words: str
    body: type[Any]
    result: type[BaseModel] | None
    files: tuple[str, ...] = ()
    check: Callable[[Service, Any], object] = lambda service, body: None  # noqa: ARG005
    work: Callable[..., dict[str, Any]] | None = None
    values: Callable[[Service, Any, str | None], tuple[Any, ...]] = lambda service, body, run: ()  # noqa: ARG005
    long: bool = False
    checkpoints: bool = False


def request_values(body: BaseModel) -> dict[str, Any]:
    """Request of a job as it is stored: of a campaign, which is a file, only what it says."""
    return body.model_dump(by_alias=True, exclude_unset=isinstance(body, requests.CampaignIn))


def live_kind(request: Mapping[str, Any]) -> str:
    """Kind of a live run, one of ``LIVE``, by its request."""
    return "convoy" if "follower" in request else "line" if "headway_s" in request else "run"


def check_driver(request: RunSpec) -> None:
    """Make the driver and read its policy.

    Raises:
        InputError: No such driver or option, or the policy is none of this driver's.
    """
    driver = request.make_driver()
    try:
        driver.read_policy()
    except InputError as error:
        told = {"value": error.value, "unit": error.unit, "allowed": error.allowed}
        raise InputError(error.message, field=f"options.{POLICY}", **told) from None


def _of_request(make: Callable[[Service, Any], Any]) -> dict[str, Any]:
    """Check and values of a kind whose worker takes one request, which is checked by reading it."""
    return {
        "check": lambda service, body: make(service, body).read(),
        "values": lambda service, body, _: (make(service, body),),
    }


def _check_drive(service: Service, body: requests.DriveIn) -> None:
    request = service.run_spec(body)
    request.run()
    check_driver(request)


def _check_compare(service: Service, body: requests.CompareIn) -> None:
    service.run_spec(body).run()
    _drivers_of(service, body)


def _drivers_of(service: Service, body: requests.CompareIn) -> dict[str, str]:
    """Drivers of a comparison for :func:`metropilot.evaluate.compare`, by name.

    Raises:
        InputError: No such driver, or no such option of it.
    """
    found = {}
    for name in body.drivers:
        options = body.options if name == body.driver else {}
        request = service.run_spec(body.model_copy(update={"driver": name, "options": options}))
        check_driver(request)
        found[name] = ":".join([request.driver, *(f"{k}={v}" for k, v in request.options.items())])
    return found


def _check_campaign(service: Service, body: requests.CampaignIn) -> None:
    campaigns.read_declared(service.campaign_values(body), service.settings.campaign_rows)


def _check_learning(service: Service, body: requests.LearnIn) -> None:
    from metropilot.learn import recipe

    row = recipe(body.driver)
    row.configuration(body.budget, **learning.recipe_fields(body.model_dump()))
    row.task_configuration(body.task, learning.site_of(service.learn_values(body)))


def _check_study(_: Service, body: requests.StudyIn) -> None:
    from metropilot.studies import STUDIES

    STUDIES.get(body.study)


LIVE = {
    "run": KindRow(words=N_("Live run"), body=requests.LiveIn, result=responses.DriveOut),
    "convoy": KindRow(words=N_("Convoy"), body=requests.ConvoyIn, result=None),
    "line": KindRow(words=N_("Running line"), body=requests.RunningLineIn, result=responses.RunningLineOut),
}
"""Kinds of live runs by what is driven."""
JOB_KINDS: dict[str, KindRow] = {
    "drive": KindRow(
        words=N_("Drive"),
        body=requests.DriveIn,
        result=responses.DriveOut,
        files=DRIVEN,
        check=_check_drive,
        work=drives.drive_job,
        values=lambda service, body, _: (service.run_spec(body),),
    ),
    "compare": KindRow(
        words=N_("Comparison"),
        body=requests.CompareIn,
        result=responses.CompareOut,
        files=("comparison.json", "comparison.svg", "comparison.png", "run.toml"),
        check=_check_compare,
        work=drives.compare_job,
        values=lambda service, body, _: (service.run_spec(body), _drivers_of(service, body), body.seeds),
    ),
    "journey": KindRow(words=N_("Journey"), body=requests.JourneyIn, result=responses.JourneyOut),
    "line": KindRow(
        words=N_("Line"),
        body=requests.OperationIn,
        result=responses.OperationOut,
        files=(
            *("line.json", "day.json", "run.toml", "timetable.csv", "timetable.parquet", "gtfs.zip"),
            *(f"{name}.{kind}" for name in ("trains", "power", "voltage") for kind in ("svg", "png")),
        ),
        work=operations.line_job,
        **_of_request(lambda service, body: service.operation_request(body)),
    ),
    "campaign": KindRow(
        words=N_("Campaign"),
        body=requests.CampaignIn,
        result=responses.CampaignResult,
        files=(campaigns.RESULTS,),
        check=_check_campaign,
        work=campaigns.campaign_job,
        values=lambda service, body, _: (service.campaign_values(body),),
        long=True,
        checkpoints=True,
    ),
    "export": KindRow(
        words=N_("Export"),
        body=requests.ExportIn,
        result=responses.ExportResult,
        work=exports.export_job,
        **_of_request(lambda service, body: service.export_request(body)),
        long=True,
    ),
    "fit": KindRow(
        words=N_("Fit"),
        body=requests.FitIn,
        result=responses.FitOut,
        files=(fits.TRAINSET, "fit.json", "residuals.svg", "residuals.png"),
        work=fits.fit_job,
        **_of_request(lambda service, body: service.fit_request(body)),
    ),
    "learn": KindRow(
        words=N_("Learning run"),
        body=requests.LearnIn,
        result=responses.LearnResult,
        check=_check_learning,
        work=learning.learn_job,
        values=lambda service, body, run: (service.learn_values(body), run),
        long=True,
        checkpoints=True,
    ),
    "study": KindRow(
        words=N_("Study"),
        body=requests.StudyIn,
        result=responses.StudyResult,
        check=_check_study,
        work=learning.study_job,
        values=lambda _, body, run: (request_values(body),),  # noqa: ARG005
        long=True,
    ),
    "live": replace(
        LIVE["run"],
        files=(
            *(*DRIVEN, "run.json", "convoy.svg", "convoy.png", "trajectories.zip", "delays.csv"),
            *(f"trajectory-{k + 1}.csv" for k in range(MOST)),
        ),
    ),
}
"""Kinds of jobs by id."""


def row_of(kind: str, request: object) -> KindRow:
    """Row of a job: of a live run that of what is driven.

    Raises:
        KeyError: No such kind.
    """
    if kind == "live" and isinstance(request, Mapping):
        return LIVE[live_kind(request)]
    return JOB_KINDS[kind]
