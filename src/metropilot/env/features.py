"""Observation of a policy: named features, scaled to a few units, over the array namespace.

The same functions serve the compiled task and a learned driver on the host. A feature is one small function
and one row of :data:`FEATURES`; an observer is a list of their names.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from metropilot._registry import Registry, RegistryRow
from metropilot._typing import Array, Float, Index, Scalar
from metropilot.control import COAST_SHARES, coast
from metropilot.env.tables import (
    CLIMB_COLUMN,
    PACES_MPS,
    PERMITTED_COLUMN,
    SectionRows,
    SectionTables,
    near_track,
)
from metropilot.errors import InputError
from metropilot.physics import (
    EffortLimits,
    Track,
    Vehicle,
    davis_n,
    effort_at,
    effort_limits,
    scalars,
)
from metropilot.protection import Rates as Guaranteed

if TYPE_CHECKING:
    from metropilot.env.assists import Assists

AHEAD_M = (20.0, 50.0, 100.0, 200.0, 350.0, 600.0, 1000.0)
FAR_M = (35.0, 75.0, 150.0, 275.0, 475.0, 800.0, 1500.0, 2200.0, 3500.0)
FASTER_MPS = (2.0,)
"""Increases of speed before coasting in ``coasting_faster``."""
INCREASES_MPS = (0.0, *FASTER_MPS)
CRAWL_MPS = 0.1
"""Least sum of the speeds at two nodes that the time of coasting counts with."""
CHECK_MPS = (12.0, 20.0)
RISES_SPM = tuple(1.0 / slower - 1.0 / faster for slower, faster in itertools.pairwise(PACES_MPS))
"""Increase of the time for one metre from each pace to the next slower one, s/m."""
SPEED_MPS = 20.0
DISTANCE_M = 1000.0
TIME_S = 100.0
RESERVE_S = 10.0
PER_KG = 1.0


class _State(NamedTuple):
    """Fields of a :class:`FeatureContext`.

    Attributes:
        rows: The task's tables.
        case: Row of the case.
        vehicle: Nominal plant.
        track: Section.
        length_m: Distance to the stop from the origin.
        load: Mass over the mean mass of all cases.
        stop_mps2: Deceleration with which station-stop braking is planned.
        rates: Bounds behind protection's emergency brake.
        time_s: Time since departure.
        position_m: Position.
        speed_mps: Measured speed.
        acceleration_mps2: Acceleration over the last period.
        scheduled_s: Scheduled running time in force.
        command: Last command given.
        assists: What limits the command and brakes to the stop.
    """

    rows: SectionRows
    case: Index
    vehicle: Vehicle
    track: Track
    length_m: Scalar
    load: Scalar
    stop_mps2: Scalar
    rates: Guaranteed
    time_s: Scalar
    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar
    scheduled_s: Scalar
    command: Scalar
    assists: Assists


class FeatureContext(_State):
    """Context of a state: the input of features, actions and assists. Numbers are 0-d.

    What several features need is computed once. The fields are those of ``_State``.
    """

    @functools.cached_property
    def xp(self) -> Any:  # noqa: ANN401 (a module)
        """Array namespace of the state's numbers: JAX's, NumPy for many states, ``scalars`` for one."""
        return self.rows.namespace(self.position_m)

    @functools.cached_property
    def left_m(self) -> Scalar:
        """Distance left, not below 0."""
        return self.xp.maximum(self.length_m - self.position_m, 0.0)

    @functools.cached_property
    def effort_limits(self) -> EffortLimits:
        """Resistance and available efforts here and now."""
        return effort_limits(self.vehicle, self.track, self.position_m, self.speed_mps)

    @functools.cached_property
    def to_go_s(self) -> Scalar:
        """Flat-out time to the stop from here and now."""
        return self.rows.to_go_s(self.case, self.left_m, self.length_m, self.speed_mps)

    @functools.cached_property
    def left_s(self) -> Scalar:
        """Time left until the scheduled arrival."""
        return self.scheduled_s - self.time_s

    @functools.cached_property
    def permitted_mps(self) -> Scalar:
        """Permitted speed here."""
        return self.rows.curve_at(PERMITTED_COLUMN, self.case, self.position_m)

    @functools.cached_property
    def coasting(self) -> tuple[Array, Array]:
        """Times to the stop if the trainset coasts from here, and its least speeds on the way.

        The first entries are for its speed, the others for speeds higher by ``FASTER_MPS``. Energy that is
        braked away on the way comes back, and the stop takes one deceleration: policies learned with it.
        """
        way = self._way_m
        permitted_mps = self.rows.curve_at(PERMITTED_COLUMN, self.case, _along(self.position_m) + way)
        top = self._highest_mps(_along(self.stop_mps2) * (way[..., -1:] - way), permitted_mps)
        speeds = self.rows.xp.minimum(self._coast(None), top[None])
        return _time_along(way, speeds), speeds[..., :-3].min(-1) / SPEED_MPS

    @functools.cached_property
    def braked_coasting_s(self) -> Array:
        """Times of ``coasting`` without the energy braked away, under the ceiling and to the planned stop."""
        way = self._way_m
        at = _along(self.position_m) + way
        work = _along(self.stop_mps2) * (way[..., -1:] - way)
        if self.assists.work_share:
            work = self.assists.work_share * self.rows.stop_work_at(self.case, at)
        ceiling_mps = self.assists.ceiling_at(self.rows, self.case, at)
        top = self._highest_mps(work, ceiling_mps, self.assists.below_mps + self.rates.speed_error_mps)
        return _time_along(way, self.rows.xp.minimum(self._coast(0.5 * top * top), top[None]))

    @functools.cached_property
    def _way_m(self) -> Array:
        """Distances from here at ``COAST_SHARES`` of the distance left."""
        xp, dtype = self.rows.xp, getattr(self.speed_mps, "dtype", float)
        return xp.asarray(COAST_SHARES, dtype) * xp.maximum(_along(self.left_m), 1.0)

    def _highest_mps(self, stop_jpkg: Array, most_mps: Array, below_mps: Scalar = 0.0) -> Array:
        """Highest speeds on the way: below the highest, and such that the work of the stop is enough."""
        xp = self.rows.xp
        stop_mps = xp.sqrt(2.0 * xp.maximum(stop_jpkg, 0.0) + 1e-6)
        return xp.minimum(xp.maximum(most_mps - below_mps, 0.5 * most_mps), stop_mps)

    @functools.cached_property
    def _climb_jpkg(self) -> Array:
        """Work of gradients and curves on the way, per effective mass."""
        vehicle, at = self.vehicle, _along(self.position_m) + self._way_m
        climb = self.rows.curve_at(CLIMB_COLUMN, self.case, at)
        return climb * (vehicle.mass_kg / vehicle.effective_mass_kg)

    def _coast(self, cap_jpkg: Array | None) -> Array:
        """Speeds on the way to the stop while coasting, from each of ``INCREASES_MPS``."""
        vehicle, way, climb = self.vehicle, self._way_m, self._climb_jpkg
        davis = [vehicle.davis_n[k] / vehicle.effective_mass_kg for k in range(3)]
        cap = None if cap_jpkg is None else cap_jpkg[None]
        return coast(self.speed_mps + _as_rows(self, INCREASES_MPS), way[None], climb[None], davis, cap)


def _time_along(way_m: Array, speeds_mps: Array) -> Array:
    """Times to the last of some places at the speeds there."""
    step = (way_m[..., 1:] - way_m[..., :-1])[None]
    return (2.0 * step / (speeds_mps[..., 1:] + speeds_mps[..., :-1] + CRAWL_MPS)).sum(-1)


def _along(value: Scalar) -> Scalar:
    """Values of many states along a new last axis; a single number as it is."""
    return value[..., None] if getattr(value, "ndim", 0) else value


def feature_context(  # noqa: PLR0913 (the state of a run, field by field)
    rows: SectionRows,
    case: Index,
    found: SectionTables,
    *,
    stop_mps2: Array,
    time_s: Array,
    position_m: Array,
    speed_mps: Array,
    acceleration_mps2: Array,
    scheduled_s: Array,
    command: Array,
    assists: Assists,
) -> FeatureContext:
    """Context of a state, in every engine that runs a policy. All numbers 0-d.

    Args:
        rows: Tables of the sections.
        case: Row in force.
        found: The row ``rows.case(case)``.
        stop_mps2: Deceleration with which station-stop braking is planned.
        time_s: Time since departure.
        position_m: Position.
        speed_mps: Measured speed.
        acceleration_mps2: Acceleration over the last period.
        scheduled_s: Scheduled running time in force.
        command: Last command given.
        assists: What limits the command and brakes to the stop.
    """
    # a compiled step holds only the pieces of the track around its position
    track = found.track if rows.xp is np else near_track(found.track, found.vehicle, position_m)
    return FeatureContext(
        rows=rows,
        case=case,
        vehicle=found.vehicle,
        track=track,
        length_m=found.length_m,
        load=found.load,
        stop_mps2=stop_mps2,
        rates=found.protection.rates,
        time_s=time_s,
        position_m=position_m,
        speed_mps=speed_mps,
        acceleration_mps2=acceleration_mps2,
        scheduled_s=scheduled_s,
        command=command,
        assists=assists,
    )


Feature = Callable[[FeatureContext], Sequence[Scalar]]


def position(context: FeatureContext) -> Sequence[Scalar]:
    """Position over the section's length."""
    return [context.position_m / context.length_m]


def speed(context: FeatureContext) -> Sequence[Scalar]:
    """Speed."""
    return [context.speed_mps / SPEED_MPS]


def acceleration(context: FeatureContext) -> Sequence[Scalar]:
    """Acceleration over the last period."""
    return [context.acceleration_mps2]


def command(context: FeatureContext) -> Sequence[Scalar]:
    """Last command."""
    return [context.command]


def distance_left(context: FeatureContext) -> Sequence[Scalar]:
    """Distance left, and its square root, in which a braking speed is linear."""
    return [context.left_m / DISTANCE_M, context.xp.sqrt(context.left_m / DISTANCE_M)]


def time_left(context: FeatureContext) -> Sequence[Scalar]:
    """Time left until the scheduled arrival."""
    return [context.left_s / TIME_S]


def elapsed(context: FeatureContext) -> Sequence[Scalar]:
    """Time since departure (with position and speed Lu23's state)."""
    return [context.time_s / TIME_S]


def reserve(context: FeatureContext) -> Sequence[Scalar]:
    """Time left beyond the flat-out time to go: in tens of seconds, fine near zero, and as a share."""
    xp = context.xp
    spare = context.left_s - context.to_go_s
    share = spare / xp.maximum(context.to_go_s, 2.0)
    return [spare / RESERVE_S, xp.tanh(spare / 2.0), xp.clip(share, -1.0, 2.0)]


def mean_speed(context: FeatureContext) -> Sequence[Scalar]:
    """Mean speed that the time left requires, and the excess of the speed over it."""
    xp = context.xp
    mean = xp.clip(context.left_m / xp.maximum(context.left_s, 1.0), 0.0, 40.0)
    return [mean / SPEED_MPS, (context.speed_mps - mean) / SPEED_MPS]


def braking(context: FeatureContext) -> Sequence[Scalar]:
    """Constant deceleration that stops at the stop from here."""
    v = context.speed_mps
    return [context.xp.minimum(v * v / (2.0 * context.xp.maximum(context.left_m, 0.1)), 2.0)]


def permitted(context: FeatureContext) -> Sequence[Scalar]:
    """Difference between permitted speed and speed, here."""
    return [context.xp.clip((context.permitted_mps - context.speed_mps) / 5.0, -2.0, 4.0)]


def permitted_ahead(context: FeatureContext) -> Sequence[Scalar]:
    """Permitted speed at several distances ahead."""
    return _permitted_at(context, AHEAD_M)


def permitted_far(context: FeatureContext) -> Sequence[Scalar]:
    """Permitted speed further ahead, and between the distances of ``permitted_ahead``."""
    return _permitted_at(context, FAR_M)


def _permitted_at(context: FeatureContext, ahead_m: Sequence[float]) -> Sequence[Scalar]:
    at = context.position_m + _as_rows(context, ahead_m)
    return list(context.rows.curve_at(PERMITTED_COLUMN, context.case, at) / SPEED_MPS)


def _as_rows(context: FeatureContext, values: Sequence[float] | np.ndarray) -> Scalar:
    """Constants along a new first axis. Shape (K,), or (K, 1, ...) for many positions."""
    if context.xp is scalars:
        return np.asarray(values, float)
    position = context.position_m
    return context.xp.asarray(values, position.dtype).reshape((-1,) + (1,) * position.ndim)


def climb_ahead(context: FeatureContext) -> Sequence[Scalar]:
    """Mean of gradient and curve resistance over several distances ahead, and over the distance left."""
    return climb_within(context, (*AHEAD_M, np.inf))


def climb_far(context: FeatureContext) -> Sequence[Scalar]:
    """Mean of gradient and curve resistance over the distances of ``permitted_far``."""
    return climb_within(context, FAR_M)


def climb_within(context: FeatureContext, ahead_m: Sequence[float]) -> Sequence[Scalar]:
    """Mean of gradient and curve resistance over distances ahead, at most up to the stop."""
    here = context.rows.curve_at(CLIMB_COLUMN, context.case, context.position_m)
    way = context.rows.xp.minimum(context.xp.maximum(context.left_m, 1.0), _as_rows(context, ahead_m))
    there = context.rows.curve_at(CLIMB_COLUMN, context.case, context.position_m + way)
    return list((there - here) / way * 5.0)


def efforts(context: FeatureContext) -> Sequence[Scalar]:
    """Largest traction, largest braking and running resistance here, per kilogram."""
    effort = effort_at(context.vehicle, context.speed_mps)
    mass = context.vehicle.effective_mass_kg * PER_KG
    drag = davis_n(context.vehicle, context.speed_mps)
    return [effort.traction_n / mass, effort.brake_n / mass, 10.0 * drag / mass]


def efforts_ahead(context: FeatureContext) -> Sequence[Scalar]:
    """Largest traction and resistance at two fixed speeds, per kilogram; the planned stop deceleration."""
    vehicle, parts = context.vehicle, []
    for speed_mps in CHECK_MPS:
        v = 0.0 * context.speed_mps + speed_mps
        parts += [effort_at(vehicle, v).traction_n, 10.0 * davis_n(vehicle, v)]
    parts = [part / vehicle.effective_mass_kg for part in parts]
    return [*parts, context.stop_mps2 + 0.0 * context.speed_mps]


def coasting(context: FeatureContext) -> Sequence[Scalar]:
    """Spare time if the trainset coasts from here to station-stop braking, and its least speed."""
    taken, slowest = context.coasting
    return [*_spare(context, taken[0]), context.xp.tanh((context.left_s - taken[0]) / 2.0), slowest[0]]


def coasting_faster(context: FeatureContext) -> Sequence[Scalar]:
    """Spare time and least speed of coasting from a higher speed, to anticipate the coasting point."""
    xp, parts = context.xp, []
    for taken, slowest in zip(*(found[1:] for found in context.coasting), strict=True):
        spare = context.left_s - taken
        parts += [xp.tanh(spare / 20.0), xp.tanh(spare / 3.0), slowest]
    return parts


def pace(context: FeatureContext) -> Sequence[Scalar]:
    """Pace: the speed to hold, wherever limits and station-stop braking admit it, to arrive in the time left.

    Interpolated from the tabulated times at ``PACES_MPS``, linear in the inverse of the speed; once for the
    time left, and once less the time lost while reaching the pace under full traction.
    """
    xp, v = context.xp, context.speed_mps
    times = context.rows.pace_times_s(context.case, context.position_m)
    wanted, free = _pace(context, times, context.left_s)
    effort = effort_at(context.vehicle, v).traction_n - davis_n(context.vehicle, v)
    pull = xp.minimum(effort / context.vehicle.effective_mass_kg, context.vehicle.max_acceleration_mps2)
    missing = xp.maximum(wanted - v, 0.0)
    lost = missing * missing / (2.0 * xp.maximum(pull, 0.1) * wanted)
    after, _ = _pace(context, times, context.left_s - lost)
    return [
        wanted / SPEED_MPS,
        after / SPEED_MPS,
        xp.clip((after - v) / 5.0, -4.0, 4.0),
        xp.tanh(after - v),
        free / xp.maximum(context.left_m, 1.0),
    ]


def _pace(context: FeatureContext, times: Array, left_s: Scalar) -> tuple[Array, Array]:
    """Pace whose time to the stop equals the time left, m/s, and the distance driven at it, m."""
    xp = context.rows.xp
    slower, faster = times[..., :-1], times[..., 1:]
    rises = xp.asarray(RISES_SPM, times.dtype)
    left_s = left_s if context.xp is scalars else left_s[..., None]
    share = (left_s - faster) / xp.maximum(slower - faster, 1e-3)
    share = xp.minimum(xp.maximum(share, 0.0), 1.0)
    driven = xp.where((share > 0.0) & (share < 1.0), (slower - faster) / rises, 0.0)
    return 1.0 / (1.0 / PACES_MPS[-1] + (share * rises).sum(-1)), driven.sum(-1)


def steady(context: FeatureContext) -> Sequence[Scalar]:
    """Spare time if the trainset holds its speed up to station-stop braking."""
    v = context.xp.maximum(context.speed_mps, 1.0)
    return _spare(context, context.left_m / v + 0.5 * v / context.stop_mps2)


def _spare(context: FeatureContext, taken_s: Scalar) -> list[Scalar]:
    """Time left beyond a time taken: linear, with fine resolution near zero, and as a share."""
    xp = context.xp
    spare = xp.clip(context.left_s - taken_s, -200.0, 200.0)
    share = xp.clip(spare / xp.maximum(context.left_s, 5.0), -2.0, 2.0)
    return [spare / 50.0, xp.tanh(spare / 10.0), share]


def load(context: FeatureContext) -> Sequence[Scalar]:
    """Mass over the mean mass of all cases."""
    return [3.0 * (context.load - 1.0)]


def delay(context: FeatureContext) -> Sequence[Scalar]:
    """Known dead time and lag of the actuation."""
    return [context.vehicle.delay_s, context.vehicle.lag_s]


def build_up(context: FeatureContext) -> Sequence[Scalar]:
    """Time that the jerk limit takes to build up 1 m/s^2, s; 0 without a jerk limit."""
    return [1.0 / context.vehicle.jerk_mps3]


def position_m(context: FeatureContext) -> Sequence[Scalar]:
    """Absolute position, km (Chen23a's state with ``speed``)."""
    return [context.position_m / DISTANCE_M]


FEATURES: Registry[Feature] = Registry(
    "feature",
    {
        f.__name__: RegistryRow(f, (f.__doc__ or "").partition("\n")[0])
        for f in (
            position,
            position_m,
            speed,
            acceleration,
            command,
            distance_left,
            time_left,
            elapsed,
            reserve,
            mean_speed,
            braking,
            permitted,
            permitted_ahead,
            permitted_far,
            climb_ahead,
            climb_far,
            efforts,
            efforts_ahead,
            coasting,
            coasting_faster,
            steady,
            pace,
            load,
            delay,
            build_up,
        )
    }
    | {
        "expert": RegistryRow(
            "metropilot.studies.huang2025.env:expert_features",
            "State inside the expert of Huang25 (its eq. 19)",
        )
    },
)
"""Every feature; that of a paper is in its study."""

FEATURE_WORDS: Mapping[str, str] = MappingProxyType(
    {
        "position": "position on the section",
        "position_m": "position",
        "speed": "speed",
        "acceleration": "acceleration",
        "command": "last command",
        "distance_left": "distance to the stop",
        "time_left": "time left",
        "elapsed": "time since departure",
        "reserve": "running-time reserve",
        "mean_speed": "mean speed that the timetable needs",
        "braking": "braking rate that the stop needs",
        "permitted": "margin to the permitted speed",
        "permitted_ahead": "permitted speed up to 1 km ahead",
        "permitted_far": "permitted speed further ahead",
        "climb_ahead": "gradients up to 1 km ahead",
        "climb_far": "gradients further ahead",
        "efforts": "tractive effort, braking effort, resistance",
        "efforts_ahead": "tractive effort and resistance at higher speeds",
        "coasting": "time to spare when coasting from here",
        "coasting_faster": "time to spare when coasting later",
        "steady": "time to spare at constant speed",
        "pace": "speed to hold for the timetable",
        "load": "load",
        "delay": "dead time and lag",
        "build_up": "jerk limit",
        "expert": "state of the expert system",
    }
)
"""Every feature in the field's words."""

SECTION = (
    "position",
    "speed",
    "distance_left",
    "time_left",
    "reserve",
    "mean_speed",
    "braking",
    "permitted",
    "load",
    "command",
)

ANYWHERE = (
    "speed",
    "distance_left",
    "time_left",
    "reserve",
    "mean_speed",
    "braking",
    "permitted",
    "permitted_ahead",
)

OBSERVERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "position_speed": ("position_m", "speed"),
        "position_speed_time": ("position", "speed", "elapsed"),
        "section": SECTION,
        "section_jerk": (*SECTION, "acceleration", "build_up"),
        "route": (
            *ANYWHERE,
            "climb_ahead",
            "efforts",
            "load",
            "command",
            "acceleration",
        ),
        "line": (
            *ANYWHERE,
            "permitted_far",
            "climb_ahead",
            "climb_far",
            "efforts",
            "efforts_ahead",
            "coasting",
            "coasting_faster",
            "steady",
            "pace",
            "build_up",
        ),
    }
)
"""Named observers: Chen23a's two numbers, Lu23's three, one for a section, two for any section."""


def check_features(names: Iterable[str], known: Iterable[str], field: str) -> None:
    """Refuse names of features that are not known.

    Args:
        names: Names of features.
        known: Those that there are.
        field: Named in the error.

    Raises:
        InputError: One of them is not known.
    """
    known = tuple(known)
    unknown = sorted(set(names).difference(known))
    if unknown:
        raise InputError("unknown feature", field=field, value=", ".join(unknown), allowed=", ".join(known))


def observe(features: Sequence[str], context: FeatureContext) -> Float[Array, " features"]:
    """Observation: every feature in order, single precision."""
    values = [value for name in features for value in FEATURES.get(name)(context)]
    if context.xp is scalars:
        return np.array(values, np.float32)
    return context.xp.stack(values).astype(np.float32)
