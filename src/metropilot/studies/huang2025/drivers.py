"""EITOE and the drivers that learned inside its expert rules: no reference profile.

In every control period, in this order: the effect of the last command, the state in which a command given now
acts, the station-stop braking if it must begin, the safe speed, and else the rate by the window, changed by a
constant (EITOE) or by a policy. Source: Huang25 section 3 (rules 1 to 5, eqs. 14 to 24, Algorithm 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast, final

import numpy as np

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Index, Scalar

# by name: the export to C replaces functions in the modules that name them
from metropilot.control import (
    Ceiling,
    CommandActuation,
    Model,
    PredictedState,
    StateEstimate,
    StopCurve,
    StopOptions,
    actuation_of,
    ceiling_of,
    curve_for,
    estimated_actuation,
    initial_estimate,
    largest_admissible_command,
    model_of,
    record_command,
    start_command,
    update_estimate,
)
from metropilot.drivers import (
    DECISION_EARLY_S,
    AbstractNetworkDriver,
    FeatureSpan,
    NetworkView,
    PolicyOptions,
)
from metropilot.env import FEATURE_WORDS
from metropilot.errors import InputError
from metropilot.physics import scalars
from metropilot.policy import LoadedPolicy, Policy, in_precision, load_driving_policy, shipped_policy
from metropilot.protection import Memory, at_start, periods_in_effect
from metropilot.railway import Section
from metropilot.sim import AbstractDriver, Observation, Run, declared_bounds
from metropilot.studies.huang2025.env import ExpertAction, ExpertChoiceAction
from metropilot.studies.huang2025.laws import (
    EXPERT_STATE,
    GAIN,
    RELEASE_SHARE,
    SETTLED,
    STEP_M,
    UNSURE,
    ExpertRules,
    ExpertTrack,
    ExpertWindow,
    Hoa,
    Leg,
    Legs,
    build_up_s,
    coasting_time,
    constant_rate_change,
    expect_mass,
    expert_state,
    expert_track,
    expert_window,
    lead_s,
    legs_of,
    next_expert_rate,
    stop_share,
    update_gain,
)

HOLD_PER_S = 0.5
"""Acceleration for each m/s below the safe speed."""
BACK_PER_S = 1.0
"""Deceleration for each m/s above it."""
EASE_PER_S = 2.0
"""Deceleration taken off for each m/s below a safe speed that falls."""
CLEAR_MPS = 3.0
"""Farther below the safe speed than this nothing needs to be eased off."""
HOA_STOP = StopOptions(lag_ramp=False)
"""The heuristic online algorithm begins earlier by half the lag instead."""
MARGIN_MPS, LATE_MARGIN_MPS, LATE_MARGIN_MPS2 = 0.25, 0.08, 0.25
"""Distance of the ceiling from the permitted speed. Where commands act late it is at least the second, and
the third for each second of a period, in which the speed may rise unseen."""
CRAWL_MPS, CRAWLS_M = 1.25, 30.0
"""Highest speed of a crawl to the stop on a climb, and how near to it one is held."""
TIGHT = 1.03
"""Time left over the least time below which no time is given away for a lower limit ahead."""


class RateInputs(NamedTuple):
    """Inputs to a choice of the change of the rate.

    Attributes:
        window: The speed window.
        speed_mps: Speed.
        left_m: Distance to the end of the interval.
        time_left_s: Time it has for that.
        rate_mps2: The rate now.
        top_mps2: Largest rate here.
        traction_mps2: Largest traction.
    """

    window: ExpertWindow
    speed_mps: float
    left_m: float
    time_left_s: float
    rate_mps2: float
    top_mps2: float
    traction_mps2: float


Change = Callable[[RateInputs], tuple[Scalar, Any]]
"""The wanted change of the rate in an interval, m/s^2, and what its chooser remembers of it."""


class ExpertMemory(NamedTuple):
    """Memory of an expert driver between two periods.

    Attributes:
        run: The run.
        section: The section as last announced.
        rules: The expert's constants.
        model: Trainset and section as believed.
        ceiling: Speeds protection permits.
        ground: Tables of both.
        legs: The speed-limit intervals.
        actuation: Commands on their way, as declared.
        estimate: Estimate of the plant: dead time and lag where the answers contradict what is declared.
        hoa: Knowledge of the brake.
        supervision: State of protection, kept alongside where commands act late.
        rate_mps2: The rate ``u``.
        before_mps2: Acceleration of the period before.
    """

    run: Run
    section: Section
    rules: ExpertRules
    model: Model
    ceiling: Ceiling
    ground: ExpertTrack
    legs: Legs
    actuation: CommandActuation
    estimate: StateEstimate
    hoa: Hoa
    supervision: Memory
    rate_mps2: float = 0.0
    before_mps2: float = 0.0


def prepare_expert(run: Run, section: Section, rules: ExpertRules, hoa: Hoa) -> ExpertMemory:
    """Prepare all that does not change on the way over a section.

    Args:
        run: The run.
        section: The section with every restriction announced so far.
        rules: The expert's constants.
        hoa: Knowledge of the brake.
    """
    model = model_of(run, section)
    bounds = declared_bounds(run)
    late = bounds.delay_s + bounds.lag_s > 0.0
    ceiling = ceiling_of(
        run, section, max(LATE_MARGIN_MPS, LATE_MARGIN_MPS2 * run.dt) if late else MARGIN_MPS
    )
    ground = expert_track(model, ceiling, rules)
    return ExpertMemory(
        run=run,
        section=section,
        rules=rules,
        model=model,
        ceiling=ceiling,
        ground=ground,
        legs=legs_of(model, ground, rules),
        actuation=actuation_of(model),
        estimate=initial_estimate(model),
        hoa=hoa,
        supervision=at_start(ceiling.guard),
    )


def decide(
    memory: ExpertMemory,
    observation: Observation,
    change: Change,
    known: Any,  # noqa: ANN401 (each chooser has its own)
) -> tuple[float, ExpertMemory, Any]:
    """Decide on the command of one period.

    Args:
        memory: From :func:`prepare_expert`, or the decision before.
        observation: Measurements of this period.
        change: Chooses the change of the rate.
        known: What it remembers where it is not asked.

    Returns:
        The command, the memory, and what the chooser remembers.
    """
    if observation.section is not memory.section:
        fresh = prepare_expert(memory.run, observation.section, memory.rules, memory.hoa)
        memory = fresh._replace(
            actuation=memory.actuation,
            estimate=memory.estimate,
            supervision=memory.supervision,
            rate_mps2=memory.rate_mps2,
        )
    state = (observation.position_m, observation.speed_mps, observation.acceleration_mps2)
    intervention = observation.intervention
    estimate = update_estimate(memory.model, memory.estimate, *state, intervention=intervention)
    # noise of the measured speed would show in every command
    state = (estimate.position_m, estimate.speed_mps, observation.acceleration_mps2)
    ground, actuation = memory.ground, memory.actuation
    if estimate.best != 0:
        # The answers contradict what is declared, which is the first hypothesis.
        actuation = estimated_actuation(estimate, actuation.dt)
    known_brake = (
        memory.hoa if intervention else update_gain(memory.hoa, ground, actuation, state, memory.before_mps2)
    )
    hoa = known_brake
    if not ground.weighed_brakes:
        hoa = expect_mass(hoa, estimate.traction_gain, float(estimate.gain_sigmas[0]))
    now = ground.now(actuation, state, hoa.gain)
    ahead = ground.ahead(actuation, now)
    downhill = ground.downhill(ahead.position_m)
    brake, net = ground.mean_brake(ahead.speed_mps, min(hoa.gain, 1.0), downhill)
    plan = hoa.plan_mps2(brake, net, ground.stop_mps2)
    curve = curve_for(memory.model.vehicle, actuation.dt, plan, HOA_STOP)
    share, braking = stop_share(hoa, ground, actuation, ahead, curve)
    rate = 0.0
    if not braking:
        seen = _rate_inputs(memory, observation, ahead, curve)
        wanted, known = change(seen)
        rate = _creep(memory, ahead, _rate(memory, seen, wanted))
        effort = _keep_safe(memory, observation, ahead, rate)
        share = ahead.command_for(effort)
    short = ground.length_m - observation.position_m > HOA_STOP.inch_m
    share = start_command(share, observation.speed_mps, ahead.resistance_mps2 + ahead.gradient_mps2, short)
    supervision = memory.supervision
    # What is on its way, or built up, cannot be taken back: protection is asked before it has to intervene.
    guard = memory.ceiling.guard
    look = ground.look_along(actuation, now, periods_in_effect(guard, supervision))
    share, supervision = largest_admissible_command(
        guard, supervision, observation.position_m, observation.speed_mps, share, look
    )
    memory = memory._replace(
        supervision=supervision,
        actuation=memory.actuation.issue(share),
        estimate=record_command(estimate, share),
        hoa=hoa._replace(gain=scalars.where(braking, hoa.gain, known_brake.gain), braking=braking),
        rate_mps2=rate,
        before_mps2=observation.acceleration_mps2,
    )
    return share, memory, known


def _rate_inputs(
    memory: ExpertMemory, observation: Observation, ahead: PredictedState, curve: StopCurve
) -> RateInputs:
    """Speed window where a command given now begins to act, and the rates around it."""
    rules, ground, legs = memory.rules, memory.ground, memory.legs
    x, v, a = ahead.position_m, ahead.speed_mps, max(ahead.acceleration_mps2, 0.0)
    leg = legs.leg(x) if rules.intervals else legs.legs[-1]
    share = legs.share(leg, x, v)
    time_left = observation.scheduled_time_s - observation.time_s - ahead.seconds - _release_s(leg, curve)
    coasts_at = v + a * (lead_s(memory.model) - ahead.seconds + build_up_s(ground, a))
    stretch = ground.stretch(x, leg.end_m, leg.end_mps)
    coasting = coasting_time(scalars, ground.davis, curve.deceleration_mps2, coasts_at, stretch)
    window = expert_window(scalars, rules, stretch.left_m, coasting, time_left, share)
    top = min(rules.start_mps2 + ahead.resistance_mps2, ahead.traction_mps2)
    if len(legs.legs) > 1 and time_left > TIGHT * legs.least_s(ground.length_m - x, v):
        top = min(top, _for_lower_limits(memory, ahead, coasts_at))
    return RateInputs(
        window, v, stretch.left_m, time_left * share, memory.rate_mps2, top, ahead.traction_mps2
    )


def _for_lower_limits(memory: ExpertMemory, ahead: PredictedState, speed_mps: float) -> float:
    """Largest rate that still coasts to the lower limits ahead slowly enough (rule 4).

    What is braked away there must be given back behind it: power beyond this speed is lost.
    """
    ground, x, drag = memory.ground, ahead.position_m, ahead.resistance_mps2
    a, b, c = ground.davis
    davis, most = a + speed_mps * (b + speed_mps * c), ground.most_mps2
    for leg in memory.legs.legs[:-1]:
        lost = ground.climb(leg.end_m) - ground.climb(x) + davis * (leg.end_m - x)
        most = min(most, drag + HOLD_PER_S * (_coasts_from(leg, x, lost) - speed_mps))
    return max(most, 0.0)


def _coasts_from(leg: Leg, position_m: float, lost: float) -> float:
    """Speed from which coasting loses so much, J/kg, on the way to a lower limit ahead; infinite: any."""
    square = leg.end_mps * leg.end_mps + 2.0 * lost
    return math.sqrt(square) if leg.end_m > position_m and square > 0.0 else math.inf


def _release_s(leg: Leg, curve: StopCurve) -> float:
    """Time that letting go of the last brake takes more than stopping at once."""
    if leg.end_mps > 0.0 or curve.release_jerk_mps3 > 1e3:
        return 0.0
    return RELEASE_SHARE * curve.deceleration_mps2 / curve.release_jerk_mps3


def _rate(memory: ExpertMemory, seen: RateInputs, change: float) -> float:
    """The rate after the period's share of a change."""
    rules, part = memory.rules, memory.actuation.dt / memory.rules.interval_s
    return next_expert_rate(
        scalars,
        rules.change_mps2 * part,
        seen.window,
        seen.rate_mps2,
        change * part,
        seen.top_mps2,
    )


def _creep(memory: ExpertMemory, ahead: PredictedState, rate_mps2: float) -> float:
    """The rate of a trainset that creeps to the stop, on a climb before it: an even crawl.

    To the window it is far too late when slower than ``CREEP_MPS`` and early when faster, so that full power
    and the brake would take turns up to the mark.
    """
    v, left_m = ahead.speed_mps, memory.ground.length_m - ahead.position_m
    if v >= CRAWL_MPS or left_m > CRAWLS_M:
        return rate_mps2
    most = ahead.resistance_mps2 + HOLD_PER_S * (CRAWL_MPS - v)
    return min(max(rate_mps2, 0.0), max(most, 0.0))


def _keep_safe(
    memory: ExpertMemory, observation: Observation, ahead: PredictedState, rate_mps2: float
) -> float:
    """The wheel effort under the safe speed (Huang25 eqs. 17 and 18).

    Traction is eased off on the way to the safe speed, so that protection, which judges a command by what it
    would do at once, has no reason to step in (rule 4). From the safe speed on the paper brakes at full rate;
    here the brake follows the safe speed's own fall, so that nothing switches to and fro.
    """
    ground, ceiling, drag = memory.ground, memory.ceiling, ahead.resistance_mps2
    x, v, now = ahead.position_m, ahead.speed_mps, observation.speed_mps
    there = ground.lowest(x, ceiling.look_s * v)
    here = ground.lowest(observation.position_m, ceiling.look_s * now)
    if min(there - v, here - now) > CLEAR_MPS:
        return rate_mps2
    slow = _follow_fall(ground, ahead, memory.actuation.dt)
    if slow < 0.0:
        return min(rate_mps2, max(slow, -ground.most_mps2) + drag, 0.0)
    allowed = min(ceiling.acceleration_under(here - now), ceiling.acceleration_under(there - v))
    allowed = min(allowed, HOLD_PER_S * max(there - v, 0.0))
    return min(rate_mps2, max(allowed + drag, 0.0) if v <= there else 0.0)


def _follow_fall(ground: ExpertTrack, ahead: PredictedState, dt: float) -> float:
    """Acceleration that follows the fall of the safe speed and comes back under it, m/s^2; 0: not needed.

    The brake is built up on the way to where the fall begins, and eased off little by little below it: on and
    off by turns, a late brake would never do what was wanted.
    """
    v, a = ahead.speed_mps, ahead.acceleration_mps2
    early_s = dt + build_up_s(ground, max(ground.most_mps2 + a, 0.0))
    x = ahead.position_m + max(v * early_s, 0.5)
    here, there = ground.safe(x), ground.safe(x + STEP_M)
    above = v + min(a, 0.0) * early_s - here
    if above <= 0.0 and there >= here:
        return 0.0
    fall = 0.5 * min(there * there - here * here, 0.0) / STEP_M
    return min(fall - (BACK_PER_S if above > 0.0 else EASE_PER_S) * above, 0.0)


@dataclass(frozen=True)
class EitoeOptions(CheckedFields):
    """Prior knowledge of the expert about the brake.

    Attributes:
        start_mps2: Largest acceleration (rule 2).
        brake_gain: Actual over believed braking force, as learned at earlier stops.
        brake_known: True if it was learned: a driver that never stopped this trainset plans its stop with
            care.
        intervals: Keep to a time for each speed-limit interval, as Algorithm 1 prints it.
    """

    start_mps2: float = declare(0.6, unit="m/s^2", low=0.0, high=2.0, above=True)
    brake_gain: float = declare(1.0, low=GAIN[0], high=GAIN[1])
    brake_known: bool = declare(True)
    intervals: bool = declare(False)

    @property
    def hoa(self) -> Hoa:
        """Knowledge of the brake before the first stop."""
        return Hoa(self.brake_gain, SETTLED if self.brake_known else UNSURE)


@final
class Eitoe(AbstractDriver):
    """Drives by an expert's rules: accelerate, coast as long as the time left allows, brake to the stop.

    Args:
        options: Acceleration, and what is known about the brake.
    """

    id = "eitoe"

    def __init__(self, options: EitoeOptions | None = None) -> None:
        self.options = options or EitoeOptions()

    def aboard(self, number: type) -> Eitoe:
        """The same driver: it takes news of the timetable as it goes."""
        del number
        return self

    def init(self, run: Run) -> ExpertMemory:
        """Tables of the section, once."""
        rules = ExpertRules(start_mps2=self.options.start_mps2, intervals=self.options.intervals)
        return prepare_expert(run, run.section, rules, self.options.hoa)

    def act(self, memory: ExpertMemory, observation: Observation) -> tuple[float, ExpertMemory]:
        """One decision by the rules; the change of the rate is the constant of eqs. 15 and 16."""
        rules = memory.rules

        def change(seen: RateInputs) -> tuple[Scalar, None]:
            return constant_rate_change(scalars, rules, seen.window, seen.rate_mps2), None

        share, memory, _ = decide(memory, observation, change, None)
        return share, memory


class PolicyMemory(NamedTuple):
    """Memory of such a driver between two periods.

    Attributes:
        expert: The expert's.
        decided: Decisions of the policy so far.
        change: The last of them, over the largest change.
    """

    expert: ExpertMemory
    decided: int = 0
    change: float = 0.0


class AbstractExpertPolicyDriver(AbstractNetworkDriver):
    """A driver whose policy changes the rate inside the expert's rules.

    Args:
        options: Another policy than the one shipped.
    """

    def __init__(self, options: PolicyOptions | None = None) -> None:
        self.options = options or PolicyOptions()

    @property
    def path(self) -> Path:
        """The file given, or the one shipped."""
        return Path(self.options.policy) if self.options.policy else shipped_policy(self.id)

    @cached_property
    def loaded_policy(self) -> LoadedPolicy:
        """The policy and what is known about it.

        Raises:
            InputError: The file cannot be used, or its policy did not learn inside the expert.
        """
        loaded = load_driving_policy(self.path)
        action, seen = loaded.interface.action, loaded.interface.features
        if not isinstance(action, ExpertAction | ExpertChoiceAction) or seen != ("expert",):
            raise InputError("did not learn inside the expert", file=self.path, field="perception.action")
        return loaded

    def read_policy(self) -> object:
        """Read the policy that changes the rate."""
        return self.loaded_policy

    def aboard(self, number: type) -> AbstractExpertPolicyDriver | None:
        """The same driver, its network in a number type."""
        found, policy = copy(self), self.loaded_policy.policy.policy
        found.network = Policy(policy.spec, in_precision(policy.params, number))
        return found

    def network_view(self, run: Run) -> NetworkView:
        """The network, and the state of the expert that it sees."""
        del run
        spans = (FeatureSpan(name, FEATURE_WORDS[name], size) for name, size in EXPERT_STATE.items())
        policy = self.loaded_policy.policy.policy
        return NetworkView(policy, tuple(spans), "more power", 0)

    def with_policy(self, policy: Callable[[np.ndarray], Any]) -> AbstractExpertPolicyDriver:
        """The same driver with another function in the place of its policy."""
        found = copy(self)
        found.network = policy
        return found

    @cached_property
    def network(self) -> Callable[[np.ndarray], Any]:
        """From an observation to an action."""
        return self.loaded_policy.policy

    @cached_property
    def _action(self) -> ExpertAction | ExpertChoiceAction:
        return cast("ExpertAction | ExpertChoiceAction", self.loaded_policy.interface.action)

    def init(self, run: Run) -> PolicyMemory:
        """Read the policy, and build the tables of the section."""
        return PolicyMemory(prepare_expert(run, run.section, self._action.rules, Hoa(sigma=SETTLED)))

    def act(self, memory: PolicyMemory, observation: Observation) -> tuple[float, PolicyMemory]:
        """One decision of the expert; the policy is asked once in its own period."""
        period = self.loaded_policy.interface.period_s

        def change(seen: RateInputs) -> tuple[Scalar, tuple[Index, Scalar]]:
            decided, chosen = memory.decided, memory.change
            if observation.time_s >= decided * period - DECISION_EARLY_S:
                chosen = self._evaluate(seen)
                decided = int((observation.time_s + DECISION_EARLY_S) / period) + 1
            return chosen * self._action.change_mps2, (decided, chosen)

        share, expert, known = decide(memory.expert, observation, change, (memory.decided, memory.change))
        return share, PolicyMemory(expert, *known)

    def _evaluate(self, seen: RateInputs) -> float:
        """Evaluate the policy: a change of the rate, as a share of the largest."""
        observed = expert_state(
            scalars,
            seen.window,
            seen.speed_mps,
            seen.left_m,
            seen.time_left_s,
            seen.rate_mps2,
            seen.traction_mps2,
        )
        if isinstance(observed[0], float):
            answer = self.network(np.array(observed, np.float32))
        else:  # a symbol, from which the form in C is made
            answer = self.network(np.stack(observed).astype(np.float32))
        return min(max(float(self._action.change(answer)), -1.0), 1.0)


@final
class Eitop(AbstractExpertPolicyDriver):
    """EITOE whose change of the rate was learned by PPO."""

    id: ClassVar[str] = "eitop"


@final
class Itor(AbstractExpertPolicyDriver):
    """Expert rules with one of three changes of the rate, learned by Q-learning in a table."""

    id: ClassVar[str] = "itor"

    def aboard(self, number: type) -> None:
        """None: the table is looked up in NumPy alone."""
        del number


@final
class Stod(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by DDPG."""

    id: ClassVar[str] = "stod"


@final
class Ston(AbstractExpertPolicyDriver):
    """Expert rules with a continuous change of the rate, learned by NAF."""

    id: ClassVar[str] = "ston"
