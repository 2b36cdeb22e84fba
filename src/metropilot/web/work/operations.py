"""Lines in operation, at a headway or through a day."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from metropilot import operation
from metropilot.railway import Feeding, Line, ServiceDay, load_day, load_feeding, load_line, load_trainset
from metropilot.web.store import JobStore
from metropilot.web.work.drives import folder_of
from metropilot.web.work.plans import LineRequest, numbers, station

PLANNED = 2
"""Operations whose plans a worker keeps: a headway after another asks for the same ones."""
POINTS = 12
"""Points of a piece of the train graph, which bends little."""
USES = {1: "draws", 0: "stands", -1: "returns"}


@dataclass(frozen=True, kw_only=True)
class OperationRequest(LineRequest):
    """A line in operation, to be computed.

    Attributes:
        optimise: Search dwells and running times too.
        seed: Seed of the search.
        day: Working day instead of the headway.
        feeding: DC network.
    """

    optimise: bool = False
    seed: int = 0
    day: str | None = None
    feeding: str | None = None

    def read(self) -> tuple[Line, ServiceDay | None, Feeding | None]:
        """Read and check what it names.

        Raises:
            InputError: A name is unknown, or of another line.
        """
        line = load_line(self.line)
        load_trainset(self.trainset, self.load)
        operation.divide_zones(line, self.options.zones)
        day = None if self.day is None else load_day(self.day)
        feeding = None if self.feeding is None else load_feeding(self.feeding)
        for each in (day, feeding):
            if each is not None:
                each.check_line(line)
        return line, day, feeding


def line_job(root: str, job: str, request: OperationRequest) -> dict[str, Any]:
    """Compute the energy of a line beside its floor; write the files into the job's folder.

    The result is stored before the pictures are drawn.
    """
    store = JobStore(Path(root))
    folder, headway_s = folder_of(root, job), request.options.headway_s
    _, day, feeding = request.read()
    searching = "searching" if request.optimise else "choosing"
    store.begin(job, "planning the trips", 0.05)
    neutral = replace(request.options, headway_s=operation.OperationOptions.headway_s)
    names = {name: getattr(request, name) for name in ("line", "trainset", "load")}
    planned, plans, floors = _plan(LineRequest(**names, options=neutral), request.optimise)
    running = planned.with_headway(headway_s)
    search = {"searched": request.optimise, "seed": request.seed, "plans": plans}
    store.update(job, progress=0.4, words=f"{searching} the timetable")
    if day is None:
        found = operation.operation_energy(running, floors=floors, feeding=feeding, **search)
        store.update(job, progress=0.7, words="checking headways and feeding")
        fed = feeding and operation.feed_line(running, found.timetable, found.profiles, feeding)
        result = _headway_out(found, found.as_dict(fed))
        store.update(job, result=result, progress=0.8, words="drawing")
        operation.write_operation(folder, found, fed)
    else:
        of_day = operation.day_energy(running, day, **search)
        store.update(job, progress=0.7, words="adding up the day")
        fed = feeding and operation.feed_day(of_day.day, feeding, of_day.links)
        result = _day_out(of_day, of_day.as_dict(fed))
        store.update(job, result=result, progress=0.8, words="drawing")
        options = asdict(request) | asdict(request.options)
        del options["options"]
        operation.write_day(folder, of_day, options, fed)
    return result | {"files": sorted(path.name for path in folder.glob("[!.]*"))}


@lru_cache(maxsize=PLANNED)
def _plan(
    request: LineRequest, windows: bool
) -> tuple[operation.LineOperation, Mapping[str, Sequence[operation.Profiles]], operation.TripFloors]:
    """Operation with the plans and floors of its trips; no headway changes these."""
    running = request.operation()
    return running, operation.plan_trips(running, windows=windows), operation.TripFloors(running)


def _headway_out(found: operation.OperationEnergy, energies: dict[str, Any]) -> dict[str, Any]:
    headway_s = found.operation.options.headway_s
    last_s = float(operation.HEADWAYS_DRAWN * headway_s)
    drawn = ((USES[path.use], path.time_s, path.position_m) for path in operation.train_paths(found, last_s))
    backward, most = max(enumerate(found.headways()), key=lambda each: each[1].headway_s)
    least = most.bottleneck
    return {
        "energies": energies,
        "bottleneck": {
            "kind": least.kind,
            "name": least.name,
            "headway_s": least.headway_s,
            "direction": ("forward", "backward")[backward],
        },
        "graph": _graph(found.operation.line, drawn, (0.0, last_s)),
        "files": [],
    }


def _day_out(found: operation.DayEnergy, energies: dict[str, Any]) -> dict[str, Any]:
    line, timetable = found.day.operation.line, found.day.timetable
    at_m = np.array([stop.position_m for stop in line.stations])

    def draw() -> Iterable[tuple[str, np.ndarray, np.ndarray]]:
        for name, each in (("forward", timetable.forward), ("backward", timetable.backward)):
            place = np.repeat(at_m if name == "forward" else at_m[::-1], 2)[1:-1]
            yield from ((name, row, place) for row in each.stop_times_s)

    span_s = tuple(float(x) for x in timetable.span_s)
    return {
        "energies": energies,
        "bottleneck": None,
        "graph": _graph(line, draw(), (span_s[0], span_s[1])),
        "files": [],
    }


def _graph(
    line: Line, paths: Iterable[tuple[str, np.ndarray, np.ndarray]], span_s: tuple[float, float]
) -> dict[str, Any]:
    """Train graph: for each kind one path, in which null parts the pieces."""
    drawn: dict[str, dict[str, list[float | None]]] = {}
    for kind, time_s, position_m in paths:
        if time_s[-1] < span_s[0] or time_s[0] > span_s[1]:
            continue
        keep = np.arange(time_s.size)
        if time_s.size > POINTS and kind in USES.values():
            keep = np.unique(np.linspace(0, time_s.size - 1, POINTS).round().astype(int))
        path = drawn.setdefault(kind, {"time_s": [], "position_m": []})
        path["time_s"] += [*numbers(time_s[keep], 1), None]
        path["position_m"] += [*numbers(position_m[keep], 0), None]
    return {"stops": [station(stop) for stop in line.stations], "paths": drawn, "span_s": list(span_s)}
