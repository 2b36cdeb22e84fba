"""Runs of one learned driver as a compiled batch, each measured like a run of the host loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot.campaign.batch_tables import (
    GUARD_NODES,
    SEEN_NODES,
    EnergyCurve,
    Place,
    RecentCache,
    feature_tables,
    guard_tables,
    most_slots,
    stack_tables,
    table_cache,
)
from metropilot.campaign.declared import BATCH, Campaign, CampaignCase, seed_of
from metropilot.campaign.matrix import FAILED, capture_errors, peak_memory_mb
from metropilot.campaign.program import (
    BROKEN,
    PERIODS,
    CompiledRow,
    EpisodeParams,
    EpisodeState,
    Kind,
    first_memory,
    program,
)
from metropilot.campaign.rows import add_kpis, new_result, prepare_run
from metropilot.control import MeasuredMotion
from metropilot.drivers import AbstractPolicyDriver
from metropilot.errors import Infeasible
from metropilot.evaluate import Optimum, RunSpec, driving_limits
from metropilot.physics import (
    Forces,
    Track,
    Vehicle,
    at_rest,
    delay_steps,
    double_precision,
    stack,
    track_arrays,
    vehicle_arrays,
)
from metropilot.policy import LoadedPolicy, PolicySpec
from metropilot.protection import Memory
from metropilot.railway import Section, Trainset
from metropilot.sim import (
    RUNNING,
    Drive,
    Outcome,
    Run,
    RunState,
    build_trajectory,
    declared_bounds,
    final_outcome,
    noise_stream,
    train_limits_at,
)

CURVES = RecentCache[EnergyCurve](256)
"""Energy curves of this worker, by plant and the bounds declared of it."""
GUARD_SPACING_M = 1.0
"""Distance between the nodes of the protection of the host loop."""


class Setting(NamedTuple):
    """Values shared by the seeds of a cell if only the noise differs between them.

    Attributes:
        request: Request of one of them.
        run: Run of that request.
        known: Entries of the row of results that are known before the run.
        sections: The section at departure, and once the restriction has been announced.
        places: Keys of the tables of the two sections.
        tracks: Tracks of the two sections.
        restricted_at_s: Time at which the restriction is announced (infinite: never).
        restricted_s: Time that it takes at its speed.
        news: Time at which another running time is announced (infinite: never), and that running time.
        trainset: True plant.
        vehicle: True plant as arrays.
    """

    request: RunSpec
    run: Run
    known: dict[str, Any]
    sections: tuple[Section, Section]
    places: tuple[Place, Place]
    tracks: tuple[Track, Track]
    restricted_at_s: float
    restricted_s: float
    news: tuple[float, float]
    trainset: Trainset
    vehicle: Vehicle


class CompiledStart(NamedTuple):
    """One run of a batch, ready to begin.

    Attributes:
        case: Its cell.
        run: The run.
        setting: Values shared with other seeds.
        result: Its row of results, completed after the run.
        timing: Its row of timings.
    """

    case: CampaignCase
    run: Run
    setting: Setting
    result: dict[str, Any]
    timing: dict[str, Any]


def drive_batch(
    campaign: Campaign, cases: Sequence[CampaignCase]
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Drive rows with one learned driver on the nominal plant; returns result and timing of each.

    Args:
        campaign: The campaign.
        cases: At most ``BATCH``.
    """
    rows, starts, settings = [], [], {}
    for case in cases:
        began, spent = perf_counter(), process_time()
        result, timing = new_result(campaign, case)
        result["engine"] = "compiled"
        with capture_errors(result):
            starts.append(_start(campaign, case, settings, result, timing))
        timing |= {"wall_s": perf_counter() - began, "processor_s": process_time() - spent}
        rows.append((result, timing))
    if not starts:
        return rows
    began, spent = perf_counter(), process_time()
    driver = starts[0].setting.request.make_driver()
    if not isinstance(driver, AbstractPolicyDriver):
        raise TypeError(f"{driver.id} is no learned driver")
    record, outcome = _run_batch(campaign, driver.loaded_policy, starts)
    shares = (perf_counter() - began) / len(starts), (process_time() - spent) / len(starts)
    for k, start in enumerate(starts):
        began, spent = perf_counter(), process_time()
        with capture_errors(start.result):
            if outcome[k] == BROKEN:
                start.result |= {"outcome": FAILED, "error": "the policy answers what is not a number"}
            else:
                drive = _drive_of(driver.id, start, record, k)
                add_kpis(campaign, drive, _optimum(campaign, start, drive), start.result)
        start.timing["wall_s"] += shares[0] + perf_counter() - began
        start.timing["processor_s"] += shares[1] + process_time() - spent
        start.timing["worker_mb"] = peak_memory_mb()
    return rows


def _optimum(campaign: Campaign, start: CompiledStart, drive: Drive) -> Optimum | None:
    """The optimum of a run, from the energy curve of its plant, which the seeds share."""
    place = start.setting.places[int(drive.section is start.setting.sections[1])]
    section, objective = drive.section, campaign.objective
    try:
        curve = CURVES.get(
            (place, objective),
            lambda: EnergyCurve(section, drive.trainset, objective, driving_limits(drive.run, section)),
        )
        arrived = drive.outcome is Outcome.ARRIVED
        return curve.at(drive.running_time_s if arrived else drive.scheduled_time_s)
    except Infeasible:
        return None


def _start(
    campaign: Campaign,
    case: CampaignCase,
    settings: dict[str, Setting],
    result: dict[str, Any],
    timing: dict[str, Any],
) -> CompiledStart:
    """Prepare a row; seeds that differ only in the noise share the last setting."""
    seed = seed_of(campaign, case)
    key = str((case[2:8], case.disturbance.name))
    ranges = case.disturbance.ranges.values()
    if any(low < high for low, high in ranges) or key not in settings:
        settings.clear()
        settings[key] = _make_setting(campaign, case)
    setting = settings[key]
    result |= setting.known | {"seed": seed}
    return CompiledStart(case, replace(setting.run, seed=seed), setting, result, timing)


def _make_setting(campaign: Campaign, case: CampaignCase) -> Setting:
    known: dict[str, Any] = {}
    request, run = prepare_run(campaign, case, known)
    section, restricted_at, restricted_s = run.section, float("inf"), 0.0
    news = float("inf"), run.scheduled_time_s
    for item in run.disturbance.updates:
        if item.restriction is not None:
            section, restricted_at = section.with_restriction(item.restriction), item.at_s
            restricted_s += item.restriction.passing_time_s(run.trainset.length_m)
        if item.scheduled_time_s is not None:
            news = item.at_s, item.scheduled_time_s
    trainset, bounds = run.disturbance.true_plant(run.trainset), declared_bounds(run)
    first = request.restrictions
    restrictions = (*first, *(u.restriction for u in run.disturbance.updates if u.restriction is not None))
    where, what = case[2:5], (request.trainset, request.load, request.disturbance.ideal)
    return Setting(
        request=request,
        run=run,
        known=known,
        sections=(run.section, section),
        places=(Place((*where, first), what, bounds), Place((*where, restrictions), what, bounds)),
        tracks=(track_arrays(run.section, trainset), track_arrays(section, trainset)),
        restricted_at_s=restricted_at,
        restricted_s=restricted_s,
        news=news,
        trainset=trainset,
        vehicle=vehicle_arrays(trainset),
    )


def _run_batch(
    campaign: Campaign, loaded: LoadedPolicy, starts: Sequence[CompiledStart]
) -> tuple[CompiledRow, ndarray]:
    """Drive the batch to its end; returns the record, leading axes (steps, runs), and the outcomes."""
    import jax

    from metropilot.learn import keep_compiled

    keep_compiled()
    policy = loaded.policy.policy
    kind = Kind(policy.spec, loaded.interface, campaign.dt_s, GUARD_SPACING_M)
    slots = most_slots(campaign.trainset_keys, campaign.dt_s)
    tables, given = _episode_params(loaded, starts, slots)
    going = _at_departure(given, slots, policy.spec)
    streams = [
        noise_stream(start.run.seed) if start.run.disturbance.speed_noise_mps > 0 else None
        for start in starts
    ]
    record = []
    with double_precision(), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        params, tables, given, going = jax.tree.map(jax.numpy.asarray, (policy.params, tables, given, going))
        some = program(kind)
        while not record or (record[-1].outcome[-1, : len(starts)] == RUNNING).any():
            going, rows = some(params, tables, given, going, jax.numpy.asarray(_noise(streams)))
            record.append(jax.tree.map(np.asarray, rows))
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *record)
    return whole, whole.outcome[-1]


def _noise(streams: Sequence[np.random.Generator | None]) -> ndarray:
    """Standard normal noise of the next periods, each run from its own stream. Shape (PERIODS, BATCH)."""
    noise = np.zeros((PERIODS, BATCH))
    for k, stream in enumerate(streams):
        if stream is not None:
            noise[:, k] = stream.standard_normal(PERIODS)
    return noise


def _episode_params(
    loaded: LoadedPolicy, starts: Sequence[CompiledStart], slots: int
) -> tuple[Any, EpisodeParams]:
    """Tables of protection and of the policy, and the runs' parameters; the first run pads the batch."""
    kinds = (
        (table_cache(None), guard_tables),
        (table_cache(loaded.interface), partial(feature_tables, loaded.interface)),
    )
    numbers: dict[Place, int] = {}
    found: tuple[list[Any], list[Any]] = ([], [])
    rows = []
    for run, setting in ((start.run, start.setting) for start in starts):
        for place, section in zip(setting.places, setting.sections, strict=True):
            if place not in numbers:
                numbers[place] = len(numbers)
                for (cache, make), tables in zip(kinds, found, strict=True):
                    tables.append(cache.get(place, partial(make, section, run)))
        rows.append([numbers[place] for place in setting.places])
    fill = [*range(len(starts)), *[0] * (BATCH - len(starts))]
    settings = [starts[k].setting for k in fill]
    disturbances = [starts[k].run.disturbance for k in fill]
    bounds = [setting.places[0].bounds for setting in settings]
    places = np.array(rows, np.int32)[fill]
    given = EpisodeParams(
        vehicle=stack([setting.vehicle for setting in settings]),
        guard=places,
        seen=places,
        restricted_at_s=np.array([setting.restricted_at_s for setting in settings]),
        restricted_s=np.array([setting.restricted_s for setting in settings]),
        scheduled_s=np.array([setting.run.scheduled_time_s for setting in settings]),
        news_at_s=np.array([setting.news[0] for setting in settings]),
        news_s=np.array([setting.news[1] for setting in settings]),
        speed_noise_mps=np.array([each.speed_noise_mps for each in disturbances]),
        slots=np.array([delay_steps(b.delay_s, b.dt_s) + 1 for b in bounds], np.int32),
        length_m=np.array([setting.run.section.length_m for setting in settings]),
    )
    sizes = GUARD_NODES, SEEN_NODES
    return tuple(stack_tables(t, size, slots) for t, size in zip(found, sizes, strict=True)), given


def _at_departure(given: EpisodeParams, slots: int, spec: PolicySpec) -> EpisodeState:
    """States of the runs of a batch at departure (NumPy)."""
    import jax

    zero, count = np.zeros(BATCH), np.zeros(BATCH, np.int32)
    state = at_rest(given.vehicle, delay_steps=slots - 1)
    plant = state._replace(
        **{name: zero for name, value in state._asdict().items() if np.ndim(value) == 0 and name != "forces"},
        pipeline=np.zeros((BATCH, slots)),
        forces=Forces(*[zero] * len(Forces._fields)),
    )
    recent = np.where(np.arange(slots) >= given.slots[:, None] - 1, -1.0, 0.0)
    return EpisodeState(
        run=RunState(
            plant=plant,
            supervision=Memory(recent, zero, zero, count > 0, count, count, count, count),
            measured_mps=zero,
            stood_since_s=zero,
            outcome=np.full(BATCH, RUNNING, np.int32),
        ),
        policy=jax.tree.map(lambda value: np.stack([value] * BATCH), first_memory(spec)),
        motion=MeasuredMotion(*[zero] * len(MeasuredMotion._fields)),
    )


def _drive_of(driver_id: str, start: CompiledStart, record: CompiledRow, k: int) -> Drive:
    """One run of the batch in the form that the host loop returns."""
    run, setting = start.run, start.setting
    last = int(np.argmax(record.outcome[:, k] != RUNNING)) + 1
    own = {name: getattr(record, name)[:last, k] for name in CompiledRow._fields if name != "forces"}
    names = ("time_s", "position_m", "speed_mps", "traction_j", "line_j")
    rows = {name: np.concatenate([[0.0], own[name]]) for name in names}
    tracks, told = setting.tracks, own["told"]
    final = tracks[int(told[-1])]
    at, speed = rows["position_m"], rows["speed_mps"]
    limits = np.where(told > 0, train_limits_at(tracks[1], at[:-1]), train_limits_at(tracks[0], at[:-1]))
    trajectory = build_trajectory(
        setting.vehicle,
        run.dt,
        rows,
        own["acceleration_mps2"],
        Forces(*(force[:last, k] for force in record.forces)),
        own["command"],
        limit_mps=np.append(limits, train_limits_at(final, at[-1:])),
        permitted_mps=np.append(own["permitted_mps"], own["permitted_mps"][-1]),
    )
    over = float(own["overspeed_mps"].max())
    stopped = np.flatnonzero((speed[:-1] > 0.0) & (speed[1:] <= 0.0))
    stood_since = float(rows["time_s"][stopped[-1] + 1]) if stopped.size else 0.0
    overruled = own["overruled"]
    return Drive(
        run=run,
        driver=driver_id,
        trajectory=trajectory,
        outcome=final_outcome(int(own["outcome"][-1]), over),
        running_time_s=stood_since if speed[-1] <= 0 else float(rows["time_s"][-1]),
        scheduled_time_s=setting.news[1] if rows["time_s"][-2] >= setting.news[0] else run.scheduled_time_s,
        section=setting.sections[int(told[-1])],
        trainset=setting.trainset,
        interventions=int((np.diff(overruled, prepend=False) & overruled).sum()),
        max_overspeed_mps=over,
        recovered_j=float(own["recovered_j"][-1]),
        decision_us=np.zeros(last),
        overruled=overruled,
    )
