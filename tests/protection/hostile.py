"""The hostile campaign: every section, load and corner of the bounds, under commands that mean harm.

Nothing here is a test; ``test_hostile.py`` runs it for a million steps and ``benchmarks/hostile.py`` for as
many as wanted. Outer axis: protected sections; inner axis: attacks on each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from metropilot import physics
from metropilot.physics import Command
from metropilot.protection import Bounds, Protection, at_start, protect, supervise
from metropilot.railway import Restriction, Section, Trainset, load_line, load_trainset

LINE = "yizhuang"
ATTACKS = (
    "random",
    "bang_bang",
    "stuck",
    "late",
    "no_number",
    "alternating",
    "feint",
    "surge",
    "alarm",
    "edge",
)
CURVES = ("emergency", "service", "pull_mps2", "usual_pull_mps2", "permitted_mps")
CHUNK = 100
LATE_STEPS = 16
RESTART = 400
BEYOND_M = 60.0


class Attack(NamedTuple):
    """Means of one lane: a plant at a corner of the bounds, a policy, and a start."""

    vehicle: physics.Vehicle
    policy: jax.Array
    speed_bias: jax.Array
    position_bias: jax.Array
    speed_error_mps: jax.Array
    position_error_m: jax.Array
    key: jax.Array


class Lane(NamedTuple):
    """A run in progress: plant, supervisor, the attacker's own memory."""

    state: physics.State
    memory: Any
    held: jax.Array
    past: jax.Array
    age: jax.Array
    key: jax.Array


class Tally(NamedTuple):
    """Result of a campaign. ``over_mps``: largest speed above the limit, negative if none."""

    steps: int
    over_mps: float
    over_steps: int
    interventions: int
    emergencies: int
    invalid: int
    finite: bool


@dataclass(frozen=True)
class Campaign:
    """A campaign's size and what is declared.

    Attributes:
        trainset: Nominal trainset.
        bounds: Declared bounds.
        steps: Steps of each lane.
        lanes: Attacks on each protected section.
        sections: How many of the line's sections, both directions; None: all.
        restrictions: Whether random temporary restrictions are laid over half of the sections.
        supervised: False lets every command through.
        dtype: Number type.
        seed: Seed of everything random.
        believed: Bounds that protection is built with, where they differ from the plant's.
        mutate: What to do to each protection before it is used (to remove a guard).
    """

    trainset: Trainset
    bounds: Bounds
    steps: int = 300
    lanes: int = 20
    sections: int | None = None
    restrictions: bool = True
    supervised: bool = True
    dtype: type = np.float64
    seed: int = 0
    believed: Bounds | None = None
    mutate: Callable[[Protection], Protection] = lambda protection: protection


@cache
def line_sections(name: str = LINE) -> tuple[Section, ...]:
    line = load_line(name)
    return line.sections() + line.sections(backward=True)


def add_restrictions(section: Section, random: np.random.Generator) -> Section:
    """The section with one or two temporary restrictions, now and then shorter than the reaction distance."""
    for _ in range(int(random.integers(1, 3))):
        start = random.uniform(0.0, section.length_m - 30.0)
        length = random.choice([5.0, 20.0, 60.0, 200.0]) * random.uniform(0.5, 1.5)
        section = section.with_restriction(Restriction(start, start + length, random.uniform(3.0, 20.0)))
    return section


def corner(
    vehicle: physics.Vehicle, bounds: Bounds, random: np.random.Generator, worst: bool
) -> physics.Vehicle:
    """A plant within the bounds, at their corners more often than not, or slow, weak and easy to move."""

    def draw(low: float, high: float, bad: float | None = None) -> float:
        if worst and bad is not None:
            return bad
        return float(random.choice([low, high, random.uniform(low, high)], p=[0.4, 0.4, 0.2]))

    mass, weak = draw(*bounds.mass), draw(bounds.service_share, 1.0, bounds.service_share)
    easy = bounds.resistance[0]
    brake = vehicle.brake * np.asarray(weak, vehicle.brake.dtype)
    new = {
        "mass_kg": vehicle.mass_kg * mass,
        "effective_mass_kg": vehicle.effective_mass_kg * mass,
        "emergency_n": vehicle.emergency_n * mass,
        "service_n": vehicle.service_n * mass * weak,
        "davis_n": vehicle.davis_n * draw(*bounds.resistance, easy),
        "friction_n": vehicle.friction_n * weak,
        "brake": brake,
        "delay_s": draw(0.0, bounds.delay_s, bounds.delay_s),
        "lag_s": draw(0.0, bounds.lag_s, bounds.lag_s),
        "jerk_mps3": random.choice([bounds.jerk_mps3, bounds.jerk_mps3 if worst else np.inf]),
        "emergency_delay_s": draw(0.0, bounds.emergency_reaction_s, bounds.emergency_reaction_s),
        "emergency_jerk_mps3": draw(bounds.emergency_jerk_mps3, 1e4, bounds.emergency_jerk_mps3)
        if np.isfinite(bounds.emergency_jerk_mps3)
        else np.inf,
    }
    kind = np.asarray(vehicle.mass_kg).dtype
    return vehicle._replace(**{k: np.asarray(v, kind)[()] for k, v in new.items()})


def arena(campaign: Campaign):
    """Protections and tracks (sections), attacks and lanes (sections, lanes), as JAX arrays."""
    random = np.random.default_rng(campaign.seed)
    bounds, dtype = campaign.bounds, campaign.dtype
    loads = list(campaign.trainset.loads)
    protections, tracks, attacks = [], [], []
    for k, free in enumerate(line_sections()[: campaign.sections]):
        trainset = campaign.trainset.with_load(loads[(k + campaign.seed) % len(loads)])
        slower = campaign.restrictions and random.random() < 0.5
        section = add_restrictions(free, random) if slower else free
        believed = protect(section, trainset, campaign.believed or bounds, dtype=dtype)
        protections.append(campaign.mutate(believed))
        tracks.append(physics.track_arrays(section, trainset, dtype))
        nominal = physics.vehicle_arrays(trainset, dtype)
        attacks.append([attack(nominal, bounds, lane, random, dtype) for lane in range(campaign.lanes)])
    assert len({p.ahead.size for p in protections}) == 1
    longest = max(p.emergency.size for p in protections)
    protections = [
        p._replace(**{name: pad(getattr(p, name), longest) for name in CURVES}) for p in protections
    ]
    inner = [tree_stack(row) for row in attacks]
    slots = physics.delay_steps(bounds.delay_s, bounds.dt_s)
    rest = physics.at_rest(physics.vehicle_arrays(campaign.trainset, dtype), delay_steps=slots)
    return jax.tree.map(
        jnp.asarray, (tree_stack(protections), physics.stack(tracks), tree_stack(inner), rest)
    )


def attack(
    nominal: physics.Vehicle, bounds: Bounds, lane: int, random: np.random.Generator, dtype: type
) -> Attack:
    worst = (lane // len(ATTACKS)) % 2 == 1
    biased = dtype(-1.0 if worst else random.choice([-1.0, 0.0, 1.0]))
    return Attack(
        vehicle=corner(nominal, bounds, random, worst),
        policy=np.int32(lane % len(ATTACKS)),
        speed_bias=biased,
        position_bias=dtype(-1.0 if worst else random.choice([-1.0, 0.0, 1.0])),
        speed_error_mps=dtype(bounds.speed_error_mps),
        position_error_m=dtype(bounds.position_error_m),
        key=np.asarray(jax.random.key_data(jax.random.key(int(random.integers(2**31))))),
    )


def pad(values: np.ndarray, size: int) -> np.ndarray:
    return np.pad(values, (0, size - values.size), mode="edge")


def tree_stack(trees: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *trees)


def wish(attack: Attack, lane: Lane, verdict_level: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The attacker's command, and what it holds on to."""
    dtype = lane.held.dtype
    one, two, three = jax.random.split(key, 3)
    uniform = jax.random.uniform(one, (), dtype, -1.0, 1.0)
    chance = jax.random.uniform(two, (), dtype)
    pick = jax.random.uniform(three, (), dtype)
    sign = jnp.where(uniform > 0, 1.0, -1.0).astype(dtype)
    switched = jnp.where(chance < 0.07, sign, lane.held)
    even = (lane.age % 2) == 0
    table = jnp.asarray([jnp.nan, jnp.inf, -jnp.inf, 7.0, -3.0, 1.0, 1.0, 1.0], dtype)
    nasty = table[jnp.floor(pick * 8.0).astype(jnp.int32)]
    calm = verdict_level == 0
    # Feint: coasts after an intervention until the supervisor lets go, then full traction again.
    feint = jnp.where(chance < 0.3, lane.held, jnp.where(calm, 1.0, 0.0)).astype(dtype)
    # Surge: brakes for some seconds, so that the measured speed is low, then everything at once.
    surge = jnp.where((lane.age % 40) < 10, -1.0, 1.0).astype(dtype)
    # Edge: a little more after each command that passed, much less after each that did not.
    edge = jnp.clip(lane.held + jnp.where(calm, 0.15, -0.4), -1.0, 1.0).astype(dtype)
    full = jnp.ones((), dtype)
    options = jnp.stack(
        [
            uniform,
            switched,
            full,
            lane.past[-1],
            nasty,
            jnp.where(even, full, -full),
            feint,
            surge,
            jnp.where(chance < 0.9, full, uniform),
            edge,
        ]
    )
    held = jnp.stack([switched, feint, edge])
    return options[attack.policy], held[jnp.where(attack.policy == 1, 0, jnp.where(attack.policy == 9, 2, 1))]


def overspeed(track: physics.Track, before: physics.State, after: physics.State) -> jax.Array:
    """Largest speed over the limit anywhere in a step, by the exact motion under constant acceleration."""
    x0, x1, v0, v1 = before.position_m, after.position_m, before.speed_mps, after.speed_mps
    breaks = track.limit_from_m
    lower = jnp.minimum(track.limit_mps, jnp.concatenate([track.limit_mps[:1], track.limit_mps[:-1]]))
    inside = (breaks > x0) & (breaks <= x1)
    share = jnp.where(inside, (breaks - x0) / jnp.maximum(x1 - x0, 1e-9), 0.0)
    there = jnp.sqrt(jnp.maximum(v0 * v0 + (v1 * v1 - v0 * v0) * share, 0.0))
    crossed = jnp.max(jnp.where(inside, there - lower, -jnp.inf))
    held = track.limit_mps[jnp.maximum(jnp.sum(breaks <= x1) - 1, 0)]
    return jnp.maximum(crossed, v1 - held)


def restart(protection: Any, track: physics.Track, rest: physics.State, key: jax.Array) -> Lane:
    """A new run: at rest or anywhere at or under the permitted speed, nothing on its way."""
    where_key, speed_key, rest_key = jax.random.split(key, 3)
    dtype = rest.speed_mps.dtype
    x = jax.random.uniform(where_key, (), dtype) * track.length_m
    pace = jnp.minimum(1.3 * jax.random.uniform(speed_key, (), dtype), 1.0)
    node = ((x - protection.start_m) / protection.spacing_m).astype(jnp.int32)
    permitted = jnp.minimum(protection.permitted_mps[node], protection.permitted_mps[node + 1])
    state = rest._replace(position_m=x, speed_mps=pace * permitted)
    fresh = jax.tree.map(jnp.asarray, at_start(protection))
    past = jnp.zeros(LATE_STEPS, dtype)
    zero = jnp.zeros((), dtype)
    return Lane(state, fresh, zero, past, jnp.int32(0), rest_key)


def advance(
    supervised: bool, rest: physics.State, dt: jax.Array, protection, track, attack: Attack, lane: Lane
):
    """One step of one lane; returns the lane and what to count."""
    key, wish_key, noise_key, restart_key = jax.random.split(lane.key, 4)
    raw, held = wish(attack, lane, lane.memory.level, wish_key)
    dtype = raw.dtype
    noise = jax.random.uniform(noise_key, (2,), dtype, -1.0, 1.0)
    speed_share = jnp.where(attack.speed_bias == 0, noise[0], attack.speed_bias)
    speed = jnp.maximum(lane.state.speed_mps + attack.speed_error_mps * speed_share, 0.0)
    position = lane.state.position_m + attack.position_error_m * jnp.where(
        attack.position_bias == 0, noise[1], attack.position_bias
    )
    asked = (attack.policy == 8) & (jnp.abs(noise[1]) > 0.995)
    command, memory, _ = supervise(protection, lane.memory, position, speed, Command(raw, asked))
    let_through = Command(jnp.where(jnp.isfinite(raw), jnp.clip(raw, -1.0, 1.0), 1.0), jnp.asarray(False))
    command = jax.tree.map(lambda kept, free: jnp.where(supervised, kept, free), command, let_through)
    state = physics.step(attack.vehicle, track, lane.state, command, dt)
    over = overspeed(track, lane.state, state)
    finite = jnp.isfinite(state.speed_mps) & jnp.isfinite(state.position_m)
    counts = (
        over,
        finite,
        memory.interventions - lane.memory.interventions,
        memory.emergencies - lane.memory.emergencies,
        memory.invalid - lane.memory.invalid,
    )
    ended = (state.position_m > track.length_m + BEYOND_M) | (lane.age >= RESTART)
    ended = ended | (memory.emergency & (state.speed_mps <= 0) & (lane.age > 20))
    # Late: a driver who does brake when overruled, but seconds after it.
    sees = jnp.where(memory.level > 0, -1.0, 1.0).astype(dtype)
    past = jnp.concatenate([sees[None], lane.past[:-1]])
    going = Lane(state, memory, held, past, lane.age + 1, key)
    new = restart(protection, track, rest, restart_key)
    return jax.tree.map(lambda a, b: jnp.where(ended, a, b), new, going), counts


@jax.jit
def play(protections, tracks, attacks, rest, lanes, dt, supervised):
    """All lanes of all sections for ``CHUNK`` steps; returns the lanes and, per lane, worst and totals."""
    one = partial(advance, supervised, rest, dt)
    per_section = jax.vmap(one, in_axes=(None, None, 0, 0))
    everywhere = jax.vmap(per_section)

    def body(carry, _):
        lanes, total = carry
        lanes, (over, finite, interventions, emergencies, invalid) = everywhere(
            protections, tracks, attacks, lanes
        )
        worst, above, whole, counts = total
        counts = counts + jnp.stack([interventions.sum(), emergencies.sum(), invalid.sum()]).astype(
            counts.dtype
        )
        total = jnp.maximum(worst, over), above + (over > 0).astype(jnp.int32), whole & finite, counts
        return (lanes, total), None

    shape = attacks.policy.shape
    start = (
        jnp.full(shape, -jnp.inf, rest.speed_mps.dtype),
        jnp.zeros(shape, jnp.int32),
        jnp.ones(shape, bool),
        jnp.zeros(3, jnp.int32),
    )
    (lanes, total), _ = jax.lax.scan(body, (lanes, start), None, length=CHUNK)
    return lanes, total


@jax.jit
def first_lanes(protections, tracks, attacks, rest):
    one = lambda p, t, a: restart(p, t, rest, jax.random.wrap_key_data(a.key))  # noqa: E731
    return jax.vmap(jax.vmap(one, in_axes=(None, None, 0)))(protections, tracks, attacks)


def fight(campaign: Campaign) -> Tally:
    """Run a campaign and add it up."""
    with physics.double_precision() if campaign.dtype is np.float64 else jax.enable_x64(False):
        protections, tracks, attacks, rest = arena(campaign)
        lanes = first_lanes(protections, tracks, attacks, rest)
        dt = jnp.asarray(campaign.bounds.dt_s, rest.speed_mps.dtype)
        supervised = jnp.asarray(campaign.supervised)
        worst, above, whole, counts = -np.inf, 0, True, np.zeros(3, int)
        for _ in range(campaign.steps // CHUNK):
            lanes, (over, over_steps, finite, found) = play(
                protections, tracks, attacks, rest, lanes, dt, supervised
            )
            worst = max(worst, float(over.max()))
            above += int(over_steps.sum())
            whole = whole and bool(finite.all())
            counts += np.asarray(found)
    steps = attacks.policy.size * (campaign.steps // CHUNK) * CHUNK
    return Tally(steps, worst, above, int(counts[0]), int(counts[1]), int(counts[2]), whole)


def real_bounds(trainset: Trainset, dt_s: float = 0.2) -> Bounds:
    """The widest bounds of the campaigns: late and lagging actuation, noisy speed, uncertain position."""
    return Bounds.of(
        trainset, dt_s, extra_delay_s=0.6, extra_lag_s=0.4, speed_error_mps=0.15, position_error_m=2.0
    )


def real(**changes: Any) -> Campaign:
    trainset = load_trainset("dkz32")
    return replace(Campaign(trainset, real_bounds(trainset)), **changes)


def ideal(**changes: Any) -> Campaign:
    trainset = load_trainset("dkz32").ideal()
    return replace(Campaign(trainset, Bounds.of(trainset, 0.2)), **changes)


def bare(protection: Protection) -> Protection:
    """The guarantee alone: without the service curve, which only spares the emergency brake."""
    return protection._replace(service=np.full_like(protection.service, 1e6))
