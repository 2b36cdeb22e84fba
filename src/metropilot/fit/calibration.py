"""Maximum-likelihood estimate of a trainset's parameters from logs, with intervals.

The speed of every run is simulated with the plant's force balance from the logged commands (or efforts); the
parameters are those with which the measured speeds are most probable, if their errors are independent and
normal (least squares), with Huber's weights beyond three standard deviations. Dead time and lag begin from
the best point of a grid. The covariance is that of the Jacobian; where residuals are correlated in time it is
widened after Newey and West (1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import InputError
from metropilot.fit.log import Log
from metropilot.fit.model import PlantParameters, simulate_speeds
from metropilot.fit.runs import Runs, cut_runs
from metropilot.physics import Vehicle, track_arrays, vehicle_arrays
from metropilot.railway import Davis, Section, Trainset
from metropilot.units import KMH_PER_MPS

Source = Literal["command", "effort"]
Resistance = Literal["auto", "factor", "coefficients"]
Group = Literal["mass", "brake", "resistance", "delay", "lag"]
SOURCES: tuple[Source, ...] = ("command", "effort")
RESISTANCES: tuple[Resistance, ...] = ("auto", "factor", "coefficients")
GROUPS: tuple[Group, ...] = ("mass", "brake", "resistance", "delay", "lag")
"""Parameters that can be kept at the trainset's values."""
OF_EFFORT = ("mass", "resistance")
"""Those that logs of the wheel force can tell."""
NORMAL_95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""
REFERENCE_MPS = 15.0
"""Speed at which the shares of the three coefficients are counted."""
MAX_DELAY_S, MAX_LAG_S = 3.0, 3.0
DELAYS_S = np.arange(0.0, 1.7, 0.2)
LAGS_S = np.array([0.0, 0.15, 0.3, 0.5, 0.8])
RIDGE_LAGS_S = np.arange(0.0, 1.25, 0.05)
RIDGE_SUMS_S = np.array([-0.08, -0.04, 0.0, 0.04, 0.08])
HUBER = 3.0
"""Residual in standard deviations beyond which a sample counts less."""
FIRST_STEPS = 6
"""Steps of the search before the noise is known."""
FLOOR_MPS = 1e-4
"""Least standard deviation of a residual, so that logs without noise can be fitted."""
WINDOW_S = 5.0
"""Time over which residuals may be correlated."""
COEFFICIENT_SHARE = 0.05
"""Largest standard error of a coefficient, over the resistance at 15 m/s, with which three are estimated."""
VAGUE = 0.5
"""Standard error over the plausible range beyond which a combination of parameters counts as unknown."""
INVOLVED = 0.25
"""Weight in an unknown combination from which a parameter is named."""
CONSTANT_MPS = 2.0
"""Range of speed below which a log says nothing about inertia."""
SUSPECT_MPS = 0.3
"""Residual beyond which trainset, units or track are in doubt."""
UNSEEN = 20.0
"""The same before the search, where only what does not show at all is refused."""
EARLY_MPS = 0.1
"""Largest noise assumed before the search has ended."""
TABLE_KMH = (20, 40, 60, 80, 100, 120, 140, 160)


class _Kind(NamedTuple):
    """Declaration of one number that may be estimated: plausible range, bounds, step of its difference."""

    group: str
    plausible: float
    low: float
    high: float
    step: float


_KINDS = {
    "mass_factor": _Kind("mass", 0.2, 0.3, 3.0, 1e-3),
    "brake_factor": _Kind("brake", 0.2, 0.3, 3.0, 1e-3),
    "resistance_factor": _Kind("resistance", 0.5, 0.0, 8.0, 5e-3),
    "davis_a": _Kind("resistance", 0.5, 0.0, 8.0, 3e-3),
    "davis_b": _Kind("resistance", 0.5, 0.0, 8.0, 3e-3),
    "davis_c": _Kind("resistance", 0.5, 0.0, 8.0, 3e-3),
    "delay_s": _Kind("delay", 0.5, 0.0, MAX_DELAY_S, 2e-2),
    "keep": _Kind("lag", 0.8, 0.0, 1.0, 1e-2),
}
_DAVIS = ("davis_a", "davis_b", "davis_c")
_WORDS = {"keep": "lag", "delay_s": "dead time"}


@dataclass(frozen=True)
class FittedParameter:
    """One parameter with its 95 % interval.

    Attributes:
        id: Name with unit.
        label: Name in words.
        unit: Unit; empty: a factor.
        value: Estimate.
        low: Lower end of the interval.
        high: Upper end of the interval.
        nominal: Value of the trainset that the fit began from.
        estimated: False where it was kept at the trainset's value.
    """

    id: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    nominal: float
    estimated: bool = True


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a fit.

    Attributes:
        nominal: Trainset that the fit began from.
        source: Input of the model, ``command`` or ``effort``.
        logs: Names of the logs.
        parameters: Estimated and kept parameters.
        resistance: Running resistance in N at speeds that occur, one parameter a speed.
        correlation: Correlations of the estimates, in the order of ``estimated``.
        estimated: Ids behind ``correlation``.
        samples: Samples used.
        run_count: Runs used.
        noise_mps: Standard deviation of the residuals.
        runs: The runs.
        residual_mps: Measured minus simulated speed of each sample.
        simulated_mps: Simulated speed of each sample.
        notes: Remarks.
    """

    nominal: Trainset
    source: Source
    logs: tuple[str, ...]
    parameters: tuple[FittedParameter, ...]
    resistance: tuple[FittedParameter, ...]
    correlation: Float[ndarray, "estimates estimates"]
    estimated: tuple[str, ...]
    samples: int
    run_count: int
    noise_mps: float
    runs: Runs
    residual_mps: Float[ndarray, " samples"]
    simulated_mps: Float[ndarray, " samples"]
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> FittedParameter:
        """The parameter with this id."""
        return next(p for p in self.parameters if p.id == name)

    def trainset(self) -> Trainset:
        """Trainset with the estimates in place of the nominal values."""
        old = self.nominal
        mass = _short(old.mass_kg * self["mass_factor"].value)
        a, b, c = (self[name].value for name in ("davis_a_n", "davis_b_n_per_mps", "davis_c_n_per_mps2"))
        share = mass if old.davis.per_mass else 1.0
        brake = self["brake_factor"].value
        changed = replace(
            old,
            loads={**old.loads, old.load: mass},
            davis=Davis(_short(a / share), _short(b / share), _short(c / share), per_mass=old.davis.per_mass),
            actuation=replace(
                old.actuation, delay_s=_short(self["delay_s"].value), lag_s=_short(self["lag_s"].value)
            ),
        )
        if not self["brake_factor"].estimated:
            return changed
        if not np.isfinite(old.service_deceleration_mps2):
            return replace(
                changed,
                electric_brake=old.electric_brake.scale(brake),
                friction_brake_n=old.friction_brake_n * brake,
            )
        service = _short(old.service_deceleration_mps2 * brake)
        safe = old.safe_braking
        asked = min(safe.service_deceleration_mps2, service)
        return replace(
            changed,
            service_deceleration_mps2=service,
            safe_braking=replace(safe, service_deceleration_mps2=asked),
        )


def _short(value: float) -> float:
    """The number with seven digits, more than any log determines."""
    return float(f"{float(value):.7g}")


def fit_trainset(
    logs: Sequence[Log],
    trainset: Trainset,
    *,
    sections: Sequence[Section] = (),
    source: Source | None = None,
    keep: Sequence[str] = (),
    resistance: Resistance = "auto",
) -> Calibration:
    """Estimate mass, brake, running resistance, dead time and lag of a trainset from logs.

    Args:
        logs: The logs.
        trainset: Nominal trainset: effort curves, jerk limit and load are taken from it.
        sections: Section of each log, or one for all, positions from its origin; empty: the gradient column.
        source: Input of the model; None: the command if every log has one.
        keep: Of ``GROUPS``: not estimated.
        resistance: One factor on the nominal resistance, its three coefficients, or (``auto``) three if the
            logs determine them.

    Raises:
        InputError: The logs do not determine a parameter; the message says which and what is missing.
    """
    source = _source_of(logs, source)
    vehicle = vehicle_arrays(trainset)
    if len(sections) not in {0, 1, len(logs)}:
        allowed = f"none, 1, or {len(logs)}, one for each log"
        raise InputError("wrong number of sections", field="line", value=len(sections), allowed=allowed)
    tracks = [track_arrays(section, trainset) for section in sections] or [None]
    runs = cut_runs(logs, source, vehicle, tracks * (len(logs) if len(tracks) == 1 else 1))
    groups = [g for g in (GROUPS if source == "command" else OF_EFFORT) if g not in keep]
    if not groups:
        raise InputError("nothing left to estimate", field="keep", allowed="fewer parameters")
    problem = _Problem(vehicle, runs, source == "effort")
    _check_moving(runs, groups, source)
    three = resistance == "coefficients"
    names = _names(groups, three=False)
    theta = _start(problem, names)
    speeds, jacobian = problem.linearize(names, theta)
    noise = min(_noise(speeds - runs.row_mps, theta.size), EARLY_MPS)
    _check_identifiable(problem, names, jacobian, noise, UNSEEN)
    if "resistance" in groups and (three or resistance == "auto"):
        more = _names(groups, three=True)
        begin = _split_resistance(problem, names, more, theta)
        if three or _tells_coefficients(problem, more, begin, noise):
            names, theta = more, begin
    theta = _along_ridge(problem, names, theta)
    return _result(problem, logs, trainset, (source, names, theta), _notes(logs, bool(sections), runs))


def _source_of(logs: Sequence[Log], wanted: Source | None) -> Source:
    """Input of the model.

    Raises:
        InputError: A log has no such column.
    """
    if not logs:
        raise InputError("no log", field="logs", allowed="at least one CSV file")
    have: dict[Source, bool] = {
        "command": all(log.command is not None for log in logs),
        "effort": all(log.effort_n is not None for log in logs),
    }
    if wanted is None:
        wanted = "command" if have["command"] or not have["effort"] else "effort"
    if not have[wanted]:
        columns = {"command": [log.command for log in logs], "effort": [log.effort_n for log in logs]}[wanted]
        file = next(log.name for log, column in zip(logs, columns, strict=True) if column is None)
        raise InputError(
            "column missing",
            file=file,
            field=wanted,
            allowed="'command' in -1 to 1 or in %, 'effort [kN]', or 'power [kW]' at the wheel",
        )
    return wanted


def _names(groups: Sequence[str], *, three: bool) -> list[str]:
    """Names of the numbers to estimate."""
    left_out = {"resistance_factor"} if three else set(_DAVIS)
    return [name for name, kind in _KINDS.items() if kind.group in groups and name not in left_out]


class _Problem:
    """Residuals and Jacobian of the speeds over named parameters and the unknown speeds at the start."""

    def __init__(self, vehicle: Vehicle, runs: Runs, effort: bool) -> None:
        self.vehicle, self.runs, self.effort = vehicle, runs, effort
        self.davis = np.array(vehicle.davis_n, dtype=float)
        v = REFERENCE_MPS
        nominal = float(self.davis @ np.array([1.0, v, v * v]))
        self.reference_n = nominal if nominal > 0 else 0.01 * float(vehicle.mass_kg * vehicle.gravity_mps2)
        self.powers = np.array([1.0, v, v * v])
        self.rolling = np.flatnonzero(runs.rolling)

    def nominal(self, name: str) -> float:
        """Value of the nominal trainset."""
        if name == "delay_s":
            return float(self.vehicle.delay_s)
        if name == "keep":
            lag = float(self.vehicle.lag_s)
            return float(np.exp(-self.runs.step_s / lag)) if lag > 0 else 0.0
        if name in _DAVIS:
            k = _DAVIS.index(name)
            return float(self.davis[k] * self.powers[k]) / self.reference_n
        return 1.0

    def bounds(self, name: str) -> tuple[float, float]:
        """Bounds of a number."""
        if name == "keep":
            return 0.0, float(np.exp(-self.runs.step_s / MAX_LAG_S))
        return _KINDS[name].low, _KINDS[name].high

    def plant(self, names: Sequence[str], rows: Float[ndarray, "sets n"]) -> PlantParameters:
        """Parameters of the plant for rows of estimated numbers; the others nominal."""
        given = dict(zip(names, rows.T, strict=True))
        count = rows.shape[0]

        def value(name: str) -> ndarray:
            return given.get(name, np.full(count, self.nominal(name)))

        factor = value("resistance_factor")
        a, b, c = (value(name) * factor * self.reference_n / self.powers[k] for k, name in enumerate(_DAVIS))
        return PlantParameters(
            value("mass_factor"), value("brake_factor"), a, b, c, value("delay_s"), value("keep")
        )

    def speeds(self, names: Sequence[str], rows: Float[ndarray, "sets n"]) -> Float[ndarray, "sets samples"]:
        """Speed of every sample; the last columns of ``rows`` are the speeds at the start."""
        count = len(names)
        start = np.repeat(self.runs.speed_mps[None], rows.shape[0], axis=0)
        start[:, self.rolling] = rows[:, count:]
        plant = self.plant(names, rows[:, :count])
        return simulate_speeds(self.vehicle, self.runs, plant, np.maximum(start, 0.0), effort=self.effort)

    def linearize(self, names: Sequence[str], theta: Float[ndarray, " n"]) -> tuple[ndarray, ndarray]:
        """Speeds and their Jacobian, by central differences of one batch."""
        count, starts = len(names), self.rolling.size
        steps = np.array([_KINDS[name].step for name in names])
        rows = np.repeat(theta[None], 2 * count + 1 + 2 * bool(starts), axis=0)
        upper, lower = np.empty(count), np.empty(count)
        for k, name in enumerate(names):
            low, high = self.bounds(name)
            upper[k], lower[k] = min(theta[k] + steps[k], high), max(theta[k] - steps[k], low)
            rows[1 + 2 * k, k], rows[2 + 2 * k, k] = upper[k], lower[k]
        if starts:
            # the start of a run acts on that run alone: all of them are varied together
            rows[-2, count:] += 0.01
            rows[-1, count:] -= 0.01
        speeds = self.speeds(names, rows)
        jacobian = np.zeros((speeds.shape[1], count + starts))
        for k in range(count):
            jacobian[:, k] = (speeds[1 + 2 * k] - speeds[2 + 2 * k]) / (upper[k] - lower[k])
        if starts:
            slope = (speeds[-2] - speeds[-1]) / 0.02
            for k, run in enumerate(self.rolling):
                here = self.runs.row_run == run
                jacobian[here, count + k] = slope[here]
        return speeds[0], jacobian


def _start(problem: _Problem, names: Sequence[str]) -> Float[ndarray, " n"]:
    """Start of the search: gains at the nominal actuation, then the best dead time and lag of a grid."""
    runs = problem.runs
    theta = np.concatenate([[problem.nominal(name) for name in names], runs.speed_mps[problem.rolling]])
    if not {"delay_s", "keep"} & set(names):
        return theta
    only_gains = all(_KINDS[name].group in {"delay", "lag"} for name in names)
    delays = DELAYS_S if "delay_s" in names else np.array([problem.nominal("delay_s")])
    lags = LAGS_S if "keep" in names else np.array([float(problem.vehicle.lag_s)])
    points = np.stack([x.ravel() for x in np.meshgrid(delays, lags, indexing="ij")], axis=1)
    for _ in range(2):
        theta = _best_actuation(problem, names, theta, points)
        if not only_gains:
            theta = _solve(problem, names, theta, most=4)
    return theta


def _best_actuation(
    problem: _Problem, names: Sequence[str], theta: Float[ndarray, " n"], points: Float[ndarray, "points 2"]
) -> Float[ndarray, " n"]:
    """The estimate with the best of some dead times and lags in s, its own among them."""
    step = problem.runs.step_s
    rows = np.repeat(theta[None], len(points) + 1, axis=0)
    delay, lag = points.T
    if "delay_s" in names:
        rows[1:, names.index("delay_s")] = np.clip(delay, 0.0, MAX_DELAY_S)
    if "keep" in names:
        rows[1:, names.index("keep")] = np.where(lag > 0, np.exp(-step / np.clip(lag, 1e-6, MAX_LAG_S)), 0.0)
    miss = problem.speeds(names, rows) - problem.runs.row_mps
    return rows[int(np.argmin(np.abs(miss).sum(axis=1)))]


def _along_ridge(
    problem: _Problem, names: Sequence[str], theta: Float[ndarray, " n"]
) -> Float[ndarray, " n"]:
    """Solve, then try other splits of dead time and lag: their sum is told sooner than its parts."""
    theta = _solve(problem, names, theta)
    if not {"delay_s", "keep"} <= set(names):
        return theta
    keep = float(theta[names.index("keep")])
    total = float(theta[names.index("delay_s")]) + (
        -problem.runs.step_s / np.log(keep) if keep > 1e-9 else 0.0
    )
    points = np.stack([x.ravel() for x in np.meshgrid(RIDGE_SUMS_S, RIDGE_LAGS_S, indexing="ij")], axis=1)
    points[:, 0] += total - points[:, 1]
    points = points[points[:, 0] >= 0.0]
    moved = _best_actuation(problem, names, theta, points)
    return theta if (moved == theta).all() else _solve(problem, names, moved)


def _solve(
    problem: _Problem, names: Sequence[str], theta: Float[ndarray, " n"], most: int = 40
) -> Float[ndarray, " n"]:
    """Least squares with Huber's weights."""
    from scipy.optimize import least_squares

    count = len(names)
    limits = [problem.bounds(name) for name in names] + [(0.0, 200.0)] * (theta.size - count)
    low, high = np.array(limits).T
    inside = 1e-6 * (high - low)
    theta = np.clip(theta, low + inside, high - inside)
    scale = np.array([_KINDS[name].plausible for name in names] + [0.1] * (theta.size - count))
    sigma = np.inf
    for _ in range(2):
        known: dict[bytes, tuple[ndarray, ndarray]] = {}

        def linear(
            x: ndarray, known: dict[bytes, tuple[ndarray, ndarray]] = known
        ) -> tuple[ndarray, ndarray]:
            key = x.tobytes()
            if key not in known:
                known.clear()
                known[key] = problem.linearize(names, x)
            return known[key]

        unit = sigma if np.isfinite(sigma) else 1.0
        found = least_squares(
            lambda x: (linear(x)[0] - problem.runs.row_mps) / unit,  # noqa: B023
            theta,
            jac=lambda x: linear(x)[1] / unit,  # noqa: B023 # pyright: ignore[reportArgumentType]
            bounds=(low, high),
            x_scale=scale,
            loss="linear" if unit == 1.0 else "huber",
            f_scale=1.0 if unit == 1.0 else HUBER,
            max_nfev=most if np.isfinite(sigma) else min(most, FIRST_STEPS),
            xtol=1e-6,
            ftol=1e-8,
        )
        theta = found.x
        miss = linear(theta)[0] - problem.runs.row_mps
        sigma = _noise(miss, theta.size)
        if most < 10:
            break
    return theta


def _noise(miss: Float[ndarray, " samples"], fitted: int) -> float:
    """Standard deviation of a sample: the rows that Huber's weights count in full."""
    robust = 1.4826 * float(np.median(np.abs(miss)))
    usual = np.abs(miss) <= HUBER * max(robust, FLOOR_MPS)
    return max(float(np.sqrt((miss[usual] ** 2).sum() / max(usual.sum() - fitted, 1))) / 0.9866, FLOOR_MPS)


def _split_resistance(
    problem: _Problem, names: Sequence[str], more: Sequence[str], theta: Float[ndarray, " all"]
) -> Float[ndarray, " m"]:
    """Start of the three coefficients from the factor."""
    given = dict(zip(names, theta, strict=False))
    factor = given["resistance_factor"]
    head = [given[n] if n in given else problem.nominal(n) * factor for n in more]
    return np.concatenate([head, theta[len(names) :]])


def _tells_coefficients(
    problem: _Problem, names: Sequence[str], theta: Float[ndarray, " n"], sigma: float
) -> bool:
    """Test if the logs determine the three coefficients of the resistance."""
    _, jacobian = problem.linearize(names, theta)
    covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-14) * sigma**2
    places = [names.index(name) for name in _DAVIS]
    seen = (jacobian[:, places] ** 2).sum(axis=0) > 0
    return bool(seen.all() and (np.sqrt(np.diag(covariance)[places]) < COEFFICIENT_SHARE).all())


def _check_moving(runs: Runs, groups: Sequence[str], source: Source) -> None:
    """Check for logs from which nothing about inertia can be told.

    Raises:
        InputError: The speed is constant.
    """
    low, high = float(runs.row_mps.min()), float(runs.row_mps.max())
    if high - low < CONSTANT_MPS:
        told = [name for name in groups if name in {"mass", "brake", "resistance", "delay", "lag"}]
        raise InputError(
            f"the speed is constant: {_join_words(told)} cannot be told apart",
            field="logs",
            value=f"{KMH_PER_MPS * low:.1f} to {KMH_PER_MPS * high:.1f}",
            unit="km/h",
            allowed=f"runs with {source} changes, over at least {KMH_PER_MPS * CONSTANT_MPS:g} km/h",
        )


def _join_words(words: Sequence[str]) -> str:
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]


def _check_identifiable(
    problem: _Problem,
    names: Sequence[str],
    jacobian: Float[ndarray, "samples n"],
    sigma: float,
    vague: float = VAGUE,
) -> None:
    """Check that every combination of the parameters shows in the logs.

    The singular values of the Jacobian, each parameter over its plausible range and each sample over its
    standard deviation, are the inverse standard errors of the combinations.

    Raises:
        InputError: One does not.
    """
    count = len(names)
    own, starts = jacobian[:, :count], jacobian[:, count:]
    if starts.shape[1]:
        own = own - starts @ np.linalg.lstsq(starts, own, rcond=None)[0]
    scaled = own * np.array([_KINDS[name].plausible for name in names]) / max(sigma, 0.01)
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    unknown = directions[values < 1.0 / vague]
    if not unknown.size:
        return
    weight = np.sqrt((unknown**2).sum(axis=0))
    named = [name for name, w in zip(names, weight, strict=True) if w > INVOLVED]
    words = _join_words([_WORDS.get(name, name.replace("_", " ")) for name in named])
    verb = "cannot be told apart" if len(named) > 1 else "cannot be estimated"
    options = list(dict.fromkeys(_KINDS[name].group for name in named))
    missing = _missing(problem.runs, problem.effort)
    raise InputError(
        f"{words} {verb}" + (f": the logs have {missing}" if missing else ""),
        field="logs",
        allowed="longer logs with traction, coasting and braking, or keep: " + ", ".join(options),
    )


def _missing(runs: Runs, effort: bool) -> str:
    """Phases that the logs do not have, in words."""
    given = runs.row_input / (max(float(np.abs(runs.row_input).max()), 1.0) if effort else 1.0)
    spent = runs.step_s
    missing = [
        word
        for word, rows in (
            ("no traction", given > 0.05),
            ("no coasting", np.abs(given) < 0.02),
            ("no braking", given < -0.05),
        )
        if rows.sum() * spent < 2.0
    ]
    if np.ptp(given) < 0.02:
        missing = ["a constant input", *missing]
    if runs.row_mps.size < 150:
        missing.append(f"{runs.row_mps.size} samples only")
    return _join_words(missing) if missing else ""


def _covariance(
    problem: _Problem, jacobian: Float[ndarray, "samples n"], miss: Float[ndarray, " samples"], sigma: float
) -> Float[ndarray, "n n"]:
    """Covariance of the estimates, widened where residuals are correlated in time (Newey and West, 1987)."""
    inverse = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-15, hermitian=True)
    plain = sigma**2 * inverse
    scores = jacobian * np.clip(miss, -HUBER * sigma, HUBER * sigma)[:, None]
    runs = problem.runs
    middle = np.zeros_like(plain)
    spacing = float(np.median(np.diff(runs.row_s)))
    lags = max(round(WINDOW_S / max(spacing, 1e-3)), 1)
    for run in range(runs.starts.size):
        own = scores[runs.row_run == run]
        middle += own.T @ own
        for lag in range(1, min(lags, len(own) - 1) + 1):
            cross = own[:-lag].T @ own[lag:] * (1.0 - lag / (lags + 1.0))
            middle += cross + cross.T
    wide = np.diag(inverse @ middle @ inverse)
    ratio = np.sqrt(np.maximum(wide / np.maximum(np.diag(plain), 1e-30), 1.0))
    return plain * np.outer(ratio, ratio)


def _result(
    problem: _Problem,
    logs: Sequence[Log],
    trainset: Trainset,
    fitted: tuple[Source, list[str], Float[ndarray, " n"]],
    notes: list[str],
) -> Calibration:
    """Estimates with their intervals."""
    source, names, theta = fitted
    speeds, jacobian = problem.linearize(names, theta)
    miss = problem.runs.row_mps - speeds
    sigma = _noise(miss, theta.size)
    _check_identifiable(problem, names, jacobian, sigma)
    _check_plausible(problem, names, theta)
    covariance = _covariance(problem, jacobian, miss, sigma)[: len(names), : len(names)]
    error = np.sqrt(np.diag(covariance))
    if sigma > SUSPECT_MPS:
        notes.append(f"residuals of {sigma:.2f} m/s: trainset, units or track may not be those of the logs")
    return Calibration(
        nominal=trainset,
        source=source,
        logs=tuple(log.name for log in logs),
        parameters=tuple(_parameters(problem, names, theta, covariance)),
        resistance=tuple(_resistance_table(problem, names, theta, covariance)),
        correlation=covariance / np.maximum(np.outer(error, error), 1e-30),
        estimated=tuple("lag_s" if name == "keep" else name for name in names),
        samples=int(miss.size),
        run_count=int(problem.runs.starts.size),
        noise_mps=sigma,
        runs=problem.runs,
        residual_mps=miss,
        simulated_mps=speeds,
        notes=tuple(notes),
    )


def _check_plausible(problem: _Problem, names: Sequence[str], theta: Float[ndarray, " n"]) -> None:
    """Check that gains are not at their bounds.

    Raises:
        InputError: One is.
    """
    for name, value in zip(names, theta, strict=False):
        low, high = problem.bounds(name)
        if _KINDS[name].group in {"mass", "brake"} and not low * 1.01 < value < high * 0.99:
            raise InputError(
                f"the {name.replace('_', ' ')} reaches the end of its range",
                field="logs",
                value=f"{value:.3g}",
                allowed=f"{low:g} to {high:g}; are trainset, load and units those of the logs?",
            )


def _parameters(
    problem: _Problem,
    names: Sequence[str],
    theta: Float[ndarray, " all"],
    covariance: Float[ndarray, "n n"],
) -> list[FittedParameter]:
    """Every parameter of the plant, estimated or kept."""
    at = {name: (theta[k], float(np.sqrt(covariance[k, k]))) for k, name in enumerate(names)}
    found = []
    for name, label in (("mass_factor", "mass / nominal"), ("brake_factor", "service brake / nominal")):
        found.append(_interval(problem, at, name, (name, label, "")))
    davis = dict(zip(_DAVIS, _davis_map(problem, names), strict=True))
    for (name, unit, label), power in zip(
        (
            ("davis_a_n", "N", "Davis, constant"),
            ("davis_b_n_per_mps", "N/(m/s)", "Davis, linear"),
            ("davis_c_n_per_mps2", "N/(m/s)²", "Davis, quadratic"),
        ),
        range(3),
        strict=True,
    ):
        fixed, row = davis[_DAVIS[power]]
        value = fixed + float(row @ theta[: len(names)])
        half = NORMAL_95 * float(np.sqrt(row @ covariance @ row))
        nominal = float(problem.davis[power])
        found.append(
            FittedParameter(
                name, label, unit, value, max(value - half, 0.0), value + half, nominal, bool(row.any())
            )
        )
    if "resistance_factor" in at:
        label = ("resistance_factor", "resistance / nominal", "")
        found.append(_interval(problem, at, "resistance_factor", label))
    found.append(_interval(problem, at, "delay_s", ("delay_s", "dead time", "s")))
    keep = _interval(problem, at, "keep", ("lag_s", "lag", "s"))
    step = problem.runs.step_s

    def lag(value: float) -> float:
        return float(-step / np.log(value)) if value > np.exp(-step / 0.005) else 0.0

    ends = (lag(x) for x in (keep.value, keep.low, min(keep.high, 0.9999)))
    if keep.estimated:
        value, low, high = ends
    else:
        value = low = high = float(problem.vehicle.lag_s)
    found.append(
        FittedParameter("lag_s", "lag", "s", value, low, high, float(problem.vehicle.lag_s), keep.estimated)
    )
    return found


def _interval(
    problem: _Problem, at: dict[str, tuple[float, float]], name: str, told: tuple[str, str, str]
) -> FittedParameter:
    """Parameter with its interval, cut at zero; a kept one has none."""
    nominal = problem.nominal(name)
    if name not in at:
        return FittedParameter(*told, nominal, nominal, nominal, nominal, estimated=False)
    value, error = at[name]
    value = float(value)
    low, high = max(value - NORMAL_95 * error, 0.0), value + NORMAL_95 * error
    return FittedParameter(*told, value, low, high, nominal)


def _davis_map(problem: _Problem, names: Sequence[str]) -> list[tuple[float, ndarray]]:
    """Each Davis coefficient as a constant and a row over the estimated numbers."""
    found = []
    for k, name in enumerate(_DAVIS):
        row, fixed = np.zeros(len(names)), 0.0
        if name in names:
            row[names.index(name)] = problem.reference_n / problem.powers[k]
        elif "resistance_factor" in names:
            row[names.index("resistance_factor")] = problem.davis[k]
        else:
            fixed = float(problem.davis[k])
        found.append((fixed, row))
    return found


def _resistance_table(
    problem: _Problem,
    names: Sequence[str],
    theta: Float[ndarray, " all"],
    covariance: Float[ndarray, "n n"],
) -> list[FittedParameter]:
    """Running resistance at speeds that occur in the logs."""
    rows = _davis_map(problem, names)
    fastest = float(problem.runs.row_mps.max())
    found = []
    for kmh in TABLE_KMH:
        v = kmh / KMH_PER_MPS
        if v > fastest + 1.0:
            break
        powers = (1.0, v, v * v)
        fixed = sum(p * f for p, (f, _) in zip(powers, rows, strict=True))
        row = sum((p * r for p, (_, r) in zip(powers, rows, strict=True)), np.zeros(len(names)))
        value = fixed + float(row @ theta[: len(names)])
        half = NORMAL_95 * float(np.sqrt(row @ covariance @ row))
        nominal = float(problem.davis @ np.array(powers))
        label = f"resistance at {kmh} km/h"
        found.append(
            FittedParameter(
                f"resistance_{kmh}kmh_n",
                label,
                "N",
                value,
                max(value - half, 0.0),
                value + half,
                nominal,
                bool(row.any()),
            )
        )
    return found


def _notes(logs: Sequence[Log], placed: bool, runs: Runs) -> list[str]:
    """Remarks on what the logs do not say."""
    notes = []
    flat = [log.name for log in logs if log.gradient_permil is None]
    if flat and not placed:
        count = f"{len(flat)} of {len(logs)} logs" if len(logs) > 1 else flat[0]
        notes.append(f"no gradient in {count}: level track assumed; --line gives a section's gradients")
    if runs.rolling.any():
        notes.append(
            f"{int(runs.rolling.sum())} of {runs.rolling.size} runs begin at speed, which is estimated"
        )
    return notes
