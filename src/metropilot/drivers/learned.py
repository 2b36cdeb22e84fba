"""A learned policy on the host: observer, action and assists of the task it learned, in NumPy, without JAX.

The policy is any function from an observation to an action; :class:`metropilot.policy.Policy` is one. What it
sees and what its action means is a :class:`metropilot.env.PolicyInterface`, and the same functions as in the
task read it. A policy decides once in its decision period; the assists act at the run's own control period.
Under plant mismatch :mod:`metropilot.drivers.mismatch` takes over part of the work.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np

from metropilot._typing import Scalar
from metropilot.control import Adaptation, PredictedState, adapt_trainset, look_ahead
from metropilot.drivers import mismatch
from metropilot.drivers.mismatch import PlantMonitor
from metropilot.env import (
    FEATURES,
    FeatureContext,
    PolicyInterface,
    SectionRows,
    SectionTables,
    apply_assists,
    build_tables,
    ceiling_mps2,
    feature_context,
    observe,
    stop_options,
)
from metropilot.railway import Section, Trainset
from metropilot.sim import AbstractDriver, Observation, Run, declared_bounds

PolicyFunction = Callable[..., Any]
"""From an observation, float32 of shape (O,), to an action: float32 of shape (A,), or an integer choice.

Where the action has a filter, the choices it allows, bool of shape (count,), come second.
"""
SLOWEST_MPS = 1.0
"""Least speed from which the station stop is reckoned with."""
SOON_S = 1.0
"""Time left below which it is the speed of the trainset itself."""
DECISION_EARLY_S = 1e-3
"""Time by which a decision is due early: more than a time in single precision is rounded by."""


def as_double(value: Scalar) -> Scalar:
    """A number as one of NumPy's in double precision: a plain one would take the precision of an action."""
    return value.astype(np.float64) if hasattr(value, "astype") else np.float64(value)


class LearnedMemory(NamedTuple):
    """Memory of the driver between two periods.

    Attributes:
        run: The run.
        section: The section as last announced.
        nominal: Tables of the section and the nominal trainset.
        rows: Tables the policy sees: the nominal ones, or those of the estimated trainset.
        case: The one row of that.
        command: Last command.
        action: Action of the policy's last decision.
        wanted: Command it asked for.
        decided: Decisions taken.
        stopping: True once the station-stop braking has begun.
        monitor: Estimate of the plant; None where no assist would use it.
    """

    run: Run
    section: Section
    nominal: SectionTables
    rows: SectionRows
    case: SectionTables
    command: np.float64
    action: Any
    wanted: np.float64
    decided: int
    stopping: np.bool_
    monitor: PlantMonitor | None


@final
class LearnedDriver(AbstractDriver):
    """Driver that follows a learned policy.

    Args:
        policy: From an observation to an action.
        interface: Features, action and assists of the policy.
    """

    id = "learned"

    def __init__(self, policy: PolicyFunction, interface: PolicyInterface) -> None:
        self.policy = policy
        self.interface = interface
        self.keeps_tables = False

    def aboard(self, number: type) -> LearnedDriver:
        """The same driver, its tables built once: on a controller there is nothing to build others with."""
        del number
        found = copy(self)
        found.keeps_tables = True
        return found

    def init(self, run: Run) -> LearnedMemory:
        """Build the tables the policy sees."""
        nominal = self._tables(run, run.section, run.disturbance.nominal(run.trainset))
        rows, zero = SectionRows(nominal, jax=False), np.float64(0.0)
        space = self.interface.action.space
        monitor = mismatch.start_monitor(run) if self.interface.assists.stop else None
        return LearnedMemory(
            run=run,
            section=run.section,
            nominal=nominal,
            rows=rows,
            case=rows.case(0),
            command=zero,
            action=np.int32(0) if space.discrete else np.zeros(space.size),
            wanted=zero,
            decided=0,
            stopping=np.bool_(False),
            monitor=monitor,
        )

    def estimates_plant(self, run: Run) -> bool:
        """Tell if the driver acts on its estimate of the plant from the departure on."""
        return self.interface.assists.stop and mismatch.declares_departure(run)

    def act(self, memory: LearnedMemory, observation: Observation) -> tuple[float, LearnedMemory]:
        """Decide if it is time to, then apply the assists."""
        if observation.section is not memory.section and not self.keeps_tables:
            memory = self._set_section(memory, observation.section)
        if memory.monitor is not None:
            monitor = mismatch.update_monitor(memory.monitor, memory.run, observation)
            memory = memory._replace(monitor=monitor)
            outdated = not self.keeps_tables and mismatch.is_outdated(monitor, observation.time_s)
            if outdated and not memory.stopping:
                memory = self._adapt_tables(memory, monitor, observation.time_s)
        ahead = self._ahead(memory)
        context = self._context(memory, observation, ahead)
        action, wanted, decided = self._decide(memory, context, observation.time_s)
        interface = self.interface
        command = interface.action.hold(context, action, wanted)
        command, stopping = self._apply_assists(memory, context, ahead, command)
        command = interface.action.round(context, command)
        if memory.monitor is not None:
            share, monitor = mismatch.limit_by_protection(memory.monitor, observation, float(command))
            memory = memory._replace(monitor=mismatch.record_decision(monitor, share))
            command = command if monitor.protection is None else as_double(share)
        memory = memory._replace(
            command=command, action=action, wanted=wanted, decided=decided, stopping=stopping
        )
        return float(command), memory

    def feature_sizes(self, run: Run) -> dict[str, int]:
        """Number of numbers that each feature has in the observation, in its order."""
        standing = Observation(0.0, 0.0, 0.0, 0.0, run.scheduled_time_s, 0.0, run.section)
        memory = self.init(run)
        context = self._context(memory, standing, self._ahead(memory))
        return {name: len(FEATURES.get(name)(context)) for name in self.interface.features}

    def _decide(
        self, memory: LearnedMemory, context: FeatureContext, time_s: float
    ) -> tuple[Any, np.float64, int]:
        """Action, command and number of decisions: those of a new decision where one is due."""
        interface = self.interface
        if time_s < memory.decided * interface.period_s - DECISION_EARLY_S:
            return memory.action, memory.wanted, memory.decided
        seen = observe(interface.features, context)
        mask = interface.action.action_mask(context, interface.period_s)
        action = self.policy(seen) if mask is None else self.policy(seen, mask)
        wanted = as_double(interface.action.command(context, action, interface.period_s))
        return action, wanted, int((time_s + DECISION_EARLY_S) / interface.period_s) + 1

    def _apply_assists(
        self,
        memory: LearnedMemory,
        context: FeatureContext,
        ahead: PredictedState | None,
        command: Any,  # noqa: ANN401 (a number of NumPy's)
    ) -> tuple[Any, Any]:
        """Apply the assists as learned, or the careful ones under plant mismatch."""
        assists, monitor, dt = self.interface.assists, memory.monitor, memory.run.dt
        if monitor is None or ahead is None:
            return apply_assists(assists, context, command, memory.stopping, dt)
        planned = self._planned_mps2(monitor, context.stop_mps2)
        stopping, share = mismatch.station_stop_braking(monitor, ahead, planned, bool(memory.stopping))
        if stopping:
            command = as_double(share)
        elif context.left_s < mismatch.NEAR_STOP * context.to_go_s:
            late_s = context.to_go_s - context.left_s
            if late_s > mismatch.SURELY_LATE_S and context.to_go_s > mismatch.STOPS_S:
                command = np.maximum(command, 1.0)
            elif 0.0 < context.braked_coasting_s[0] - context.left_s < mismatch.LATE_S:
                # far from the stop coasting may arrive late and be right: a fall is still to come
                command = np.maximum(command, context.effort_limits.command_for(0.0))
        if assists.ceiling:
            near = replace(assists, margin_mps=mismatch.MARGIN_MPS)
            most = float(ceiling_mps2(near, context, dt, asked=True))
            command = as_double(mismatch.limit_to_ceiling(monitor, ahead, float(command), most))
        return command, np.bool_(stopping)

    def _planned_mps2(self, monitor: PlantMonitor, surely_mps2: Scalar) -> float:
        """Deceleration the policy's station-stop braking is planned with on the estimated plant, m/s^2."""
        return self.interface.assists.stop_mps2 * monitor.adaptation.brake or float(surely_mps2)

    def _tables(self, run: Run, section: Section, trainset: Trainset) -> SectionTables:
        """One section and a trainset, in float64."""
        interface, case = self.interface, (section, trainset, declared_bounds(run))
        tables = build_tables(
            [case],
            interface.spacing_m,
            np.float64,
            fading=interface.action.fading,
            steady=self.estimates_plant(run),
        )
        return tables._replace(load=np.array([trainset.mass_kg / self.interface.mean_mass_kg]))

    def _set_section(self, memory: LearnedMemory, section: Section) -> LearnedMemory:
        """Change to a section with a restriction that has just been announced."""
        nominal = self._tables(memory.run, section, memory.run.disturbance.nominal(memory.run.trainset))
        memory = memory._replace(section=section, nominal=nominal, rows=SectionRows(nominal, jax=False))
        if memory.monitor is not None:
            monitor = mismatch.set_section(memory.monitor, memory.run, section)
            memory = memory._replace(monitor=monitor)
            if monitor.adapted != Adaptation():
                return self._adapt_tables(memory, monitor, monitor.adapted_at_s)
        return memory._replace(case=memory.rows.case(0))

    def _adapt_tables(self, memory: LearnedMemory, monitor: PlantMonitor, time_s: float) -> LearnedMemory:
        """Build tables of the estimated trainset, under protection of the nominal one."""
        nominal, shown = memory.nominal, monitor.adaptation
        trainset = adapt_trainset(memory.run.disturbance.nominal(memory.run.trainset), shown)
        tables = self._tables(memory.run, memory.section, trainset)
        size = nominal.braking_curves.shape[1]
        braking_curves = np.pad(tables.braking_curves, ((0, 0), (0, size), (0, 0)), "edge")[:, :size]
        braking_curves[..., 1] = np.minimum(braking_curves[..., 1], nominal.braking_curves[..., 1])
        rows = SectionRows(
            tables._replace(
                node_curves=nominal.node_curves, protection=nominal.protection, braking_curves=braking_curves
            ),
            jax=False,
        )
        monitor = monitor._replace(adapted=shown, adapted_at_s=time_s)
        return memory._replace(rows=rows, case=rows.case(0), monitor=monitor)

    @staticmethod
    def _ahead(memory: LearnedMemory) -> PredictedState | None:
        """State when a command given now begins to act; None: at once."""
        monitor = memory.monitor
        if monitor is None or monitor.protection is None:
            return None
        return look_ahead(monitor.model, monitor.estimate)

    def _context(
        self, memory: LearnedMemory, observation: Observation, ahead: PredictedState | None
    ) -> FeatureContext:
        """Features' context: the state as it is, or as it will be when its command begins to act."""
        case, monitor, assists = memory.case, memory.monitor, self.interface.assists
        time, x, v, a = observation[:4]
        scheduled = observation.scheduled_time_s
        if monitor is None or ahead is None:
            if monitor is not None and memory.run.disturbance.speed_noise_mps > 0.0:
                v = monitor.estimate.speed_mps
            stop_mps2 = assists.planned_mps2(memory.rows, 0, case.stop_mps2, float(x))
        else:
            time, x, v, a = time + ahead.seconds, ahead.position_m, ahead.speed_mps, ahead.acceleration_mps2
            stop_mps2 = assists.planned_mps2(memory.rows, 0, case.stop_mps2, float(x))
            planned, own = self._planned_mps2(monitor, stop_mps2), stop_options(assists.release)
            left_m, left_s = float(case.length_m) - x, scheduled - time
            pace = left_m / left_s if left_s > SOON_S else 0.0
            pace = max(float(v), min(pace, float(monitor.model.vehicle.max_speed_mps)), SLOWEST_MPS)
            scheduled -= mismatch.arrival_reserve(monitor, planned, own, pace)
        return feature_context(
            memory.rows,
            0,
            case,
            stop_mps2=stop_mps2,
            time_s=float(time),
            position_m=float(x),
            speed_mps=float(v),
            acceleration_mps2=float(a),
            scheduled_s=float(scheduled),
            command=memory.command,
            assists=assists,
        )
