"""Task of choosing the gains of a tracking PID: Cheng23's (eqs. 7, 8, 10 and 15 to 22)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from metropilot._typing import Array, Flag, Float, Index, Key, Scalar
from metropilot.control import Errors
from metropilot.drivers import TrackingView
from metropilot.env import AbstractTask, ActionSpace, Transition
from metropilot.errors import InputError
from metropilot.physics import davis_n, effort_at
from metropilot.studies.cheng2023 import tracking
from metropilot.studies.cheng2023.law import PAPER_LAW, TrackingLaw
from metropilot.units import KMH_PER_MPS


@dataclass(frozen=True)
class TrackingRewards:
    """Five reward terms of Cheng23 and their weights.

    Attributes:
        weights: Weights of safety, tracking, parking, comfort and efficiency (eq. 17).
        unsafe: C of eq. 18.
        speed_scale_mps: Error that halves the speed's reward; 1 in eq. 19.
        distance_scale_m: Error that halves the position's reward; 1 in eq. 19.
        jerk_scale_mps3: Jerk that halves the comfort reward; 1 in eq. 21.
        parking_m: Tolerance of eq. 20.
        parking_scale_m: Error that halves the parking reward; 1 in eq. 20.
        energy_j: Energy that costs 1 (eq. 22 names no unit; 1 kWh).
        centred: Subtract the best value from the rewards of tracking and comfort, so that a perfect run
            earns its parking reward alone. In episodes of equal length this only shifts the return.
    """

    weights: tuple[float, float, float, float, float] = (0.2, 0.2, 0.2, 0.2, 0.2)
    unsafe: float = 100.0
    speed_scale_mps: float = 1.0
    distance_scale_m: float = 1.0
    jerk_scale_mps3: float = 1.0
    parking_m: float = 0.3
    parking_scale_m: float = 1.0
    energy_j: float = 3.6e6
    centred: bool = True

    def __post_init__(self) -> None:
        for name in ("speed_scale_mps", "distance_scale_m", "jerk_scale_mps3", "parking_scale_m", "energy_j"):
            if not getattr(self, name) > 0:
                raise InputError("out of range", field=name, value=getattr(self, name), allowed="> 0")


@dataclass(frozen=True, eq=False)
class TrackingConfig:
    """Configuration of a tracking task.

    Attributes:
        courses: References to track; an episode draws one. They are padded to one length.
        law: Law whose parameters an action sets.
        rewards: Terms of the reward.
        limit_mps: Speed limit (eq. 18 ends the episode above it).
        on_the_way: Share of episodes that begin on the way, near the reference.
        apart_mps: Largest speed error they begin with.
        apart_m: Largest position error they begin with.
        noise_mps: Largest standard deviation of the measured speed; an episode draws one.
        grace: Let a trainset that still moves at the end of the reference come to a stand; the paper ends the
            episode there.
    """

    courses: tuple[tracking.ReferenceCourse, ...]
    law: TrackingLaw = PAPER_LAW
    rewards: TrackingRewards = TrackingRewards()
    limit_mps: float = 80 / KMH_PER_MPS
    on_the_way: float = 0.5
    apart_mps: float = 0.1
    apart_m: float = 0.2
    noise_mps: float = 0.0
    grace: bool = True


class TrackingFacts(NamedTuple):
    """Inputs of the reward of a step.

    Attributes:
        error_mps: Speed error after the step.
        distance_m: Position error after the step.
        to_target_m: Distance to the stop.
        jerk_mps3: Change of acceleration over the period.
        work_j: Traction work of the period.
        unsafe: Whether the limit was exceeded.
        over: Whether the run is over.
    """

    error_mps: Scalar
    distance_m: Scalar
    to_target_m: Scalar
    jerk_mps3: Scalar
    work_j: Scalar
    unsafe: Flag
    over: Flag


def reward_terms(rewards: TrackingRewards, facts: TrackingFacts) -> dict[str, Scalar]:
    """Five weighted reward terms of one step (Cheng23 eqs. 17 to 22)."""
    import jax.numpy as jnp

    w1, w2, w3, w4, w5 = rewards.weights
    best = 1.0 if rewards.centred else 0.0
    missed = jnp.abs(facts.to_target_m)
    speed = 1.0 / (1.0 + jnp.abs(facts.error_mps) / rewards.speed_scale_mps)
    place = 1.0 / (1.0 + jnp.abs(facts.distance_m) / rewards.distance_scale_m)
    parked = jnp.where(missed < rewards.parking_m, 1.0 / (1.0 + missed / rewards.parking_scale_m), -missed)
    comfort = 1.0 / (1.0 + jnp.abs(facts.jerk_mps3) / rewards.jerk_scale_mps3)
    return {
        "safety": w1 * jnp.where(facts.unsafe, -rewards.unsafe, 0.0),
        "tracking": w2 * (speed + place - 2.0 * best),
        "parking": w3 * jnp.where(facts.over, parked, 0.0),
        "comfort": w4 * (comfort - best),
        "efficiency": w5 * (-facts.work_j / rewards.energy_j),
    }


class TrackingState(NamedTuple):
    """State of an episode: that of the loop, the course it is on, and the noise of the measured speed.

    Attributes:
        loop: State of the loop.
        course: Number of the course.
        noise_mps: Standard deviation of the measured speed.
        off_mps: Error of the measurement now.
    """

    loop: tracking.TrackState
    course: Index
    noise_mps: Scalar
    off_mps: Scalar


class TrackingTask(AbstractTask):
    """Set the parameters of a tracking law at each control period so that a reference is tracked.

    Args:
        config: Configuration of the task.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self.config = config
        self.action_space = ActionSpace(size=config.law.actions)
        self.observation_size = len(config.law.observed)
        self.longest = max(course.periods for course in config.courses)
        import jax

        padded = [tracking.compile_course(_pad(course, self.longest)) for course in config.courses]
        self.courses: tracking.ReferenceCourse = jax.tree.map(
            lambda *leaves: jax.numpy.stack(leaves), *padded
        )

    def course(self, index: Index) -> tracking.ReferenceCourse:
        """One of the courses."""
        import jax

        return jax.tree.map(lambda leaf: leaf[index], self.courses)

    def begin(self, index: Index) -> tuple[TrackingState, Float[Array, " entries"]]:
        """Begin an episode on a course from standstill, without noise."""
        import jax.numpy as jnp

        none = jnp.float32(0.0)
        state = TrackingState(tracking.start_compiled(), jnp.asarray(index, jnp.int32), none, none)
        return state, self._observe(state)

    def _view(self, state: TrackingState) -> TrackingView:
        """Inputs of the law: the speed as it is measured."""
        seen = tracking.tracking_view(self.course(state.course), state.loop)
        return seen._replace(
            error_mps=seen.error_mps - state.off_mps, speed_mps=seen.speed_mps + state.off_mps
        )

    def _observe(self, state: TrackingState) -> Float[Array, " entries"]:
        return self.config.law.observe(self._view(state), state.loop.errors)

    def reset(self, key: Key) -> tuple[TrackingState, Float[Array, " entries"]]:
        """Begin an episode on a random course, from standstill or near the reference on the way."""
        import jax
        import jax.numpy as jnp

        config = self.config
        pick, place, share, apart = jax.random.split(key, 4)
        state, _ = self.begin(jax.random.randint(pick, (), 0, len(config.courses)))
        course = self.course(state.course)
        k = jax.random.randint(place, (), 1, course.end - 5)
        off = jax.random.uniform(apart, (2,), jnp.float32, -1.0, 1.0)
        rate = (course.speed_mps[k + 1] - course.speed_mps[k - 1]) / (2 * course.dt)
        speed = jnp.maximum(course.speed_mps[k] + config.apart_mps * off[0], 0.1)
        effort = effort_at(course.vehicle, speed)
        force = rate * course.vehicle.effective_mass_kg + davis_n(course.vehicle, speed)
        command = jnp.clip(force / jnp.where(force > 0, effort.traction_n, effort.brake_n), -1.0, 1.0)
        plant = state.loop.plant._replace(
            position_m=course.position_m[k] + config.apart_m * off[1],
            speed_mps=speed,
            acceleration_mps2=rate,
            time_s=k.astype(jnp.float32) * course.dt,
        )
        error = course.speed_mps[k] - speed
        moving = tracking.TrackState(plant, command, Errors(error, error), k)
        on_the_way = jax.random.uniform(share) < config.on_the_way
        loop = jax.tree.map(lambda a, b: jnp.where(on_the_way, a, b), moving, state.loop)
        noise = config.noise_mps * jax.random.uniform(jax.random.fold_in(key, 1))
        state = state._replace(loop=loop, noise_mps=jnp.float32(noise))
        return state, self._observe(state)

    def step(
        self, key: Key, state: TrackingState, action: Float[Array, " actions"]
    ) -> tuple[TrackingState, Transition]:
        """Take one control period with the parameters of an action."""
        import jax
        import jax.numpy as jnp

        config, course = self.config, self.course(state.course)
        command, errors = config.law.step(action, self._view(state), state.loop.errors)
        loop = tracking.advance_tracking(course, state.loop, command, errors)
        after, plant, before = tracking.tracking_view(course, loop), loop.plant, state.loop.plant
        unsafe = plant.speed_mps > config.limit_mps
        late = loop.period >= course.end
        stood = (plant.speed_mps <= 0) | (loop.period >= self.longest)
        over = late & stood if config.grace else late
        facts = TrackingFacts(
            error_mps=after.error_mps,
            distance_m=after.distance_m,
            to_target_m=course.track.length_m - plant.position_m,
            jerk_mps3=(plant.acceleration_mps2 - before.acceleration_mps2) / course.dt,
            work_j=plant.traction_j - before.traction_j,
            unsafe=unsafe,
            over=over,
        )
        terms = reward_terms(config.rewards, facts)
        off = state.noise_mps * jax.random.normal(key) if config.noise_mps > 0.0 else state.off_mps
        state = state._replace(loop=loop, off_mps=off)
        transition = Transition(
            observation=self._observe(state),
            reward=sum(terms.values(), jnp.float32(0.0)),
            terminated=unsafe | over,
            truncated=jnp.zeros((), bool),
            terms=terms,
        )
        return state, transition


def _pad(course: tracking.ReferenceCourse, periods: int) -> tracking.ReferenceCourse:
    """A course held at its end up to a number of periods."""
    extra = periods - course.periods
    return course._replace(
        position_m=np.pad(course.position_m, (0, extra), mode="edge"),
        speed_mps=np.pad(course.speed_mps, (0, extra), mode="edge"),
        needed=np.pad(course.needed, (0, extra), mode="edge"),
    )
