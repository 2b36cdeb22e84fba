"""Functions that run aboard, traced for some sections: decision, supervisor, plant of the example."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from metropilot._typing import Array
from metropilot.aboard.graph import Graph, trace_graph
from metropilot.aboard.host import trace_host
from metropilot.campaign import DecisionMemory, Kind, Measurements, decide_by_policy, first_memory
from metropilot.drivers import DRIVERS, AbstractPolicyDriver, LearnedDriver
from metropilot.env import SectionRows, build_tables, near_track
from metropilot.errors import InputError
from metropilot.physics import (
    Command,
    State,
    at_rest,
    delay_steps,
    double_precision,
    stack,
    step,
    track_arrays,
    vehicle_arrays,
)
from metropilot.planning import minimum_running_time
from metropilot.policy import LoadedPolicy, Policy, in_precision
from metropilot.protection import (
    Bounds,
    Memory,
    Protection,
    Verdict,
    at_start,
    protect,
    supervise,
)
from metropilot.railway import Section, Trainset
from metropilot.sim import CONTROL_PERIOD_S, AbstractDriver, Run, declared_bounds

CURVES = ("emergency", "service", "pull_mps2", "usual_pull_mps2", "permitted_mps")
AUTHORITY = "authority_m"
NUMBERS = {"double": np.float64, "float": np.float32}
FALLBACK_RATIO = 1.2
"""Scheduled over minimum running time where the line has no timetable."""
GUARD_SPACING_M = 1.0
"""Distance between the nodes of protection, as in the host loop."""


class AboardMemory(NamedTuple):
    """State of a supervised driver between two control periods.

    Attributes:
        policy: Memory of the driver, of a policy :class:`metropilot.campaign.DecisionMemory`.
        supervision: Memory of protection.
    """

    policy: Any
    supervision: Memory


@dataclass(frozen=True)
class AboardProgram:
    """A supervised driver on some sections, as graphs.

    Attributes:
        name: Id of the driver.
        sections: Sections, in the order of their numbers.
        trainset: Trainset with its load.
        bounds: Deviations from the nominal plant that protection allows for.
        number: Number type, ``double`` or ``float``.
        memory: State at departure.
        plant: State of the example's plant at departure.
        driver: The same driver in Python, without protection: what the C is compared with.
        decide: From the number of the section, the measurements, the scheduled running time, the level of
            protection's last intervention and the driver's memory to a command and the next memory. One graph
            for all sections, or one for each.
        supervise: From the number of the section, position, speed, command, a request of the emergency brake
            and protection's memory to command, next memory and verdict.
        move: From the number of the section, the plant's state, and a command to the next state.
    """

    name: str
    sections: tuple[Section, ...]
    trainset: Trainset
    bounds: Bounds
    number: str
    memory: AboardMemory
    plant: State
    driver: AbstractDriver
    decide: tuple[Graph, ...]
    supervise: Graph
    move: Graph


def check_exportable(name: str) -> None:
    """Raise an error that says why a driver cannot be written in C, and what can.

    Args:
        name: Id of a driver; what is no driver is a policy of its own.

    Raises:
        InputError: It cannot.
    """
    if name in DRIVERS and not _has_form(name):
        raise _refusal(name)


def exportable() -> list[str]:
    """Drivers with a form aboard: learned policies, and those that say which (``AbstractDriver.aboard``)."""
    return [name for name in DRIVERS.ids() if _has_form(name)]


def _has_form(name: str) -> bool:
    kind = DRIVERS.get(name)
    return issubclass(kind, AbstractPolicyDriver) or kind().aboard(np.float64) is not None


def _refusal(name: str) -> InputError:
    words = "the driver plans or searches as it drives, which has no form in C"
    return InputError(words, field="export", value=name, allowed=", ".join(exportable()))


def trace_driver(
    name: str,
    driver: AbstractDriver | LoadedPolicy,
    sections: Sequence[Section],
    trainset: Trainset,
    *,
    number: str = "double",
    dt_s: float = CONTROL_PERIOD_S,
) -> AboardProgram:
    """Trace a driver, protection, and the plant.

    Args:
        name: Name of the driver.
        driver: The driver, or the policy of a learned one.
        sections: Sections that it is to drive, each in its scheduled running time if it keeps to one.
        trainset: Nominal trainset with its load.
        number: ``double`` or ``float``.
        dt_s: Control period.

    Raises:
        InputError: Something in it has no form in C.
    """
    import jax

    dtype = NUMBERS[number]
    first = Run(sections[0], trainset, 1.0, dt=dt_s)
    bounds = declared_bounds(first)
    guards = [
        protect(section, trainset, bounds, dtype=dtype, spacing_m=GUARD_SPACING_M) for section in sections
    ]
    supervision = at_start(guards[0])
    vehicle = vehicle_arrays(trainset)
    plant = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), dt_s))
    whole, zero, false = np.int32(0), dtype(0.0), np.bool_(False)
    precision = double_precision() if number == "double" else jax.enable_x64(False)
    form = _form(driver, dtype)
    if form is None:
        raise _refusal(name)
    with precision, jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        if (
            isinstance(driver, LoadedPolicy)
            and isinstance(form, LearnedDriver)
            and not form.estimates_plant(first)
        ):
            memory = first_memory(driver.policy.policy.spec)
            policy = _policy(driver, sections, trainset, bounds, dtype, dt_s)
            measured = Measurements(zero, zero, zero, zero)
            decide = (trace_graph(policy, whole, measured, zero, whole, _numbers(memory, dtype)),)
        else:
            runs = [Run(each, trainset, scheduled_time_s(each, trainset), dt=dt_s) for each in sections]
            decide, memory = trace_host(form, runs, dtype)
        guard = _supervisor(guards)
        supervised = trace_graph(guard, whole, zero, zero, zero, false, _numbers(supervision, dtype))
        move = trace_graph(
            _plant(sections, trainset, dtype, dt_s), whole, _numbers(plant, dtype), zero, false
        )
    return AboardProgram(
        name=name,
        sections=tuple(sections),
        trainset=trainset,
        bounds=bounds,
        number=number,
        memory=AboardMemory(memory, supervision),
        plant=plant,
        driver=form,
        decide=decide,
        supervise=supervised,
        move=move,
    )


def _form(driver: AbstractDriver | LoadedPolicy, number: type) -> AbstractDriver | None:
    """The driver as it is aboard; a network computes in the number type of the rest."""
    if isinstance(driver, LoadedPolicy):
        known = driver.policy.policy
        driver = LearnedDriver(Policy(known.spec, in_precision(known.params, number)), driver.interface)
    return driver.aboard(number)


def scheduled_time_s(section: Section, trainset: Trainset) -> float:
    """Scheduled running time; of a line without a timetable ``FALLBACK_RATIO`` of the minimum."""
    return section.planned_time_s or FALLBACK_RATIO * minimum_running_time(section, trainset)


def _numbers(tree: Any, dtype: type) -> Any:  # noqa: ANN401 (a tree of arrays)
    """The same tree, its floating-point numbers in one type."""
    import jax

    return jax.tree.map(lambda a: a.astype(dtype) if np.asarray(a).dtype.kind == "f" else a, tree)


def _policy(
    loaded: LoadedPolicy,
    sections: Sequence[Section],
    trainset: Trainset,
    bounds: Bounds,
    dtype: type,
    dt_s: float,
) -> Any:  # noqa: ANN401 (a function to trace)
    """Function of the policy; what it cannot answer is a command that is not a number."""
    import jax
    import jax.numpy as jnp

    interface, policy = loaded.interface, loaded.policy.policy
    cases = [(each, trainset, bounds) for each in sections]
    tables = build_tables(cases, interface.spacing_m, dtype, fading=interface.action.fading)
    load = np.full(len(sections), trainset.mass_kg / interface.mean_mass_kg, dtype)
    seen = SectionRows(tables._replace(load=load), jax=True)
    kind = Kind(policy.spec, interface, dt_s, GUARD_SPACING_M)
    params = in_precision(policy.params, dtype)

    def decide(
        case: Array, measured: Measurements, scheduled_s: Array, level: Array, memory: DecisionMemory
    ) -> tuple[Array, DecisionMemory]:
        del level
        after, broken = decide_by_policy(kind, params, seen, case, measured, scheduled_s, memory)
        known = jnp.all(jnp.isfinite(jnp.stack([*measured, scheduled_s]))) & (broken ^ True)
        # with a measurement lost the policy waits as it is, and protection brakes
        kept = jax.tree.map(lambda new, old: jnp.where(known, new, old), after, memory)
        return jnp.where(known, after.command, jnp.nan), kept

    return decide


def _supervisor(guards: Sequence[Protection]) -> Any:  # noqa: ANN401 (a function to trace)
    """Function of the supervisor: the same as in every run, the curves those of the section's number."""
    import jax.numpy as jnp

    ahead = guards[0].ahead.size
    used = max(int(np.flatnonzero(each.permitted_mps)[-1]) for each in guards) + 2
    size = min(used + ahead + 2, max(each.emergency.size for each in guards))

    def rows(name: str) -> Array:
        values = [np.asarray(getattr(each, name)) for each in guards]
        if values[0].ndim:
            values = [np.pad(value, (0, max(size - value.size, 0)), "edge")[:size] for value in values]
        return jnp.asarray(np.stack(values))

    tables = {name: rows(name) for name in (*CURVES, AUTHORITY, "start_m")}

    def decide(
        case: Array, position_m: Array, speed_mps: Array, share: Array, emergency: Array, memory: Memory
    ) -> tuple[Command, Memory, Verdict]:
        values = {name: (table[0] if len(guards) == 1 else table[case]) for name, table in tables.items()}
        protection = guards[0]._replace(**values)
        return supervise(protection, memory, position_m, speed_mps, Command(share, emergency))

    return decide


def _plant(sections: Sequence[Section], trainset: Trainset, dtype: type, dt_s: float) -> Any:  # noqa: ANN401
    """Function of the example's plant: the nominal one."""
    import jax
    import jax.numpy as jnp

    vehicle = vehicle_arrays(trainset, dtype)
    tracks = stack([_numbers(track_arrays(each, trainset), dtype) for each in sections])
    tracks = jax.tree.map(jnp.asarray, tracks)

    def move(case: Array, state: State, share: Array, emergency: Array) -> State:
        track = jax.tree.map(lambda a: a[0] if len(sections) == 1 else a[case], tracks)
        near = near_track(track, vehicle, state.position_m)
        return step(vehicle, near, state, Command(share, emergency), dt_s)

    return move
