"""A learned policy on the host: observer, action and assists of the task it learned, in NumPy, without JAX.

The policy is any function from an observation to an action; :class:`metropilot.learn.Policy` is one. What it
sees and what its action means is a :class:`metropilot.task.Perception`, and the same functions as in the task
read it. A policy decides once in its decision period; the assists act at the run's own control period.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np

from metropilot.drivers.base import AbstractDriver
from metropilot.railway import Section
from metropilot.task import Observation, Perception, Run, declared_bounds
from metropilot.task.assist import assisted
from metropilot.task.observers import Sight, observe
from metropilot.task.tables import Rows, Tables, build_tables

PolicyFunction = Callable[..., Any]
"""From an observation, float32 of shape (O,), to an action: float32 of shape (A,), or an integer choice.

Where the action has a filter, the choices it allows, bool of shape (count,), come second.
"""
EARLY_S = 1e-6


class LearnedMemory(NamedTuple):
    """What the driver carries from one period to the next.

    Attributes:
        run: The run.
        section: The section as last announced.
        rows: What it sees of it, as tables.
        case: The one row of them.
        command: Last command.
        action: Action of the policy's last decision.
        wanted: Command it asked for.
        decided: Decisions taken.
        stopping: Whether the last braking has begun.
    """

    run: Run
    section: Section
    rows: Rows
    case: Tables
    command: np.float64
    action: Any
    wanted: np.float64
    decided: int
    stopping: np.bool_


@final
class LearnedDriver(AbstractDriver):
    """Drives as it learned to.

    Args:
        policy: From an observation to an action.
        perception: What the policy sees, what its actions mean, what is done for it.
    """

    id = "learned"
    summary = "A learned policy"
    source = "own"

    def __init__(self, policy: PolicyFunction, perception: Perception) -> None:
        self.policy = policy
        self.perception = perception

    def init(self, run: Run) -> LearnedMemory:
        """Build the tables the policy sees."""
        rows = self._rows(run, run.section)
        zero = np.float64(0.0)
        return LearnedMemory(run, run.section, rows, rows.case(0), zero, None, zero, 0, np.bool_(False))

    def act(self, memory: LearnedMemory, observation: Observation) -> tuple[float, LearnedMemory]:
        """Decide if it is time to, then what the assists make of the decision."""
        perception = self.perception
        if observation.section is not memory.section:
            rows = self._rows(memory.run, observation.section)
            memory = memory._replace(section=observation.section, rows=rows, case=rows.case(0))
        sight = self._sight(memory, observation)
        action, wanted, decided = memory.action, memory.wanted, memory.decided
        if observation.time_s >= decided * perception.period_s - EARLY_S:
            seen = observe(perception.features, sight)
            mask = perception.action.allowed(sight, perception.period_s)
            action = self.policy(seen) if mask is None else self.policy(seen, mask)
            wanted = np.float64(perception.action.command(sight, action, perception.period_s))
            decided = int((observation.time_s + EARLY_S) / perception.period_s) + 1
        command = perception.action.held(sight, action, wanted)
        dt = memory.run.dt
        command, stopping = assisted(perception.assists, sight, command, memory.stopping, dt)
        command = perception.action.settled(sight, command)
        memory = memory._replace(
            command=command, action=action, wanted=wanted, decided=decided, stopping=stopping
        )
        return float(command), memory

    def _rows(self, run: Run, section: Section) -> Rows:
        """The tables of one section, in float64."""
        trainset = run.scenario.believed(run.trainset)
        case = (section, trainset, declared_bounds(run))
        tables = build_tables([case], self.perception.spacing_m, np.float64)
        load = np.array([trainset.mass_kg / self.perception.mean_mass_kg])
        return Rows(tables._replace(load=load), jax=False)

    def _sight(self, memory: LearnedMemory, observation: Observation) -> Sight:
        case = memory.case
        return Sight(
            rows=memory.rows,
            case=0,
            vehicle=case.vehicle,
            track=case.track,
            length_m=case.length_m,
            load=case.load,
            stop_mps2=self.perception.assists.planned_mps2(
                memory.rows, 0, case.stop_mps2, np.float64(observation.position_m)
            ),
            rates=case.protection.rates,
            time_s=np.float64(observation.time_s),
            position_m=np.float64(observation.position_m),
            speed_mps=np.float64(observation.speed_mps),
            acceleration_mps2=np.float64(observation.acceleration_mps2),
            scheduled_s=np.float64(observation.scheduled_time_s),
            command=memory.command,
        )
