"""A learned policy on the host: observer, action and assists of the task it learned, in NumPy, without JAX.

The policy is any function from an observation to an action; :class:`metropilot.policy.Policy` is one. What it
sees and what its action means is a :class:`metropilot.env.PolicyInterface`, and the same functions as in the
task read it. A policy decides once in its decision period; the assists act at the run's own control period.
Under plant mismatch :mod:`metropilot.drivers.watching` takes over part of the work.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np

from metropilot.control import Adaptation, adapt_trainset, look_ahead
from metropilot.drivers import watching
from metropilot.drivers.watching import Watch
from metropilot.env import (
    FeatureContext,
    PolicyInterface,
    SectionRows,
    SectionTables,
    apply_assists,
    build_tables,
    ceiling_mps2,
    feature_context,
    observe,
)
from metropilot.railway import Section, Trainset
from metropilot.sim import AbstractDriver, Observation, Run, declared_bounds

PolicyFunction = Callable[..., Any]
"""From an observation, float32 of shape (O,), to an action: float32 of shape (A,), or an integer choice.

Where the action has a filter, the choices it allows, bool of shape (count,), come second.
"""
DECISION_EARLY_S = 1e-6


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
        watch: Estimate of the plant; None where no assist would use it.
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
    watch: Watch | None


@final
class LearnedDriver(AbstractDriver):
    """Driver that follows a learned policy.

    Args:
        policy: From an observation to an action.
        perception: Features, action and assists of the policy.
    """

    id = "learned"

    def __init__(self, policy: PolicyFunction, perception: PolicyInterface) -> None:
        self.policy = policy
        self.perception = perception

    def init(self, run: Run) -> LearnedMemory:
        """Build the tables the policy sees."""
        nominal = self._tables(run, run.section, run.disturbance.nominal(run.trainset))
        rows, zero = SectionRows(nominal, jax=False), np.float64(0.0)
        watch = watching.first_watch(run) if self.perception.assists.stop else None
        return LearnedMemory(
            run=run,
            section=run.section,
            nominal=nominal,
            rows=rows,
            case=rows.case(0),
            command=zero,
            action=None,
            wanted=zero,
            decided=0,
            stopping=np.bool_(False),
            watch=watch,
        )

    def act(self, memory: LearnedMemory, observation: Observation) -> tuple[float, LearnedMemory]:
        """Decide if it is time to, then apply the assists."""
        if observation.section is not memory.section:
            memory = self._set_section(memory, observation.section)
        if memory.watch is not None:
            watch = watching.update_watch(memory.watch, memory.run, observation)
            memory = memory._replace(watch=watch)
            if watching.is_outdated(watch, observation.time_s) and not memory.stopping:
                memory = self._adapt_tables(memory, watch, observation.time_s)
        context = self._context(memory, observation)
        perception = self.perception
        action, wanted, decided = memory.action, memory.wanted, memory.decided
        if observation.time_s >= decided * perception.period_s - DECISION_EARLY_S:
            seen = observe(perception.features, context)
            mask = perception.action.action_mask(context, perception.period_s)
            action = self.policy(seen) if mask is None else self.policy(seen, mask)
            wanted = np.float64(perception.action.command(context, action, perception.period_s))
            decided = int((observation.time_s + DECISION_EARLY_S) / perception.period_s) + 1
        command = perception.action.hold(context, action, wanted)
        command, stopping = self._apply_assists(memory, context, command)
        command = perception.action.round(context, command)
        if memory.watch is not None:
            share, watch = watching.limit_by_protection(memory.watch, observation, float(command))
            memory = memory._replace(watch=watching.record_decision(watch, share))
            command = command if watch.care is None else np.float64(share)
        memory = memory._replace(
            command=command, action=action, wanted=wanted, decided=decided, stopping=stopping
        )
        return float(command), memory

    def _apply_assists(self, memory: LearnedMemory, context: FeatureContext, command: Any) -> tuple[Any, Any]:  # noqa: ANN401
        """Apply the assists as learned, or the careful ones under plant mismatch."""
        assists, watch, dt = self.perception.assists, memory.watch, memory.run.dt
        if watch is None or watch.care is None:
            return apply_assists(assists, context, command, memory.stopping, dt)
        planned = assists.stop_mps2 * watch.believed.brake or float(context.stop_mps2)
        stopping, share, ahead = watching.station_stop_braking(watch, planned, bool(memory.stopping))
        if stopping or context.left_s < context.to_go_s:
            command = np.float64(share if stopping else 1.0)
        if assists.ceiling:
            near = replace(assists, margin_mps=watching.MARGIN_MPS)
            most = float(ceiling_mps2(near, context, dt))
            command = np.float64(watching.limit_to_ceiling(watch, ahead, float(command), most))
        return command, np.bool_(stopping)

    def _tables(self, run: Run, section: Section, trainset: Trainset) -> SectionTables:
        """One section and a trainset, in float64."""
        tables = build_tables(
            [(section, trainset, declared_bounds(run))], self.perception.spacing_m, np.float64
        )
        return tables._replace(load=np.array([trainset.mass_kg / self.perception.mean_mass_kg]))

    def _set_section(self, memory: LearnedMemory, section: Section) -> LearnedMemory:
        """Change to a section with a restriction that has just been announced."""
        nominal = self._tables(memory.run, section, memory.run.disturbance.nominal(memory.run.trainset))
        memory = memory._replace(section=section, nominal=nominal, rows=SectionRows(nominal, jax=False))
        if memory.watch is not None:
            watch = watching.set_section(memory.watch, memory.run, section)
            memory = memory._replace(watch=watch)
            if watch.adapted != Adaptation():
                return self._adapt_tables(memory, watch, watch.adapted_at_s)
        return memory._replace(case=memory.rows.case(0))

    def _adapt_tables(self, memory: LearnedMemory, watch: Watch, time_s: float) -> LearnedMemory:
        """Build tables of the estimated trainset, under protection of the nominal one."""
        nominal, shown = memory.nominal, watch.believed
        trainset = adapt_trainset(memory.run.disturbance.nominal(memory.run.trainset), shown)
        tables = self._tables(memory.run, memory.section, trainset)
        size = nominal.braked.shape[1]
        braked = np.pad(tables.braked, ((0, 0), (0, size), (0, 0)), "edge")[:, :size]
        braked[..., 1] = np.minimum(braked[..., 1], nominal.braked[..., 1])
        rows = SectionRows(
            tables._replace(ground=nominal.ground, protection=nominal.protection, braked=braked), jax=False
        )
        watch = watch._replace(adapted=shown, adapted_at_s=time_s)
        return memory._replace(rows=rows, case=rows.case(0), watch=watch)

    def _context(self, memory: LearnedMemory, observation: Observation) -> FeatureContext:
        """Features' context: the state as it is, or as it will be when its command begins to act."""
        case, watch = memory.case, memory.watch
        time, x, v, a = observation[:4]
        scheduled = observation.scheduled_time_s
        if watch is not None and watch.care is not None:
            ahead = look_ahead(watch.model, watch.belief)
            time, x, v, a = time + ahead.seconds, ahead.position_m, ahead.speed_mps, ahead.acceleration_mps2
            scheduled -= watching.RESERVE_S
        return feature_context(
            memory.rows,
            0,
            case,
            stop_mps2=self.perception.assists.planned_mps2(memory.rows, 0, case.stop_mps2, np.float64(x)),
            time_s=np.float64(time),
            position_m=np.float64(x),
            speed_mps=np.float64(v),
            acceleration_mps2=np.float64(a),
            scheduled_s=np.float64(scheduled),
            command=memory.command,
        )
