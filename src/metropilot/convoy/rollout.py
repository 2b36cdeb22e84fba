"""Host loop of a convoy: a head, driven or recorded, and followers behind it, in NumPy float64."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter_ns
from typing import Any, cast, final

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy.drivers import AbstractFollower
from metropilot.convoy.drivers.own_place import AbstractPlaceFollower
from metropilot.convoy.manoeuvre import check_manoeuvres, plan_followers
from metropilot.convoy.model import Convoy, Link, Member, convoy_members
from metropilot.convoy.own_plant import learn, learned_vehicle, own_plant
from metropilot.convoy.place import manoeuvres, place_behind
from metropilot.convoy.plan import STANDING_MPS, MotionPlan, PlannedMotion, plan_at, plan_times, splice
from metropilot.convoy.step import (
    UNLIMITED_MPS,
    FollowerObservation,
    MemberState,
    Plans,
    at_departure,
    drive_period,
    make_message,
    observe_member,
    receive_message,
    update_needed_gap,
)
from metropilot.errors import Infeasible
from metropilot.physics import Command, Vehicle
from metropilot.protection import permitted_speed
from metropilot.railway import Restriction
from metropilot.sim import (
    CODES,
    RUNNING,
    AbstractDriver,
    Observation,
    Outcome,
    OutcomeRule,
    Recorder,
    Run,
    Trajectory,
    noise_stream,
    outcome_of,
    read_command,
)

STAND_S = 3.0
LONGEST_S = 240.0
RULE = OutcomeRule()
OFF_MPS, OFF_M = 0.1, 0.5
"""Departure of the head from its plan, in speed or position, that calls for a new one."""
LOOK_S = 1.0
"""Time ahead, beside what is late, in which traction respects a lower permitted speed, as of one alone."""
PATIENCE_S = 2.0
"""Least time between two plans that a departure calls for."""
LEFT_MPS, LEFT_M = 1.0, 5.0
"""Departure of a follower from its plan that ends a manoeuvre, as an emergency brake does."""
OUTDATED = 0.03
"""Change of the learned gain of the traction that calls for a new plan of a follower."""
LATE_S, LEAD_S = 0.5, 2.7
"""Planned lateness of the last trainset from which on the head arrives earlier, and by how much at most."""
SHORT_M = 0.5
"""Distance from the end of its plan from which on a trainset that stands is to go on."""
LAST_M = 30.0
"""No new plan this close to the stop."""


@dataclass(frozen=True, eq=False)
class ConvoyDrive:
    """Record of the run of a convoy.

    Attributes:
        convoy: The convoy, its section with every restriction announced during the run.
        head: Id of the head's driver.
        follower: Id of the followers' driver.
        trajectories: Trajectory of each trainset, the head first.
        gap_m: True gaps, rear of one to front of the next, after each period. Shape (T, N - 1).
        planned_gap_m: Gap that each follower planned; without a plan the desired one. Shape (T, N - 1).
        speed_difference_mps: Speed ahead less own speed. Shape (T, N - 1).
        time_s: Time of the rows of both. Shape (T,).
        outcome: Outcome of the run of the head.
        interventions: Number of interventions of each protection. Shape (N,).
        emergencies: Number of those that used the emergency brake. Shape (N,).
        overspeed_mps: Largest excess over the limit of each. Shape (N,).
        decision_us: Median time of a decision of each follower, microseconds. Shape (N,), 0 for the head.
        recovered_j: Energy returned to the line by each. Shape (N,).
        heard_s: Time at which the newest message that each has received was sent; 0 for the head. Shape (N,).
    """

    convoy: Convoy
    head: str
    follower: str
    trajectories: tuple[Trajectory, ...]
    gap_m: Float[ndarray, "rows followers"]
    planned_gap_m: Float[ndarray, "rows followers"]
    speed_difference_mps: Float[ndarray, "rows followers"]
    time_s: Float[ndarray, " rows"]
    outcome: Outcome
    interventions: tuple[int, ...]
    emergencies: tuple[int, ...]
    overspeed_mps: tuple[float, ...]
    decision_us: tuple[float, ...]
    recovered_j: tuple[float, ...]
    heard_s: tuple[float, ...]

    @property
    def contacts(self) -> int:
        """Pairs of trainsets that touched."""
        return int((self.gap_m < 0.0).any(axis=0).sum())


@dataclass(frozen=True)
class HeadRun:
    """Recorded commands of the head.

    Attributes:
        driver: Id of its driver.
        commands: Command of each period; afterwards it holds its brakes. Shape (T,).
        emergency_s: Time at which it makes an emergency brake (infinite: never).
        outcome: Outcome of its run without emergency brake.
        plan: Motion that it tells the follower behind it beforehand; None: none.
    """

    driver: str
    commands: Float[ndarray, " rows"]
    outcome: Outcome
    emergency_s: float = float("inf")
    plan: MotionPlan | None = None


@dataclass(frozen=True)
class DrivenHead:
    """Head that its driver drives within the convoy; it tells its planned motion.

    Attributes:
        run: Its run, with the limits that hold until the last trainset has cleared them. As in the convoy the
            movement authority has no end, whatever that of its section has.
        driver: Its driver.
        emergency_s: Time at which it makes an emergency brake (infinite: never).
        traction_share: Traction of the trainset of its run over that of its plant.
    """

    run: Run
    driver: AbstractDriver
    emergency_s: float = float("inf")
    traction_share: float = 1.0


def drive_convoy(
    convoy: Convoy, head: HeadRun | DrivenHead, follower: AbstractFollower, seed: int = 0
) -> ConvoyDrive:
    """Run a convoy until all stand.

    Args:
        convoy: The convoy.
        head: Its head.
        follower: Driver of the others, each with a memory of its own.
        seed: Seed of delays and losses of the links.
    """
    rollout = ConvoyRollout(convoy, head, follower, seed)
    while not rollout.over:
        rollout.advance()
    return rollout.result()


@final
class HeadDriver:
    """The driver of a head at work: command, end of the run, and the motion that it plans.

    The plan is a simulation of the same driver, from now to the stop, on the plant as the head knows it.

    Args:
        head: Run and driver.
        lead_s: Time by which the head arrives before the schedule, for those behind that arrive after it.

    Raises:
        Infeasible: No time for that.
    """

    def __init__(self, head: DrivenHead, lead_s: float = 0.0) -> None:
        self.driver, self.traction_share, self.lead_s = head.driver, head.traction_share, lead_s
        section = replace(head.run.section, authority=None)
        run = replace(head.run, section=section, scheduled_time_s=head.run.scheduled_time_s - lead_s)
        self.section, self.scheduled_s, self.restricted_s = run.section, run.scheduled_time_s, 0.0
        self.length_m = run.trainset.length_m
        self.pending = sorted(head.run.disturbance.updates, key=lambda update: update.at_s)
        self.memory: Any = head.driver.init(run)
        self.stood_since_s, self.outcome = 0.0, RUNNING

    def apply_updates(self, now_s: float) -> bool:
        """Tell the driver the timetable updates that are due; True if there were any."""
        due = [update for update in self.pending if update.at_s <= now_s]
        self.pending = self.pending[len(due) :]
        for update in due:
            if update.scheduled_time_s is not None:
                self.scheduled_s = update.scheduled_time_s - self.lead_s
            if update.restriction is not None:
                self.section = self.section.with_restriction(update.restriction)
                self.restricted_s += update.restriction.passing_time_s(self.length_m)
        return bool(due)

    def act(self, memory: Any, state: MemberState, now_s: float, permitted_mps: float) -> tuple[float, Any]:  # noqa: ANN401 (a driver's)
        """Command of the driver, and its next memory."""
        plant, watched = state.plant, state.watched
        observation = Observation(
            time_s=now_s,
            position_m=float(plant.position_m),
            speed_mps=float(state.measured_mps),
            acceleration_mps2=float(plant.acceleration_mps2),
            scheduled_time_s=self.scheduled_s,
            permitted_mps=permitted_mps,
            section=self.section,
            intervention=0 if watched is None else int(watched.level),
        )
        given, memory = self.driver.act(memory, observation)
        share = read_command(self.driver, given)
        return share * (self.traction_share if share > 0.0 else 1.0), memory

    def note(self, before: MemberState, after: MemberState, time_s: float) -> None:
        """Record the end of a period: whether the run is over, and how."""
        stopped = before.plant.speed_mps > 0.0 and after.plant.speed_mps <= 0.0
        self.stood_since_s = time_s if stopped else self.stood_since_s
        if self.outcome == RUNNING:
            self.outcome = self._outcome(after, time_s, self.stood_since_s)

    def plan(
        self, member: Member, vehicle: Vehicle, state: MemberState, now_s: float, dt: float
    ) -> MotionPlan:
        """Simulate the run from now on, on the plant as it is known by now."""
        known = member._replace(vehicle=vehicle, speed_noise_mps=0.0 * member.speed_noise_mps)
        memory, time_s, since_s = self.memory, now_s, self.stood_since_s
        rows = [(float(state.plant.position_m), float(state.plant.speed_mps))]
        while self._outcome(state, time_s, since_s) == RUNNING:
            permitted = _permitted_speed(known, state)
            share, memory = self.act(memory, state, time_s, permitted)
            command = Command(np.float64(share), False)
            moving = state.plant.speed_mps > 0.0
            state, _ = drive_period(known, state, command, np.float64(time_s), np.float64(dt))
            time_s += dt
            since_s = time_s if moving and state.plant.speed_mps <= 0.0 else since_s
            rows.append((float(state.plant.position_m), float(state.plant.speed_mps)))
        return MotionPlan(np.float64(now_s), np.float64(dt), *np.array([*rows, rows[-1]]).T)

    def _outcome(self, state: MemberState, time_s: float, since_s: float) -> int:
        plant = state.plant
        code = outcome_of(
            RULE,
            error_m=float(plant.position_m) - self.section.length_m,
            speed_mps=float(plant.speed_mps),
            time_s=time_s,
            stood_since_s=since_s,
            scheduled_s=self.scheduled_s,
            overspeed_mps=0.0,
            restricted_s=self.restricted_s,
        )
        return int(code)


def brakes_fully(state: MemberState) -> bool:
    """Tell if the emergency brake of a trainset acts."""
    return state.watched is not None and bool(state.watched.emergency)


def _permitted_speed(member: Member, state: MemberState) -> float:
    """Speed that protection permits a trainset."""
    if member.protection is None:
        return UNLIMITED_MPS
    return float(permitted_speed(member.protection, float(state.plant.position_m)))


@final
class ConvoyRollout:
    """Stepwise run of a convoy, one control period at a time, as :func:`drive_convoy` uses it.

    Args:
        convoy: The convoy.
        head: Its head.
        follower: Driver of the others, each with a memory of its own.
        seed: Seed of delays and losses of the links.

    Raises:
        Infeasible: A driven head leaves no room to couple or uncouple as declared.

    Attributes:
        states: State of every trainset, the head first.
        over: True at the end of the run: all have stood for ``STAND_S``.
    """

    def __init__(
        self, convoy: Convoy, head: HeadRun | DrivenHead, follower: AbstractFollower, seed: int
    ) -> None:
        self.convoy, self.head, self.follower, self.dt = convoy, head, follower, convoy.dt
        self.driving = HeadDriver(head) if isinstance(head, DrivenHead) else None
        self.members = convoy_members(convoy)
        pairs = zip(self.members, (None, *self.members[:-1]), strict=True)
        self.states = [at_departure(own, ahead, self.dt) for own, ahead in pairs]
        self.memories: list[Any] = [follower.init(m.believed, self.dt) for m in self.members]
        self.recorders = [
            Recorder(m.vehicle, self.dt, s.plant) for m, s in zip(self.members, self.states, strict=True)
        ]
        self.errors = [noise_stream(seed, k) for k in range(len(self.members))]
        self.pending = sorted(
            (each for each in convoy.disturbance(0).updates if each.restriction is not None),
            key=lambda update: update.at_s,
        )
        self.random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
        self.decision_us: list[list[float]] = [[] for _ in self.members]
        self.rows: list[tuple[float, list[float], list[float]]] = []
        self.planned_gaps: list[list[float]] = []
        self.period, self.stood_s, self.over = 0, 0.0, False
        self.plants = [own_plant(m.believed, self.dt) for m in self.members]
        self.planned_gains = [1.0] * len(self.members)
        # An emergency brake ends the plan of whoever follows: a new one is due when it lets go.
        self.braked = [False] * len(self.members)
        self.plans: list[list[tuple[float, MotionPlan]]] = [[] for _ in self.members]
        self.known: list[Plans | None] = [None for _ in self.members]
        self.send_plan(0.0)
        if self.driving is not None:
            check_manoeuvres(self.convoy, self.members, self.plans[0][0][1])
            self.arrive_earlier()

    @property
    def time_s(self) -> float:
        """Time since departure."""
        return self.period * self.dt

    def advance(self) -> tuple[float, list[float], list[float]]:
        """Run one control period; returns time, gaps and speed differences after it."""
        now = np.float64(self.time_s)
        self.apply_updates()
        self.listen(now)
        self.move(now, self.period)
        self.note(float(now) + self.dt)
        still = all(s.plant.speed_mps <= 0 for s in self.states)
        ended = now >= min(self.ends_s, self.head.emergency_s + self.dt)
        stays = still and ended and not self.plans_to_depart(now)
        self.stood_s = self.stood_s + self.dt if stays else 0.0
        self.period += 1
        self.over = self.stood_s >= STAND_S or self.time_s >= self.longest_s
        return self.rows[-1]

    @property
    def ends_s(self) -> float:
        """Time at which the run of the head ends; infinite while it is not known."""
        if isinstance(self.head, HeadRun):
            return self.head.commands.size * self.dt
        return float("inf") if self.driving is None or self.driving.outcome == RUNNING else 0.0

    def plans_to_depart(self, now_s: float) -> bool:
        """Tell if a trainset that stands is to move on, as after an emergency brake of its own."""
        if np.isfinite(self.head.emergency_s):
            return False
        planned = [(state, known.own) for state, known in zip(self.states, self.known, strict=True) if known]
        return any(
            plan.position_m[-1] - state.plant.position_m > SHORT_M
            and np.any(plan.speed_mps[plan_times(plan) > now_s] > STANDING_MPS)
            for state, plan in planned
        )

    @property
    def longest_s(self) -> float:
        """Time at which the run is given up."""
        if isinstance(self.head, HeadRun):
            return self.head.commands.size * self.dt + LONGEST_S
        if self.driving is None:
            scheduled_s, restricted_s = self.head.run.scheduled_time_s, 0.0
        else:
            scheduled_s, restricted_s = self.driving.scheduled_s, self.driving.restricted_s
        return RULE.late_ratio * scheduled_s + RULE.late_s + restricted_s + LONGEST_S

    def send_plan(self, now_s: float) -> None:
        """Send the planned motion of the head on its way along the convoy."""
        plan = self.head.plan if isinstance(self.head, HeadRun) else None
        if self.driving is not None:
            plan = self.driving.plan(self.members[0], self.known_vehicle(0), self.states[0], now_s, self.dt)
        if plan is not None:
            self.plans[0].append((now_s, plan))
            self.braked[0] = False

    def arrive_earlier(self) -> None:
        """Let the head arrive earlier where the last of its followers is planned to arrive late."""
        # Who couples or uncouples has been checked for room, and a follower without a plan keeps its gap.
        planned = isinstance(self.follower, AbstractPlaceFollower)
        if not planned or any(map(manoeuvres, self.members[1:])):
            return
        head, scheduled_s = cast("DrivenHead", self.head), cast("HeadDriver", self.driving).scheduled_s
        last = plan_followers(self.members, self.plans[0][0][1], self.convoy.first_gap_m)[-1]
        arrives_s = float(plan_times(last)[np.flatnonzero(last.speed_mps > STANDING_MPS).max(initial=0)])
        lead_s = min(arrives_s - scheduled_s - LATE_S, LEAD_S)
        if lead_s <= 0.0:
            return
        try:
            self.driving = HeadDriver(head, lead_s)
        except Infeasible:
            return
        self.plans[0].clear()
        self.send_plan(0.0)

    def departs(self, now_s: float) -> bool:
        """Tell if the head has left the plan that it sent, and a new one is worth its while."""
        if self.driving is None or self.driving.outcome != RUNNING or not self.plans[0]:
            return False
        sent_s, plan = self.plans[0][-1]
        plant = self.states[0].plant
        left_m = self.convoy.section.length_m - float(plant.position_m)
        if now_s >= self.head.emergency_s:
            return False
        if self.lets_go(0):
            return True
        if now_s - sent_s < PATIENCE_S or left_m < LAST_M:
            return False
        planned = plan_at(plan, now_s)
        off_mps = abs(float(plant.speed_mps - planned.speed_mps))
        return off_mps > OFF_MPS or abs(float(plant.position_m - planned.position_m)) > OFF_M

    def apply_updates(self) -> None:
        """Put the temporary speed restrictions that are due into force, for plants and protections.

        New arrival times act on the driver of the head alone.
        """
        told = self.driving is not None and self.driving.apply_updates(self.time_s)
        while self.pending and self.pending[0].at_s <= self.time_s:
            restriction = cast("Restriction", self.pending.pop(0).restriction)
            self.convoy = replace(self.convoy, section=self.convoy.section.with_restriction(restriction))
            links = [member.link for member in self.members]
            members = convoy_members(self.convoy)
            self.members = tuple(m._replace(link=link) for m, link in zip(members, links, strict=True))
        if told or self.departs(self.time_s):
            self.send_plan(self.time_s)

    def relink(self, link: Link) -> None:
        """Change the quality of all links from now on; messages in flight are kept."""
        self.members = tuple(m._replace(link=link.numbers()) for m in self.members)

    def brake_head(self) -> None:
        """Demand the emergency brake of the head from now on."""
        self.head = replace(self.head, emergency_s=min(self.head.emergency_s, self.time_s))

    def listen(self, now: np.float64) -> None:
        """Exchange messages along the convoy."""
        before = list(self.states)
        for k in range(1, len(self.members)):
            message = make_message(self.members[k - 1], before[k - 1], now)
            state = receive_message(self.members[k], before[k], message, self.random.random(2))
            self.states[k] = update_needed_gap(self.members[k], state, now, np.float64(self.dt))
            self.learn_plan(k, float(now))

    def learn_plan(self, k: int, now_s: float) -> None:
        """Take over a new plan of the trainset ahead, if a message that carries it has arrived."""
        stamp_s = float(self.states[k].channel.heard.stamp_s)
        heard = [number for number, (sent_s, _) in enumerate(self.plans[k - 1], 1) if sent_s <= stamp_s]
        known, member = self.known[k], self.members[k]
        if not heard:
            return
        if known is not None and known.number_ahead >= heard[-1] and not self.is_outdated(k, now_s):
            return
        plan = self.plans[k - 1][heard[-1] - 1][1]
        self.planned_gains[k] = float(self.plants[k].gains[0])
        length_m = float(self.members[k - 1].length_m)

        def planned_gap(times_s: ndarray) -> ndarray:
            if known is None:
                return np.full(times_s.size, self.convoy.first_gap_m)
            return np.array(
                [plan_at(known.ahead, t).position_m - plan_at(known.own, t).position_m for t in times_s]
            )

        if known is not None:
            plan = splice(known.ahead, plan)
        # Who couples or uncouples on the move plans its gap on from what it was planned to be.
        goes_on = known is None or (manoeuvres(member) and not self.has_left_plan(k, now_s))
        now = None if goes_on else self.motion_of(k)
        own = place_behind(
            plan, member._replace(believed=self.known_vehicle(k)), length_m, now_s, planned_gap, now
        )
        rear = plan._replace(position_m=plan.position_m - length_m)
        self.plans[k].append((now_s, own))
        self.braked[k] = False
        self.known[k] = Plans(rear, own, np.float64(len(self.plans[k])), np.float64(heard[-1]))

    def motion_of(self, k: int) -> PlannedMotion:
        """Motion of a trainset now, its speed filtered."""
        plant = self.states[k].plant
        rate = float(plant.acceleration_mps2)
        speed = max(float(self.plants[k].motion.speed_mps) + rate * self.dt, 0.0)
        return PlannedMotion(float(plant.position_m), speed, rate)

    def known_vehicle(self, k: int) -> Vehicle:
        """Plant of a trainset as it is known by now."""
        return learned_vehicle(self.plants[k], self.members[k].believed)

    def is_outdated(self, k: int, now_s: float) -> bool:
        """Tell if the plan of a trainset is of another plant than learned since, or an emergency ended it."""
        if now_s - self.plans[k][-1][0] < PATIENCE_S:
            return False
        return self.lets_go(k) or bool(abs(self.plants[k].gains[0] - self.planned_gains[k]) > OUTDATED)

    def has_left_plan(self, k: int, now_s: float) -> bool:
        """Tell if a follower is not where, or not as fast as, its plan has it now."""
        plant, planned = self.states[k].plant, plan_at(cast("Plans", self.known[k]).own, now_s)
        off_mps = abs(float(plant.speed_mps - planned.speed_mps))
        return off_mps > LEFT_MPS or abs(float(plant.position_m - planned.position_m)) > LEFT_M

    def lets_go(self, k: int) -> bool:
        """Tell if an emergency brake of a trainset has let go since its last plan."""
        return self.braked[k] and not brakes_fully(self.states[k])

    def move(self, now: np.float64, period: int) -> None:
        """Advance all trainsets by one control period."""
        self.states = [
            self.move_one(k, own, state, now, period)
            for k, (own, state) in enumerate(zip(self.members, self.states, strict=True))
        ]

    def move_one(self, k: int, own: Member, state: MemberState, now: np.float64, period: int) -> MemberState:
        """Advance one trainset by one control period."""
        permitted = _permitted_speed(own, state)
        coming = permitted if k == 0 else min(permitted, self.coming_limit(own, state))
        seen = observe_member(own, state, now, np.float64(self.dt), np.float64(coming), self.known[k])
        self.plants[k] = learn(self.plants[k], seen)
        if k == 0:
            command = Command(self.head_share(state, period, permitted), bool(now >= self.head.emergency_s))
        else:
            command = Command(self.decide(k, seen), False)
        noise = self.errors[k].standard_normal() if own.speed_noise_mps > 0 else 0.0
        after, record = drive_period(own, state, command, now, np.float64(self.dt), np.float64(noise))
        self.braked[k] |= brakes_fully(after)
        self.recorders[k].add(own.track, after.plant, record, permitted)
        if k == 0 and self.driving is not None:
            self.driving.note(state, after, float(now) + self.dt)
        return after

    @staticmethod
    def coming_limit(own: Member, state: MemberState) -> float:
        """Permitted speed where a trainset will be when a brake begins to act (for catching up)."""
        if own.protection is None:
            return UNLIMITED_MPS
        rates, believed = own.protection.rates, own.believed
        late_s = rates.mass_high / rates.mass_low * (rates.reaction_s + believed.delay_s + believed.lag_s)
        at_m = float(state.plant.position_m + (LOOK_S + late_s) * state.plant.speed_mps)
        return float(permitted_speed(own.protection, at_m))

    def head_share(self, state: MemberState, period: int, permitted_mps: float) -> np.float64:
        """Command of the head; it holds its brakes once its run is over."""
        share = -1.0
        if isinstance(self.head, HeadRun):
            share = self.head.commands[period] if period < self.head.commands.size else share
        elif self.driving is not None and self.driving.outcome == RUNNING:
            driving = self.driving
            share, driving.memory = driving.act(driving.memory, state, period * self.dt, permitted_mps)
        return np.float64(share)

    def decide(self, k: int, seen: FollowerObservation) -> np.float64:
        """The command of a follower; records the decision time."""
        began = perf_counter_ns()
        share, self.memories[k] = self.follower.act(self.memories[k], seen)
        self.decision_us[k].append((perf_counter_ns() - began) / 1e3)
        return np.float64(share)

    def note(self, time_s: float) -> None:
        """Record gaps and speed differences after the period."""
        front = [float(s.plant.position_m) for s in self.states]
        speed = [float(s.plant.speed_mps) for s in self.states]
        rear = [x - float(m.length_m) for x, m in zip(front, self.members, strict=True)]
        pairs = range(1, len(front))
        self.rows.append(
            (time_s, [rear[k - 1] - front[k] for k in pairs], [speed[k - 1] - speed[k] for k in pairs])
        )

        self.planned_gaps.append([self.planned_gap(k, time_s) for k in pairs])

    def planned_gap(self, k: int, time_s: float) -> float:
        """Gap that a follower planned for a time; without a plan the desired one."""
        known, own = self.known[k], self.members[k]
        if known is None:
            apart = self.states[k].plant.position_m >= own.uncouple_at_m
            return float(own.apart_m if apart else own.gap_m)
        return float(plan_at(known.ahead, time_s).position_m - plan_at(known.own, time_s).position_m)

    def result(self) -> ConvoyDrive:
        """The record of the run."""
        time_s, gap, apart = zip(*self.rows, strict=True)
        watched = [s.watched for s in self.states]
        head, outcome = self.head, Outcome.OUT_OF_TIME
        if isinstance(head, HeadRun):
            outcome = head.outcome
        elif self.driving is not None and self.driving.outcome != RUNNING:
            outcome = CODES[self.driving.outcome]
        stopped = np.isfinite(head.emergency_s)
        return ConvoyDrive(
            convoy=self.convoy,
            head=head.driver if isinstance(head, HeadRun) else head.driver.id,
            follower=self.follower.id,
            trajectories=tuple(
                recorder.trajectory(own.track, recorder.permitted[-1])
                for recorder, own in zip(self.recorders, self.members, strict=True)
            ),
            gap_m=np.array(gap),
            planned_gap_m=np.array(self.planned_gaps),
            speed_difference_mps=np.array(apart),
            time_s=np.array(time_s),
            outcome=Outcome.STALLED if stopped else outcome,
            interventions=_counts(watched, "interventions"),
            emergencies=_counts(watched, "emergencies"),
            overspeed_mps=tuple(recorder.overspeed_mps for recorder in self.recorders),
            decision_us=tuple(float(np.median(times)) if times else 0.0 for times in self.decision_us),
            recovered_j=tuple(float(s.plant.recovered_j) for s in self.states),
            heard_s=tuple(float(s.channel.heard.stamp_s) for s in self.states),
        )


def _counts(watched: Sequence[Any], name: str) -> tuple[int, ...]:
    return tuple(0 if memory is None else int(getattr(memory, name)) for memory in watched)
