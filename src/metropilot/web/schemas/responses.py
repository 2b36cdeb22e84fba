"""Bodies of responses: typed, SI, units in names."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_type_hints

from pydantic import BaseModel, Field, create_model, model_validator

from metropilot import evaluate
from metropilot.fit import FittedParameter
from metropilot.studies import ReportRow
from metropilot.web.store import JobRow, ProjectRow, VersionRow

JobKind = Literal[
    "drive", "compare", "journey", "line", "campaign", "export", "fit", "learn", "study", "live"
]
UploadKind = Literal["line", "trainset", "policy", "log"]
JobStatus = Literal["queued", "running", "done", "failed", "stopped", "interrupted"]
JobSort = Literal["created", "name", "kind", "status", "time_s", "energy_kwh", "gap_percent"]


def fields_of(kind: type[Any], *left_out: str) -> type[BaseModel]:
    """Base of a body with the fields of a tuple or dataclass.

    Args:
        kind: The tuple or dataclass.
        left_out: Fields without one.
    """
    found: dict[str, Any] = {name: (hint, ...) for name, hint in get_type_hints(kind).items()}
    fields = {name: hint for name, hint in found.items() if name not in left_out}
    return create_model(f"{kind.__name__}Fields", **fields)


class Health(BaseModel):
    """State of the server."""

    version: str
    jobs_running: int
    live_runs: int
    live_runs_waiting: int


class UserOut(BaseModel):
    """A user: role ``viewer`` reads only; jobs wait or run. Without a name there are no limits."""

    name: str | None
    role: Literal["user", "viewer"]
    jobs: int | None = None
    jobs_most: int | None = None
    bytes_kept: int | None = None
    bytes_most: int | None = None


class LineRow(BaseModel):
    """A line in a list."""

    id: str
    name: str
    stations: int
    length_m: float
    uploaded: bool


class StationOut(BaseModel):
    """A stop."""

    code: str
    name: str
    position_m: float
    local_name: str


class Pieces(BaseModel):
    """A piecewise-constant profile: each value holds from its position to the next."""

    from_m: list[float]
    value: list[float]


class SectionRow(BaseModel):
    """A section of a line in the forward direction."""

    origin: str
    destination: str
    length_m: float
    planned_forward_s: float | None
    planned_backward_s: float | None


class LineOut(LineRow):
    """A line: limits in m/s, gradients in permil, positive uphill in the forward direction."""

    stops: list[StationOut]
    sections: list[SectionRow]
    dwell_s: list[float]
    limit_mps: Pieces
    gradient_permil: Pieces
    source: dict[str, str]
    notes: list[str]
    unused: list[str]


class TrainsetOut(BaseModel):
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


class DriverOut(BaseModel):
    """A driver."""

    id: str
    summary: str
    source: str
    options: dict[str, Any]


class UploadOut(BaseModel):
    """Kind and name of an uploaded file."""

    kind: UploadKind
    id: str
    name: str
    notes: list[str]


class ProjectOut(fields_of(ProjectRow)):
    """A project: a named folder of jobs, lines, trainsets, policies and logs, with notes; who began it."""


class ProjectUpload(BaseModel):
    """A line, trainset, policy or log of a project."""

    id: str
    kind: UploadKind
    name: str


class ProjectEntries(ProjectOut):
    """A project with what it holds."""

    jobs: list[str]
    uploads: list[ProjectUpload]


class VersionOut(fields_of(VersionRow, "file")):
    """A version of an uploaded or edited file."""


class SavedOut(VersionOut):
    """A version with the id of its upload."""

    id: str


class SectionOut(BaseModel):
    """A section in the direction of travel, for a trainset."""

    name: str
    origin: StationOut
    destination: StationOut
    length_m: float
    planned_time_s: float | None
    minimum_running_time_s: float
    limit_mps: Pieces
    gradient_permil: Pieces


class PlanOut(BaseModel):
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


class PlansOut(PlanOut):
    """The optimal plan; ``plant``: what the true plant can attain with its actuation under protection.

    Null without a disturbance, and where the true plant cannot keep the running time.
    """

    plant: PlanOut | None = None


class FrontOut(BaseModel):
    """Optimal energy over running time; ``second_w``: energy saved by one more second."""

    minimum_running_time_s: float
    time_s: list[float]
    energy_j: list[float]
    second_w: list[float]


class CallOut(BaseModel):
    """A call of a journey; running time and energy since the last stop."""

    station: str
    position_m: float
    arrival_s: float
    departure_s: float
    running_time_s: float
    minimum_running_time_s: float
    energy_j: float


class JourneyOut(BaseModel):
    """A journey: its calls, and the path of the head over time, dwells included."""

    calls: list[CallOut]
    time_s: list[float]
    position_m: list[float]
    speed_mps: list[float]
    running_time_s: float
    energy_j: float
    bound_j: float
    planned_energy_j: float | None


class JobSummary(BaseModel):
    """A result in short; of a convoy the time of its head and the energy of all."""

    outcome: str | None = None
    success: bool | None = None
    time_s: float | None = None
    energy_kwh: float | None = None
    gap_percent: float | None = None


class JobOut(fields_of(JobRow)):
    """A job: its name, request, progress, status, result in short, its error if it failed, who began it."""

    kind: JobKind
    status: JobStatus
    summary: JobSummary


class CheckOut(BaseModel):
    """A requirement of a run."""

    name: str
    value: str
    wanted: str
    passed: bool


class RegimeOut(fields_of(evaluate.RegimeSpan)):
    """A part of a drive in one regime: what bound most of it, energy, loss to trainset and driver."""


class BoundOut(fields_of(evaluate.BoundSpan)):
    """A part of a drive that one thing bound."""


class InterventionOut(fields_of(evaluate.InterventionSpan)):
    """An intervention of protection, and the position up to which the permitted speed fell from there."""


class TimePriceOut(fields_of(evaluate.TimePrice)):
    """Worth of a second at a moment: marginal price, energy that one more saves and one less costs."""


class FeatureShareOut(fields_of(evaluate.FeatureShare)):
    """Share of a feature in a learned driver's decision."""


class DecisionOut(fields_of(evaluate.FeatureMoment, "shares")):
    """Decision of a learned driver; its shares sum up to the output less that of the mean observation.

    ``meaning``: what a positive share speaks for.
    """

    shares: list[FeatureShareOut]


class ExplanationOut(BaseModel):
    """Reasons of a drive, as in `explanation.json`; losses at the wheel, empty where they are unknown."""

    regimes: list[RegimeOut]
    bounds: list[BoundOut]
    interventions: list[InterventionOut]
    position_m: list[float]
    trainset_loss_j: list[float]
    driver_loss_j: list[float]
    prices: list[TimePriceOut] = []
    decisions: list[DecisionOut] = []


class DriveOut(BaseModel):
    """A drive: KPIs as in `kpis.json`, requirements, columns of `trajectory.csv`, and its reasons."""

    driver: str
    success: bool
    kpis: dict[str, Any]
    checks: list[CheckOut]
    columns: dict[str, list[Any]]
    plan: PlanOut | None
    explanation: ExplanationOut | None = None


class KpiPair(BaseModel):
    """A number of two drives; null where one has none."""

    name: str
    first: float | None
    second: float | None


class DifferenceOut(BaseModel):
    """Two drives of one section at the same positions; of each pair the first is that of the path."""

    drivers: list[str]
    position_m: list[float]
    speed_mps: list[list[float]]
    time_s: list[list[float]]
    energy_wheel_j: list[list[float]]
    energy_line_j: list[list[float]]
    kpis: list[KpiPair]


class IntervalOut(BaseModel):
    """A mean over seeds with its 95 % interval."""

    mean: float
    low: float
    high: float


class EntryOut(BaseModel):
    """One driver of a comparison; the drive is that of the first seed."""

    driver: str
    successes: int
    seeds: int
    outcomes: list[str]
    kpis: dict[str, IntervalOut | None]
    drive: DriveOut


class CompareOut(BaseModel):
    """Several drivers on one run."""

    entries: list[EntryOut]


class DayRow(BaseModel):
    """A working day of a line."""

    id: str
    name: str
    line: str
    first_s: float
    last_s: float


class FeedingRow(BaseModel):
    """A DC network."""

    id: str
    name: str
    lines: list[str]


class BottleneckOut(BaseModel):
    """The place that needs the longest headway."""

    kind: str
    name: str
    headway_s: float
    direction: str


class PathOut(BaseModel):
    """Pieces of a train graph, one after the other; null parts them."""

    time_s: list[float | None]
    position_m: list[float | None]


class TrainGraphOut(BaseModel):
    """Train graph: stations, and paths by what the trains do (a headway) or by direction (a day)."""

    stops: list[StationOut]
    paths: dict[str, PathOut]
    span_s: list[float]


class OperationOut(BaseModel):
    """A line in operation: energies as in `line.json` or `day.json`, train graph, names of the files."""

    energies: dict[str, Any]
    bottleneck: BottleneckOut | None
    graph: TrainGraphOut
    files: list[str]


class FittedOut(fields_of(FittedParameter)):
    """A parameter with its 95 % interval; kept at the trainset's value where it is not estimated."""


class ResidualsOut(BaseModel):
    """Measured and simulated speed over the time of each run, null between two; correlation of residuals."""

    time_s: list[float | None]
    measured_mps: list[float | None]
    simulated_mps: list[float | None]
    residual_mps: list[float | None]
    lag_s: list[float]
    correlation: list[float]


class FitOut(BaseModel):
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


class CampaignRow(BaseModel):
    """A campaign in a list: published with its page, or a job of this server."""

    id: str
    name: str
    rows: int
    done: int
    status: JobStatus
    words: str


class CampaignOut(CampaignRow):
    """A campaign: how it was computed, and statistics by driver, and by driver and disturbance."""

    written: str
    matrix: str
    drivers: list[dict[str, Any]]
    cells: list[dict[str, Any]]


class CampaignRowsOut(BaseModel):
    """Rows of a campaign: how many have the values that were asked for, and some of them."""

    count: int
    rows: list[dict[str, Any]]


class LeverOut(BaseModel):
    """Holder of the lever, and the time since departure at which it was taken."""

    holder: str
    since_s: float


class LiveOut(BaseModel):
    """A live run; ``lever`` is null while the driver drives, ``place`` that in the queue while it waits."""

    id: str
    status: JobStatus
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


class GraphStopOut(BaseModel):
    """A stop of a train graph."""

    code: Annotated[str, Field(max_length=32)]
    position_m: float


class RunningGraphOut(BaseModel):
    """Train graph of the last half hour of a running line: a row of positions and delays for each time."""

    stops: Annotated[list[GraphStopOut], Field(max_length=1000)]
    time_s: list[float]
    position_m: list[list[float]]
    delay_s: list[list[float]]
    energy_kwh: list[float]
    floor_kwh: list[float]

    @model_validator(mode="after")
    def check_shape(self) -> Self:
        """Check that every time has a row, and every row as many trains.

        Raises:
            ValueError: They differ.
        """
        rows = (self.position_m, self.delay_s, self.energy_kwh, self.floor_kwh)
        trains = {len(row) for row in (*self.position_m, *self.delay_s)}
        if any(len(row) != len(self.time_s) for row in rows) or len(trains) > 1:
            raise ValueError("rows of different length")
        return self


class RunningLineOut(BaseModel):
    """A running line at its end: energy beside the floor, delays now and at most, recovery.

    ``waits`` departures waited for the train ahead, ``stops`` trains were stopped on the way behind it;
    ``recovered_s``: when every train was on time again after the last event, at ``disturbed_s``.
    ``gap_percent`` is that of the whole headways, null before the first has passed. ``graph`` is null of one
    that an earlier version drove.
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
    graph: RunningGraphOut | None = None


class EventOut(BaseModel):
    """Confirmation of an event of a live run, with its time since departure."""

    id: str
    at_s: float


class RunOut(BaseModel):
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


class HistoryOut(BaseModel):
    """The history of a learning run: columns of equal length, null where there is none."""

    columns: dict[str, list[float | None]]


class TaskOut(BaseModel):
    """A learning task."""

    id: str
    summary: str


class RecipeOut(BaseModel):
    """A driver that can be learned."""

    driver: str
    summary: str
    source: str
    task: str
    steps_quick: int
    steps_paper: int


class StudyOut(BaseModel):
    """A reproduced paper; ``page`` is true where its tables exist."""

    id: str
    title: str
    page: bool


class StudyFigure(BaseModel):
    """A figure of a study's page; the file is at `/api/studies/ID/figures/NAME`."""

    name: str
    caption: str


class StudyRow(fields_of(ReportRow, "values")):
    """A number of a study: published, reproduced with its range over seeds, optimal."""


class StudyResult(BaseModel):
    """Report of a study that was reproduced; `rows` is the table that `GET /api/studies/ID` gives."""

    study: str
    budget: str
    rows: list[StudyRow]


class LearnResult(BaseModel):
    """Result of a learning run."""

    run: str
    stopped: bool


class CampaignResult(BaseModel):
    """Result of a campaign; `done` are the rows computed."""

    campaign: str
    rows: int
    stopped: bool
    done: int


class ExportResult(BaseModel):
    """Result of an export: names of its files."""

    files: list[str]
    sections: list[str]
    number: str
    table_bytes: int
    vectors: int


class StudyPage(BaseModel):
    """The published page of a study: verdicts on the paper's claims, every row, figures."""

    id: str
    title: str
    written: str
    summary: str
    verdicts: list[dict[str, str]]
    rows: list[StudyRow]
    figures: list[StudyFigure]
