"""Typed client of metropilot's console over HTTP; the standard library alone.

Written by `python tools/http_client.py` from the API's OpenAPI description; do not edit.

    client = Client("http://127.0.0.1:8060")
    plan = client.planning.plan({"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0})
"""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple, NotRequired, TypedDict
from urllib.parse import quote, urlencode
from uuid import uuid4

OVER = ("done", "failed", "stopped", "interrupted")


class ApiError(Exception):
    """Refusal of the server, or failure of a job: one line that says what, where, and what is allowed.

    Attributes:
        status: HTTP status; 0 of a job that failed.
        detail: Message, file, field, value, unit and allowed values.
    """

    def __init__(self, status: int, detail: Mapping[str, Any]) -> None:
        self.status, self.detail = status, dict(detail)
        where = ": ".join(str(detail[key]) for key in ("file", "field") if detail.get(key))
        allowed = f" (allowed: {detail['allowed']})" if detail.get("allowed") else ""
        super().__init__((f"{where}: " if where else "") + str(detail.get("message", "")) + allowed)


class StreamEvent(NamedTuple):
    """An event of a live run.

    Attributes:
        id: Its number, by which a stream goes on.
        kind: ``scene``, ``rows``, ``event``, ``result``, ``error`` or ``end``.
        data: Its values.
    """

    id: int
    kind: str
    data: Any


class Connection:
    """Requests to one server.

    Args:
        url: Address of the server.
        token: Its token; None: it has none.
        timeout_s: Longest wait for an answer.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = 120.0) -> None:
        self.url, self.timeout_s = url.rstrip("/"), timeout_s
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}

    def open(
        self, method: str, path: str, query: Mapping[str, Any], data: bytes | None, kind: str, **more: str
    ) -> Any:
        """Send a request; return the open answer.

        Raises:
            ApiError: The server refused it.
        """
        told = {name: value for name, value in query.items() if value is not None}
        told = {name: str(v).lower() if isinstance(v, bool) else v for name, v in told.items()}
        url = self.url + path + (f"?{urlencode(told)}" if told else "")
        headers = self.headers | more | ({"Content-Type": kind} if data is not None else {})
        try:
            return urllib.request.urlopen(
                urllib.request.Request(url, data, headers, method=method), timeout=self.timeout_s
            )
        except urllib.error.HTTPError as error:
            with error:
                text = error.read().decode("utf-8", "replace")
            try:
                detail = json.loads(text)["error"]
            except (KeyError, TypeError, ValueError):
                detail = {"message": text[:200]}
            raise ApiError(error.code, detail) from None

    def send(self, method: str, path: str, query: Mapping[str, Any], body: Any = None) -> bytes:
        """Send a request with a JSON body, or none; return the answer."""
        data = None if body is None else json.dumps(body).encode()
        with self.open(method, path, query, data, "application/json") as answer:
            return answer.read()

    def send_file(self, method: str, path: str, name: str, content: bytes) -> bytes:
        """Send a file; return the answer."""
        mark = uuid4().hex
        shown = name.replace('"', "_").replace("\r", "_").replace("\n", "_")
        head = f'--{mark}\r\nContent-Disposition: form-data; name="file"; filename="{shown}"\r\n\r\n'
        data = head.encode() + content + f"\r\n--{mark}--\r\n".encode()
        with self.open(method, path, {}, data, f"multipart/form-data; boundary={mark}") as answer:
            return answer.read()

    def listen(self, path: str, last_event_id: int | None) -> Iterator[StreamEvent]:
        """Read events until the stream ends."""
        more = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
        with self.open("GET", path, {}, None, "", **more) as answer:
            number, kind = 0, "message"
            for line in answer:
                name, _, value = line.decode().rstrip("\r\n").partition(": ")
                if name == "id":
                    number = int(value)
                elif name == "event":
                    kind = value
                elif name == "data":
                    yield StreamEvent(number, kind, json.loads(value))


class ArrivalIn(TypedDict):
    """A new scheduled running time, sent ``at_s`` after departure."""

    scheduled_time_s: float
    at_s: float


class BottleneckOut(TypedDict):
    """The place that needs the longest headway."""

    kind: str
    name: str
    headway_s: float
    direction: str


class BoundOut(TypedDict):
    """A part of a drive that one thing bound."""

    bound: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float


class CallOut(TypedDict):
    """A call of a journey; running time and energy since the last stop."""

    station: str
    position_m: float
    arrival_s: float
    departure_s: float
    running_time_s: float
    minimum_running_time_s: float
    energy_j: float


class CampaignArrival(TypedDict):
    """A new running time over the scheduled one, announced at a share of that."""

    factor: float
    announced: float


class CampaignDisturbance(TypedDict):
    """A disturbance: numbers, or intervals to draw from, and what is announced."""

    mass_factor: NotRequired[float | list[float] | None]
    resistance_factor: NotRequired[float | list[float] | None]
    delay_s: NotRequired[float | list[float] | None]
    lag_s: NotRequired[float | list[float] | None]
    speed_noise_mps: NotRequired[float | list[float] | None]
    headwind_mps: NotRequired[float | list[float] | None]
    adhesion: NotRequired[float | list[float] | None]
    brake_factor: NotRequired[float | list[float] | None]
    name: str
    ideal: NotRequired[bool]
    restriction: NotRequired[CampaignRestriction | None]
    arrival: NotRequired[CampaignArrival | None]
    actuation: NotRequired[list[float] | None]


class CampaignIn(TypedDict):
    """A campaign of drives: the values of its TOML file, lines, trainsets and policies by id."""

    name: str
    objective: NotRequired[Literal["wheel", "line"]]
    dt_s: NotRequired[float]
    engine: NotRequired[Literal["host", "compiled"]]
    matrix: CampaignMatrix
    disturbance: NotRequired[list[CampaignDisturbance]]


class CampaignMatrix(TypedDict):
    """The axes of a campaign."""

    drivers: list[str] | Literal["all"]
    sections: list[str]
    trainsets: NotRequired[list[str | DrawnTrainsets] | DrawnTrainsets]
    actuation: NotRequired[list[Literal["own"] | list[float]]]
    periods: NotRequired[list[float] | None]
    sample: NotRequired[int | None]
    loads: NotRequired[list[str] | Literal["all"]]
    times: NotRequired[list[Literal["planned"] | float]]
    seeds: NotRequired[int]
    first_seed: NotRequired[int]


class CampaignOut(TypedDict):
    """A campaign: how it was computed, and statistics by driver, and by driver and disturbance."""

    id: str
    name: str
    rows: int
    done: int
    status: Literal["queued", "running", "done", "failed", "stopped", "interrupted"]
    words: str
    written: str
    matrix: str
    drivers: list[dict[str, Any]]
    cells: list[dict[str, Any]]


CampaignRestriction = TypedDict(
    "CampaignRestriction",
    {
        "from": "float",
        "to": "float",
        "kmh": "float",
        "announced": "NotRequired[float | None]",
    },
)
"""A restriction: its ends as shares of the section, announced at a share of the scheduled time."""


class CampaignRow(TypedDict):
    """A campaign in a list: published with its page, or a job of this server."""

    id: str
    name: str
    rows: int
    done: int
    status: Literal["queued", "running", "done", "failed", "stopped", "interrupted"]
    words: str


class CampaignRowsOut(TypedDict):
    """Rows of a campaign: how many have the values that were asked for, and some of them."""

    count: int
    rows: list[dict[str, Any]]


class CheckOut(TypedDict):
    """A requirement of a run."""

    name: str
    value: str
    wanted: str
    passed: bool


class CompareIn(TypedDict):
    """Several drivers on one run."""

    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]
    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]
    driver: NotRequired[str]
    options: NotRequired[dict[str, bool | int | float | str]]
    arrivals: NotRequired[list[ArrivalIn]]
    dt_s: NotRequired[float]
    seed: NotRequired[int]
    drivers: NotRequired[list[str]]
    seeds: NotRequired[int]


class CompareOut(TypedDict):
    """Several drivers on one run."""

    entries: list[EntryOut]


class ConvoyIn(TypedDict):
    """A live convoy: the head's run, the followers and the link between them.

    Its disturbance acts on every trainset, unless each has one of its own. ``behind``: trainsets of the
    followers, if not the head's; the last also stands for those after it.
    """

    gap_m: NotRequired[float]
    start_gap_m: NotRequired[float | None]
    apart_m: NotRequired[float]
    uncouple_at_m: NotRequired[float | None]
    guard: NotRequired[Literal["coupled", "independent", "moving_block", "none"]]
    emergency_s: NotRequired[float | None]
    link_delay_s: NotRequired[float]
    link_jitter_s: NotRequired[float]
    link_loss: NotRequired[float]
    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]
    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]
    driver: NotRequired[str]
    options: NotRequired[dict[str, bool | int | float | str]]
    arrivals: NotRequired[list[ArrivalIn]]
    dt_s: NotRequired[float]
    seed: NotRequired[int]
    trainsets: NotRequired[int]
    follower: NotRequired[str]
    behind: NotRequired[list[str]]
    disturbances: NotRequired[list[DisturbanceIn]]
    pace: NotRequired[float]


class DayRow(TypedDict):
    """A working day of a line."""

    id: str
    name: str
    line: str
    first_s: float
    last_s: float


class DecisionOut(TypedDict):
    """Decision of a learned driver; its shares sum up to the output less that of the mean observation.

    ``meaning``: what a positive share speaks for.
    """

    time_s: float
    position_m: float
    output: float
    usual: float
    meaning: str
    shares: list[FeatureShareOut]


class DifferenceOut(TypedDict):
    """Two drives of one section at the same positions; of each pair the first is that of the path."""

    drivers: list[str]
    position_m: list[float]
    speed_mps: list[list[float]]
    time_s: list[list[float]]
    energy_wheel_j: list[list[float]]
    energy_line_j: list[list[float]]
    kpis: list[KpiPair]


class DisturbanceIn(TypedDict):
    """Values of DisturbanceIn."""

    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]


class DrawnTrainsets(TypedDict):
    """Random trainsets: how many, and the seed."""

    drawn: int
    seed: NotRequired[int]


class DriveIn(TypedDict):
    """A run: the plan's fields, the driver, the disturbance and timetable updates."""

    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]
    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]
    driver: NotRequired[str]
    options: NotRequired[dict[str, bool | int | float | str]]
    arrivals: NotRequired[list[ArrivalIn]]
    dt_s: NotRequired[float]
    seed: NotRequired[int]


class DriveOut(TypedDict):
    """A drive: KPIs as in `kpis.json`, requirements, columns of `trajectory.csv`, and its reasons."""

    driver: str
    success: bool
    kpis: dict[str, Any]
    checks: list[CheckOut]
    columns: dict[str, list[Any]]
    plan: PlanOut | None
    explanation: NotRequired[ExplanationOut | None]


class DriverOut(TypedDict):
    """A driver."""

    id: str
    summary: str
    source: str
    options: dict[str, Any]


class EntryOut(TypedDict):
    """One driver of a comparison; the drive is that of the first seed."""

    driver: str
    successes: int
    seeds: int
    outcomes: list[str]
    kpis: dict[str, IntervalOut | None]
    drive: DriveOut


class EventOut(TypedDict):
    """Confirmation of an event of a live run, with its time since departure."""

    id: str
    at_s: float


class ExplanationOut(TypedDict):
    """Reasons of a drive, as in `explanation.json`; losses at the wheel, empty where they are unknown."""

    regimes: list[RegimeOut]
    bounds: list[BoundOut]
    interventions: list[InterventionOut]
    position_m: list[float]
    trainset_loss_j: list[float]
    driver_loss_j: list[float]
    prices: NotRequired[list[TimePriceOut]]
    decisions: NotRequired[list[DecisionOut]]


class ExportIn(TypedDict):
    """A learned driver under protection as C for a controller, or as WebAssembly for a page."""

    driver: NotRequired[str]
    line: NotRequired[str]
    origin: NotRequired[str | None]
    destination: NotRequired[str | None]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    to: NotRequired[Literal["c", "wasm"]]
    number: NotRequired[Literal["double", "float"]]


class FeatureShareOut(TypedDict):
    """Share of a feature in a learned driver's decision."""

    feature: str
    words: str
    share: float


class FeedingRow(TypedDict):
    """A DC network."""

    id: str
    name: str
    lines: list[str]


class FiledIn(TypedDict):
    """The project of a job or upload; null for none."""

    project: str | None


class FitIn(TypedDict):
    """A fit of a trainset to uploaded logs, as `metropilot fit`.

    The section is that of every log, for its gradients; without one a gradient column is read. ``input``:
    of the model; null: the command where every log has one. ``keep``: parameters that are not estimated.
    """

    logs: list[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    line: NotRequired[str | None]
    origin: NotRequired[str | None]
    destination: NotRequired[str | None]
    input: NotRequired[Literal["command", "effort"] | None]
    keep: NotRequired[list[Literal["mass", "brake", "resistance", "delay", "lag"]]]
    resistance: NotRequired[Literal["auto", "factor", "coefficients"]]


class FitOut(TypedDict):
    """A fit: `fit.json` without its correlations, and the curves of `residuals.svg`."""

    trainset: str
    load: str
    input: Literal["command", "effort"]
    logs: list[str]
    runs: int
    samples: int
    residual_mps: float
    mass_kg: float
    parameters: list[FittedOut]
    resistance: list[FittedOut]
    notes: list[str]
    ambiguities: list[str]
    residuals: ResidualsOut


class FitSaveIn(TypedDict):
    """Place of a fitted trainset: the next version of an own trainset, or (null) a new entry."""

    upload: NotRequired[str | None]


class FittedOut(TypedDict):
    """A parameter with its 95 % interval; kept at the trainset's value where it is not estimated."""

    id: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    nominal: float
    estimated: bool


class FrontOut(TypedDict):
    """Optimal energy over running time; ``second_w``: energy saved by one more second."""

    minimum_running_time_s: float
    time_s: list[float]
    energy_j: list[float]
    second_w: list[float]


class GraphStopOut(TypedDict):
    """A stop of a train graph."""

    code: str
    position_m: float


class Health(TypedDict):
    """State of the server."""

    version: str
    jobs_running: int
    live_runs: int
    live_runs_waiting: int


class HistoryOut(TypedDict):
    """The history of a learning run: columns of equal length, null where there is none."""

    columns: dict[str, list[float | None]]


class IntervalOut(TypedDict):
    """A mean over seeds with its 95 % interval."""

    mean: float
    low: float
    high: float


class InterventionOut(TypedDict):
    """An intervention of protection, and the position up to which the permitted speed fell from there."""

    guard: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float
    speed_mps: float
    permitted_mps: float
    ahead_m: float


class JobOut(TypedDict):
    """A job: its name, request, progress, status, result in short, its error if it failed, who began
    it.
    """

    id: str
    kind: Literal[
        "drive", "compare", "journey", "line", "campaign", "export", "fit", "learn", "study", "live"
    ]
    status: Literal["queued", "running", "done", "failed", "stopped", "interrupted"]
    request: dict[str, Any]
    created: str
    progress: float
    words: str
    run: str | None
    error: dict[str, Any] | None
    name: str
    summary: JobSummary
    project: str | None
    user: str | None


class JobSummary(TypedDict):
    """A result in short; of a convoy the time of its head and the energy of all."""

    outcome: NotRequired[str | None]
    success: NotRequired[bool | None]
    time_s: NotRequired[float | None]
    energy_kwh: NotRequired[float | None]
    gap_percent: NotRequired[float | None]


class JourneyIn(TypedDict):
    """A journey that calls at every station; with ``total_s`` its reserve is spread optimally."""

    line: NotRequired[str]
    origin: NotRequired[str | None]
    destination: NotRequired[str | None]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    total_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]


class JourneyOut(TypedDict):
    """A journey: its calls, and the path of the head over time, dwells included."""

    calls: list[CallOut]
    time_s: list[float]
    position_m: list[float]
    speed_mps: list[float]
    running_time_s: float
    energy_j: float
    bound_j: float
    planned_energy_j: float | None


class KpiPair(TypedDict):
    """A number of two drives; null where one has none."""

    name: str
    first: float | None
    second: float | None


class LearnIn(TypedDict):
    """A learning run of a recipe; null stands for the recipe's own value.

    ``line``: its sections are learned instead of the task's, ``sections`` as ORIGIN-DESTINATION,..., or
    all of them, both ways. ``trainset``: instead of the task's, with ``load`` or each of its loads.
    """

    driver: NotRequired[str]
    budget: NotRequired[Literal["quick", "paper"]]
    task: NotRequired[str | None]
    line: NotRequired[str | None]
    sections: NotRequired[str | None]
    trainset: NotRequired[str | None]
    load: NotRequired[str | None]
    steps: NotRequired[int | None]
    evaluations: NotRequired[int | None]
    seed: NotRequired[int]


class Lever(TypedDict):
    """Manual driving: a share of the effort, null to return the lever to the driver. Renew it within 3
    s.

    The lever has one holder at a time, named here. Another holder is refused (409) unless ``take_over``
    is true.
    """

    share: float | None
    holder: NotRequired[str]
    take_over: NotRequired[bool]


class LeverOut(TypedDict):
    """Holder of the lever, and the time since departure at which it was taken."""

    holder: str
    since_s: float


class LineOut(TypedDict):
    """A line: limits in m/s, gradients in permil, positive uphill in the forward direction."""

    id: str
    name: str
    stations: int
    length_m: float
    uploaded: bool
    stops: list[StationOut]
    sections: list[SectionRow]
    dwell_s: list[float]
    limit_mps: Pieces
    gradient_permil: Pieces
    source: dict[str, str]
    notes: list[str]
    unused: list[str]


class LineRow(TypedDict):
    """A line in a list."""

    id: str
    name: str
    stations: int
    length_m: float
    uploaded: bool


class LiveIn(TypedDict):
    """A live run and its pace: 1 is real time, 0 pauses it."""

    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]
    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]
    driver: NotRequired[str]
    options: NotRequired[dict[str, bool | int | float | str]]
    arrivals: NotRequired[list[ArrivalIn]]
    dt_s: NotRequired[float]
    seed: NotRequired[int]
    pace: NotRequired[float]


class LiveOut(TypedDict):
    """A live run; ``lever`` is null while the driver drives, ``place`` that in the queue while it
    waits.
    """

    id: str
    status: Literal["queued", "running", "done", "failed", "stopped", "interrupted"]
    place: int | None
    user: str | None
    request: dict[str, Any]
    time_s: float
    position_m: float
    pace: float
    behind_s: float
    viewers: int
    scheduled_time_s: float | None
    lever: LeverOut | None
    outcome: str | None
    error: dict[str, Any] | None


class NameIn(TypedDict):
    """A name of a job; empty removes it."""

    name: str


class NewArrival(TypedDict):
    """A new scheduled running time, sent now."""

    scheduled_time_s: float


class NewHold(TypedDict):
    """Hold the next train of a running line that departs from a station."""

    hold_s: NotRequired[float]
    station: str
    backward: NotRequired[bool]


class NewLink(TypedDict):
    """New delay, jitter and loss of the link of a convoy."""

    delay_s: NotRequired[float]
    jitter_s: NotRequired[float]
    loss: NotRequired[float]
    silent: NotRequired[bool]


class NewRestriction(TypedDict):
    """A temporary speed restriction ahead, sent now."""

    from_m: float
    to_m: float
    limit_mps: float


class NewSlowSection(TypedDict):
    """Restrict the speed of the section of a running line that begins at a station, for some time."""

    limit_mps: NotRequired[float]
    lasts_s: NotRequired[float]
    station: str
    backward: NotRequired[bool]


class OperationIn(TypedDict):
    """A line in operation at a headway, or through a working day.

    ``optimise`` searches dwells and running times too, not only the offset of the directions.
    """

    headway_s: NotRequired[int]
    dwell_s: NotRequired[int]
    dwell_window_s: NotRequired[int]
    time_window_s: NotRequired[int]
    turnround_s: NotRequired[int]
    reserve: NotRequired[float]
    zones: NotRequired[int]
    age_s: NotRequired[float]
    blocks: NotRequired[int | None]
    transfer_loss: NotRequired[float]
    efficiency_traction: NotRequired[float | None]
    efficiency_braking: NotRequired[float | None]
    line: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    day: NotRequired[str | None]
    feeding: NotRequired[str | None]
    optimise: NotRequired[bool]
    seed: NotRequired[int]


class OperationOut(TypedDict):
    """A line in operation: energies as in `line.json` or `day.json`, train graph, names of the files."""

    energies: dict[str, Any]
    bottleneck: BottleneckOut | None
    graph: TrainGraphOut
    files: list[str]


class Pace(TypedDict):
    """Pace of a live run: 1 is real time, 0 pauses it."""

    pace: float


class PathOut(TypedDict):
    """Pieces of a train graph, one after the other; null parts them."""

    time_s: list[float | None]
    position_m: list[float | None]


class Pieces(TypedDict):
    """A piecewise-constant profile: each value holds from its position to the next."""

    from_m: list[float]
    value: list[float]


class PlanIn(TypedDict):
    """A plan: the scheduled running time and the energy objective."""

    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]


class PlanOut(TypedDict):
    """The optimal plan, its certificate, and the energy that the next second saves."""

    position_m: list[float]
    speed_mps: list[float]
    time_s: list[float]
    energy_wheel_so_far_j: list[float]
    running_time_s: float
    minimum_running_time_s: float
    energy_j: float
    bound_j: float
    certificate_gap: float
    second_w: float


class PlansOut(TypedDict):
    """The optimal plan; ``plant``: what the true plant can attain with its actuation under protection.

    Null without a disturbance, and where the true plant cannot keep the running time.
    """

    position_m: list[float]
    speed_mps: list[float]
    time_s: list[float]
    energy_wheel_so_far_j: list[float]
    running_time_s: float
    minimum_running_time_s: float
    energy_j: float
    bound_j: float
    certificate_gap: float
    second_w: float
    plant: NotRequired[PlanOut | None]


class PlantPlanIn(TypedDict):
    """A plan, and the disturbance of the true plant, for which a second one is made."""

    ideal: NotRequired[bool]
    mass_factor: NotRequired[float]
    resistance_factor: NotRequired[float]
    delay_s: NotRequired[float]
    lag_s: NotRequired[float]
    speed_noise_mps: NotRequired[float]
    headwind_mps: NotRequired[float]
    adhesion: NotRequired[float | None]
    brake_factor: NotRequired[float]
    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]
    time_s: NotRequired[float | None]
    objective: NotRequired[Literal["wheel", "line"]]


class ProjectEntries(TypedDict):
    """A project with what it holds."""

    id: str
    name: str
    notes: str
    created: str
    user: str | None
    jobs: list[str]
    uploads: list[ProjectUpload]


class ProjectIn(TypedDict):
    """A project: its name and notes."""

    name: str
    notes: NotRequired[str]


class ProjectOut(TypedDict):
    """A project: a named folder of jobs, lines, trainsets, policies and logs, with notes; who began
    it.
    """

    id: str
    name: str
    notes: str
    created: str
    user: str | None


class ProjectUpload(TypedDict):
    """A line, trainset, policy or log of a project."""

    id: str
    kind: Literal["line", "trainset", "policy", "log"]
    name: str


class RecipeOut(TypedDict):
    """A driver that can be learned."""

    driver: str
    summary: str
    source: str
    task: str
    steps_quick: int
    steps_paper: int


class RegimeOut(TypedDict):
    """A part of a drive in one regime: what bound most of it, energy, loss to trainset and driver."""

    regime: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float
    bound: str
    energy_wheel_j: float
    trainset_loss_j: float | None
    driver_loss_j: float | None


class ResidualsOut(TypedDict):
    """Measured and simulated speed over the time of each run, null between two; correlation of
    residuals.
    """

    time_s: list[float | None]
    measured_mps: list[float | None]
    simulated_mps: list[float | None]
    residual_mps: list[float | None]
    lag_s: list[float]
    correlation: list[float]


class RestrictionIn(TypedDict):
    """A temporary speed restriction, sent ``at_s`` after departure, or known before it."""

    from_m: float
    to_m: float
    limit_mps: float
    at_s: NotRequired[float | None]


class RunOut(TypedDict):
    """A learning run."""

    id: str
    algorithm: str
    task: str
    seed: int
    status: str
    created: str
    seconds: float
    steps: int
    total_steps: int | None
    score: float | None


class RunningGraphOut(TypedDict):
    """Train graph of the last half hour of a running line: a row of positions and delays for each
    time.
    """

    stops: list[GraphStopOut]
    time_s: list[float]
    position_m: list[list[float]]
    delay_s: list[list[float]]
    energy_kwh: list[float]
    floor_kwh: list[float]


class RunningLineIn(TypedDict):
    """A line that runs live, all trains at once, and its pace; it ends after ``lasts_s``."""

    headway_s: NotRequired[int]
    dwell_s: NotRequired[int]
    dwell_window_s: NotRequired[int]
    time_window_s: NotRequired[int]
    turnround_s: NotRequired[int]
    reserve: NotRequired[float]
    zones: NotRequired[int]
    age_s: NotRequired[float]
    blocks: NotRequired[int | None]
    transfer_loss: NotRequired[float]
    efficiency_traction: NotRequired[float | None]
    efficiency_braking: NotRequired[float | None]
    line: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    lasts_s: NotRequired[float]
    pace: NotRequired[float]


class RunningLineOut(TypedDict):
    """A running line at its end: energy beside the floor, delays now and at most, recovery.

    ``waits`` departures waited for the train ahead, ``stops`` trains were stopped on the way behind it;
    ``recovered_s``: when every train was on time again after the last event, at ``disturbed_s``.
    ``gap_percent`` is that of the whole headways, null before the first has passed. ``graph`` is null of
    one that an earlier version drove.
    """

    time_s: float
    trains: int
    energy_kwh: float
    floor_kwh: float
    gap_percent: float | None
    largest_delay_s: float
    delay_s: float
    waits: int
    stops: int
    disturbed_s: float | None
    recovered_s: float | None
    outcome: str
    graph: NotRequired[RunningGraphOut | None]


class SavedOut(TypedDict):
    """A version with the id of its upload."""

    number: int
    name: str
    created: str
    id: str


class SectionIn(TypedDict):
    """A section, its trainset and its restrictions."""

    line: NotRequired[str]
    origin: NotRequired[str]
    destination: NotRequired[str]
    trainset: NotRequired[str]
    load: NotRequired[str | None]
    restrictions: NotRequired[list[RestrictionIn]]


class SectionOut(TypedDict):
    """A section in the direction of travel, for a trainset."""

    name: str
    origin: StationOut
    destination: StationOut
    length_m: float
    planned_time_s: float | None
    minimum_running_time_s: float
    limit_mps: Pieces
    gradient_permil: Pieces


class SectionRow(TypedDict):
    """A section of a line in the forward direction."""

    origin: str
    destination: str
    length_m: float
    planned_forward_s: float | None
    planned_backward_s: float | None


class StationOut(TypedDict):
    """A stop."""

    code: str
    name: str
    position_m: float
    local_name: str


class StudyFigure(TypedDict):
    """A figure of a study's page; the file is at `/api/studies/ID/figures/NAME`."""

    name: str
    caption: str


class StudyIn(TypedDict):
    """A study to reproduce; ``quick`` takes about two minutes, ``paper`` an hour."""

    study: str
    budget: NotRequired[Literal["quick", "paper"]]


class StudyOut(TypedDict):
    """A reproduced paper; ``page`` is true where its tables exist."""

    id: str
    title: str
    page: bool


class StudyPage(TypedDict):
    """The published page of a study: verdicts on the paper's claims, every row, figures."""

    id: str
    title: str
    written: str
    summary: str
    verdicts: list[dict[str, str]]
    rows: list[StudyRow]
    figures: list[StudyFigure]


class StudyRow(TypedDict):
    """A number of a study: published, reproduced with its range over seeds, optimal."""

    table: str
    case: str
    driver: str
    kpi: str
    unit: str
    published: float | None
    ours: float | None
    low: float | None
    high: float | None
    optimum: float | None


class TaskOut(TypedDict):
    """A learning task."""

    id: str
    summary: str


class TimePriceOut(TypedDict):
    """Worth of a second at a moment: marginal price, energy that one more saves and one less costs."""

    time_s: float
    position_m: float
    second_w: float
    later_j: float
    sooner_j: float | None


class TrainGraphOut(TypedDict):
    """Train graph: stations, and paths by what the trains do (a headway) or by direction (a day)."""

    stops: list[StationOut]
    paths: dict[str, PathOut]
    span_s: list[float]


class TrainsetOut(TypedDict):
    """A trainset."""

    id: str
    name: str
    loads_kg: dict[str, float]
    load: str
    length_m: float
    max_speed_mps: float
    max_acceleration_mps2: float
    max_deceleration_mps2: float
    uploaded: bool


class UploadOut(TypedDict):
    """Kind and name of an uploaded file."""

    kind: Literal["line", "trainset", "policy", "log"]
    id: str
    name: str
    notes: list[str]


class UserOut(TypedDict):
    """A user: role ``viewer`` reads only; jobs wait or run. Without a name there are no limits."""

    name: str | None
    role: Literal["user", "viewer"]
    jobs: NotRequired[int | None]
    jobs_most: NotRequired[int | None]
    bytes_kept: NotRequired[int | None]
    bytes_most: NotRequired[int | None]


class VersionIn(TypedDict):
    """The next version of a line or trainset: its TOML document, and the version that was edited."""

    toml: str
    version: int


class VersionOut(TypedDict):
    """A version of an uploaded or edited file."""

    number: int
    name: str
    created: str


class Server:
    """Routes of server."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def health(self) -> Health:
        """State of the server."""
        return json.loads(self.connection.send("GET", "/api/health", {}))

    def user(self) -> UserOut:
        """User of this request, with what it has under way and keeps, and how much of it is allowed."""
        return json.loads(self.connection.send("GET", "/api/user", {}))


class Catalogue:
    """Routes of catalogue."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def lines(self) -> list[LineRow]:
        """Every line."""
        return json.loads(self.connection.send("GET", "/api/lines", {}))

    def line(self, line_id: str) -> LineOut:
        """A line with stations, sections, limits and gradients."""
        return json.loads(self.connection.send("GET", f"/api/lines/{quote(str(line_id), safe='')}", {}))

    def line_toml(self, line_id: str, *, version: int | None = None) -> str:
        """A line as metropilot's TOML; of an upload the newest version, if none is named."""
        return self.connection.send(
            "GET", f"/api/lines/{quote(str(line_id), safe='')}/toml", {"version": version}
        ).decode()

    def trainsets(self) -> list[TrainsetOut]:
        """Every trainset."""
        return json.loads(self.connection.send("GET", "/api/trainsets", {}))

    def trainset(self, trainset_id: str) -> TrainsetOut:
        """A trainset."""
        return json.loads(
            self.connection.send("GET", f"/api/trainsets/{quote(str(trainset_id), safe='')}", {})
        )

    def trainset_toml(self, trainset_id: str, *, version: int | None = None) -> str:
        """A trainset as metropilot's TOML; of an upload the newest version, if none is named."""
        return self.connection.send(
            "GET", f"/api/trainsets/{quote(str(trainset_id), safe='')}/toml", {"version": version}
        ).decode()

    def drivers(self) -> list[DriverOut]:
        """Every driver, with its options and their defaults."""
        return json.loads(self.connection.send("GET", "/api/drivers", {}))

    def days(self) -> list[DayRow]:
        """Every working day."""
        return json.loads(self.connection.send("GET", "/api/days", {}))

    def feedings(self) -> list[FeedingRow]:
        """Every DC network, with the lines that it can feed."""
        return json.loads(self.connection.send("GET", "/api/feedings", {}))

    def upload(self, name: str, content: bytes) -> UploadOut:
        """Upload a line or trainset (metropilot's TOML, TTOBench's JSON), a policy, or a log of runs
        (CSV).

        Policies are safetensors. Use the id like one of the catalogue; the id of a policy is given as the
        option `policy` of a driver, those of logs to `POST /api/jobs/fit`.
        """
        return json.loads(self.connection.send_file("POST", "/api/uploads", name, content))

    def versions(self, upload_id: str) -> list[VersionOut]:
        """Versions of an upload, the newest first."""
        return json.loads(
            self.connection.send("GET", f"/api/uploads/{quote(str(upload_id), safe='')}/versions", {})
        )

    def save(self, upload_id: str, body: VersionIn) -> VersionOut:
        """Save the next version of a line or trainset; 409 if another one was saved meanwhile."""
        return json.loads(
            self.connection.send("PUT", f"/api/uploads/{quote(str(upload_id), safe='')}", {}, body)
        )

    def forget(self, upload_id: str) -> None:
        """Remove an upload with all its versions."""
        self.connection.send("DELETE", f"/api/uploads/{quote(str(upload_id), safe='')}", {})


class Planning:
    """Routes of planning."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def section(self, body: SectionIn) -> SectionOut:
        """A section for a trainset, with the minimum running time."""
        return json.loads(self.connection.send("POST", "/api/section", {}, body))

    def plan(self, body: PlantPlanIn) -> PlansOut:
        """The energy-optimal plan with its certificate; with a disturbance that of the true plant,
        too.
        """
        return json.loads(self.connection.send("POST", "/api/plan", {}, body))

    def front(self, body: PlanIn) -> FrontOut:
        """Optimal energy from 1.02 to 1.6 of the minimum running time; ``time_s`` is not used."""
        return json.loads(self.connection.send("POST", "/api/front", {}, body))

    def journey(self, body: JourneyIn) -> JourneyOut:
        """A journey that calls at every station; with ``total_s`` its reserve is spread optimally."""
        return json.loads(self.connection.send("POST", "/api/journey", {}, body))


class Jobs:
    """Routes of jobs."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def drive(self, body: DriveIn) -> JobOut:
        """Drive one run."""
        return json.loads(self.connection.send("POST", "/api/jobs/drive", {}, body))

    def compare(self, body: CompareIn) -> JobOut:
        """Drive the same run with several drivers and seeds."""
        return json.loads(self.connection.send("POST", "/api/jobs/compare", {}, body))

    def journey(self, body: JourneyIn) -> JobOut:
        """Plan a journey at once and keep it."""
        return json.loads(self.connection.send("POST", "/api/jobs/journey", {}, body))

    def line(self, body: OperationIn) -> JobOut:
        """Compute the energy of all trains of a line, beside its floor."""
        return json.loads(self.connection.send("POST", "/api/jobs/line", {}, body))

    def export(self, body: ExportIn) -> JobOut:
        """Write a learned driver under protection as C or WebAssembly; `/files/run.zip` holds it."""
        return json.loads(self.connection.send("POST", "/api/jobs/export", {}, body))

    def learn(self, body: LearnIn) -> JobOut:
        """Learn a driver."""
        return json.loads(self.connection.send("POST", "/api/jobs/learn", {}, body))

    def study(self, body: StudyIn) -> JobOut:
        """Reproduce a study."""
        return json.loads(self.connection.send("POST", "/api/jobs/study", {}, body))

    def jobs(
        self,
        *,
        kind: Literal[
            "drive", "compare", "journey", "line", "campaign", "export", "fit", "learn", "study", "live"
        ]
        | None = None,
        status: Literal["queued", "running", "done", "failed", "stopped", "interrupted"] | None = None,
        text: str | None = None,
        sort: Literal["created", "name", "kind", "status", "time_s", "energy_kwh", "gap_percent"]
        | None = None,
        ascending: bool | None = None,
        limit: int | None = None,
        offset: int | None = None,
        project: str | None = None,
    ) -> list[JobOut]:
        """Jobs, the newest first; `text` is looked for in id, name and request."""
        return json.loads(
            self.connection.send(
                "GET",
                "/api/jobs",
                {
                    "kind": kind,
                    "status": status,
                    "text": text,
                    "sort": sort,
                    "ascending": ascending,
                    "limit": limit,
                    "offset": offset,
                    "project": project,
                },
            )
        )

    def job(self, job_id: str) -> JobOut:
        """A job."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}", {}))

    def name_job(self, job_id: str, body: NameIn) -> JobOut:
        """Name a job."""
        return json.loads(self.connection.send("PATCH", f"/api/jobs/{quote(str(job_id), safe='')}", {}, body))

    def forget(self, job_id: str) -> None:
        """Remove a job with its files; of a learning run the policy, too. One that runs is refused
        (409).
        """
        self.connection.send("DELETE", f"/api/jobs/{quote(str(job_id), safe='')}", {})

    def drive_result(self, job_id: str) -> DriveOut:
        """Result of a drive, or of a live run that has ended."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/drive", {}))

    def compare_result(self, job_id: str) -> CompareOut:
        """Result of a comparison."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/compare", {}))

    def difference(self, job_id: str, other_id: str) -> DifferenceOut:
        """Two drives or live runs of one section against each other, over distance."""
        return json.loads(
            self.connection.send(
                "GET",
                f"/api/jobs/{quote(str(job_id), safe='')}/difference/{quote(str(other_id), safe='')}",
                {},
            )
        )

    def journey_result(self, job_id: str) -> JourneyOut:
        """Result of a journey."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/journey", {}))

    def line_result(self, job_id: str) -> OperationOut:
        """Energies and train graph of a line; there as soon as the files are being written."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/line", {}))

    def stop(self, job_id: str) -> JobOut:
        """Ask a job to end; a learning run ends at its next checkpoint."""
        return json.loads(self.connection.send("POST", f"/api/jobs/{quote(str(job_id), safe='')}/stop", {}))

    def resume(self, job_id: str) -> JobOut:
        """Go on with a job that was interrupted, stopped or failed; learning from its last checkpoint."""
        return json.loads(self.connection.send("POST", f"/api/jobs/{quote(str(job_id), safe='')}/resume", {}))

    def report(self, job_id: str) -> bytes:
        """Report of a run, a comparison or a journey for printing (A4), made when it is asked for.

        Its picture, requirements, KPIs, reasons, request, versions and commit.
        """
        return self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/files/report.pdf", {})

    def file(self, job_id: str, name: str) -> bytes:
        """A file of a job: `trajectory.csv`, `kpis.json`, `profile.svg`, `profile.png`, `run.toml`,
        ...

        `run.zip` holds all of them and the files that `run.toml` names (an uploaded line, trainset or
        policy), so that `metropilot drive --from run.toml` drives it again anywhere. Of a convoy there
        are `trajectory-1.csv` and so on, and all of these in `trajectories.zip`; of a line in operation
        `line.json` or `day.json`, `timetable.csv` and, of a day, `gtfs.zip`; of a fit `trainset.toml`,
        `fit.json`, `residuals.svg`, `residuals.png`.
        """
        return self.connection.send(
            "GET", f"/api/jobs/{quote(str(job_id), safe='')}/files/{quote(str(name), safe='')}", {}
        )


class Learning:
    """Routes of learning."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def tasks(self) -> list[TaskOut]:
        """Learning tasks."""
        return json.loads(self.connection.send("GET", "/api/tasks", {}))

    def recipes(self) -> list[RecipeOut]:
        """Learning recipes of drivers."""
        return json.loads(self.connection.send("GET", "/api/recipes", {}))

    def runs(self) -> list[RunOut]:
        """Learning runs, the newest first."""
        return json.loads(self.connection.send("GET", "/api/runs", {}))

    def run(self, run_id: str) -> RunOut:
        """A learning run."""
        return json.loads(self.connection.send("GET", f"/api/runs/{quote(str(run_id), safe='')}", {}))

    def history(self, run_id: str) -> HistoryOut:
        """History of a learning run, also while it runs."""
        return json.loads(self.connection.send("GET", f"/api/runs/{quote(str(run_id), safe='')}/history", {}))

    def studies(self) -> list[StudyOut]:
        """Papers reproduced."""
        return json.loads(self.connection.send("GET", "/api/studies", {}))

    def study_table(self, study_id: str) -> list[StudyRow]:
        """The newest table of a study: published, reproduced and optimal values."""
        return json.loads(self.connection.send("GET", f"/api/studies/{quote(str(study_id), safe='')}", {}))

    def study_page(self, study_id: str) -> StudyPage:
        """The published page of a study: verdicts on the paper's claims, every row, figures."""
        return json.loads(
            self.connection.send("GET", f"/api/studies/{quote(str(study_id), safe='')}/page", {})
        )

    def study_figure(self, study_id: str, figure: str) -> bytes:
        """A figure of the published page of a study, as PNG."""
        return self.connection.send(
            "GET", f"/api/studies/{quote(str(study_id), safe='')}/figures/{quote(str(figure), safe='')}", {}
        )


class Fits:
    """Routes of fits."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def fit(self, body: FitIn) -> JobOut:
        """Fit a trainset to uploaded logs; logs that do not determine it fail with the reason."""
        return json.loads(self.connection.send("POST", "/api/jobs/fit", {}, body))

    def fit_result(self, job_id: str) -> FitOut:
        """Result of a fit: parameters with intervals, what cannot be told apart, residuals."""
        return json.loads(self.connection.send("GET", f"/api/jobs/{quote(str(job_id), safe='')}/fit", {}))

    def save_fit(self, job_id: str, body: FitSaveIn) -> SavedOut:
        """Save the fitted trainset as a new entry, or as the next version of an own trainset."""
        return json.loads(
            self.connection.send("POST", f"/api/jobs/{quote(str(job_id), safe='')}/fit/trainset", {}, body)
        )


class Campaigns:
    """Routes of campaigns."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def campaign(self, body: CampaignIn) -> JobOut:
        """Compute a campaign of drives, declared as in its TOML file; stopped and resumed like
        learning.
        """
        return json.loads(self.connection.send("POST", "/api/jobs/campaign", {}, body))

    def campaigns(self) -> list[CampaignRow]:
        """Campaigns of this server and the published ones: leaderboard, robustness, trainsets."""
        return json.loads(self.connection.send("GET", "/api/campaigns", {}))

    def summary(self, campaign_id: str) -> CampaignOut:
        """A campaign with statistics by driver, and by driver and disturbance; also while it is
        computed.
        """
        return json.loads(
            self.connection.send("GET", f"/api/campaigns/{quote(str(campaign_id), safe='')}", {})
        )

    def rows(
        self,
        campaign_id: str,
        *,
        driver: str | None = None,
        disturbance: str | None = None,
        outcome: str | None = None,
        line: str | None = None,
        trainset: str | None = None,
        load: str | None = None,
        success: bool | None = None,
        sort: str | None = None,
        ascending: bool | None = None,
        limit: int | None = None,
        offset: int | None = None,
    ) -> CampaignRowsOut:
        """Rows of a campaign, sorted by a column of `results.parquet`."""
        return json.loads(
            self.connection.send(
                "GET",
                f"/api/campaigns/{quote(str(campaign_id), safe='')}/rows",
                {
                    "driver": driver,
                    "disturbance": disturbance,
                    "outcome": outcome,
                    "line": line,
                    "trainset": trainset,
                    "load": load,
                    "success": success,
                    "sort": sort,
                    "ascending": ascending,
                    "limit": limit,
                    "offset": offset,
                },
            )
        )

    def row_request(self, campaign_id: str, row: int) -> DriveIn:
        """A row as the request of a drive, to be driven again by `POST /api/jobs/drive`."""
        return json.loads(
            self.connection.send(
                "GET",
                f"/api/campaigns/{quote(str(campaign_id), safe='')}/rows/{quote(str(row), safe='')}",
                {},
            )
        )


class Projects:
    """Routes of projects."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def every(self) -> list[ProjectOut]:
        """Every project, by name."""
        return json.loads(self.connection.send("GET", "/api/projects", {}))

    def begin(self, body: ProjectIn) -> ProjectOut:
        """Begin a project."""
        return json.loads(self.connection.send("POST", "/api/projects", {}, body))

    def read(self, name: str, content: bytes) -> ProjectOut:
        """Add the project of an archive; jobs and uploads get new ids."""
        return json.loads(self.connection.send_file("POST", "/api/projects/archive", name, content))

    def project(self, project_id: str) -> ProjectEntries:
        """A project with the ids of its jobs, and its uploads."""
        return json.loads(self.connection.send("GET", f"/api/projects/{quote(str(project_id), safe='')}", {}))

    def change(self, project_id: str, body: ProjectIn) -> ProjectOut:
        """Change name and notes of a project."""
        return json.loads(
            self.connection.send("PUT", f"/api/projects/{quote(str(project_id), safe='')}", {}, body)
        )

    def forget(self, project_id: str) -> None:
        """Remove a project; what it holds stays."""
        self.connection.send("DELETE", f"/api/projects/{quote(str(project_id), safe='')}", {})

    def write_files(self, project_id: str) -> bytes:
        """A project as one archive: jobs with their files, lines and trainsets in every version,
        notes.

        Lines, trainsets, logs and policies that its jobs name go with it; what still runs is left out.
        """
        return self.connection.send("GET", f"/api/projects/{quote(str(project_id), safe='')}/archive", {})

    def file_job(self, job_id: str, body: FiledIn) -> JobOut:
        """File a job in a project, or in none."""
        return json.loads(
            self.connection.send("PUT", f"/api/jobs/{quote(str(job_id), safe='')}/project", {}, body)
        )

    def file_upload(self, upload_id: str, body: FiledIn) -> None:
        """File a line, trainset or policy in a project, or in none."""
        self.connection.send("PUT", f"/api/uploads/{quote(str(upload_id), safe='')}/project", {}, body)


class Live:
    """Routes of live."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def runs(self) -> list[LiveOut]:
        """Live runs of this server, the oldest first."""
        return json.loads(self.connection.send("GET", "/api/live", {}))

    def start(self, body: LiveIn) -> LiveOut:
        """Start a live run; one that is `queued` waits at `place` of the queue and starts by itself."""
        return json.loads(self.connection.send("POST", "/api/live", {}, body))

    def convoy(self, body: ConvoyIn) -> LiveOut:
        """Start a live convoy; watched, paced and stopped like any live run."""
        return json.loads(self.connection.send("POST", "/api/convoys", {}, body))

    def running_line(self, body: RunningLineIn) -> LiveOut:
        """Start a running line with all its trains; watched, paced and stopped like any live run.

        A row has the place and the delay of every train, the energy of all since the beginning and its
        floor.
        """
        return json.loads(self.connection.send("POST", "/api/running-lines", {}, body))

    def line_result(self, live_id: str) -> RunningLineOut:
        """Result of a running line that has come to its end."""
        return json.loads(self.connection.send("GET", f"/api/live/{quote(str(live_id), safe='')}/line", {}))

    def hold(self, live_id: str, body: NewHold) -> EventOut:
        """Hold the next train of a running line that departs from a station."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/hold", {}, body)
        )

    def slow(self, live_id: str, body: NewSlowSection) -> EventOut:
        """Restrict the speed of a section of a running line for trains that depart from now on."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/slow", {}, body)
        )

    def link(self, live_id: str, body: NewLink) -> EventOut:
        """Change delay, jitter and loss of the link of a convoy, or silence it."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/link", {}, body)
        )

    def emergency(self, live_id: str) -> EventOut:
        """Let the head of a convoy make an emergency brake."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/emergency", {})
        )

    def one(self, live_id: str) -> LiveOut:
        """A live run. A request counts as a viewer; a live run without viewers for 2 min is stopped."""
        return json.loads(self.connection.send("GET", f"/api/live/{quote(str(live_id), safe='')}", {}))

    def stream(self, live_id: str, *, last_event_id: int | None = None) -> Iterator[StreamEvent]:
        """Watch a live run. The number and speed of its viewers do not delay it."""
        return self.connection.listen(f"/api/live/{quote(str(live_id), safe='')}/stream", last_event_id)

    def arrival(self, live_id: str, body: NewArrival) -> EventOut:
        """Send the driver a new arrival time."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/arrival", {}, body)
        )

    def restriction(self, live_id: str, body: NewRestriction) -> EventOut:
        """Add a temporary speed restriction on the track ahead."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/restriction", {}, body)
        )

    def lever(self, live_id: str, body: Lever) -> EventOut:
        """Drive manually under protection; without renewal within 3 s the driver takes over.

        The lever has one holder. A second one is refused (409); the message names the first.
        """
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/lever", {}, body)
        )

    def pace(self, live_id: str, body: Pace) -> EventOut:
        """Change the pace of the run: 1 is real time, 0 pauses it."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/pace", {}, body)
        )

    def step(self, live_id: str) -> EventOut:
        """Pause the run and simulate one second of it; a pace other than 0 lets it go on."""
        return json.loads(self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/step", {}))

    def stop(self, live_id: str) -> EventOut:
        """End a live run, or take it out of the queue; it can be resumed."""
        return json.loads(self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/stop", {}))

    def resume(self, live_id: str) -> LiveOut:
        """Resume a live run that was stopped or that a restart interrupted, from where it was."""
        return json.loads(
            self.connection.send("POST", f"/api/live/{quote(str(live_id), safe='')}/resume", {})
        )


class Client:
    """Every route of a server.

    Args:
        url: Address of the server.
        token: Its token; None: it has none.
        timeout_s: Longest wait for an answer.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = 120.0) -> None:
        connection = Connection(url, token, timeout_s)
        self.server = Server(connection)
        self.catalogue = Catalogue(connection)
        self.planning = Planning(connection)
        self.jobs = Jobs(connection)
        self.learning = Learning(connection)
        self.fits = Fits(connection)
        self.campaigns = Campaigns(connection)
        self.projects = Projects(connection)
        self.live = Live(connection)

    def wait(self, job_id: str, every_s: float = 0.2, longest_s: float = 3600.0) -> JobOut:
        """Wait until a job is done; return it.

        Raises:
            ApiError: It failed, was stopped or interrupted.
            TimeoutError: It is not over yet.
        """
        end = time.monotonic() + longest_s
        while (job := self.jobs.job(job_id))["status"] not in OVER:
            if time.monotonic() > end:
                raise TimeoutError(f"{job_id} is {job['status']} after {longest_s:g} s")
            time.sleep(every_s)
        if job["status"] != "done":
            raise ApiError(0, job["error"] or {"message": f"{job_id}: {job['status']}"})
        return job
