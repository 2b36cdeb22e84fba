"""An optimiser that looks for the worst case: attacks bred for speed over the limit.

An attack is a script of commands, a start and a plant within the bounds. Every generation keeps those that
came nearest the limit (or got over it) and changes them a little.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tests.protection.hostile import (
    CURVES,
    Campaign,
    line_sections,
    overspeed,
    padded,
    restricted,
    tree_stack,
)

from metropilot import physics
from metropilot.physics import Command
from metropilot.protection import at_start, protect, supervise

STEPS = 160
HOLD = 4
ELITE = 0.2
DIALS = 10
"""Start, speed, mass, resistance, service, delay, lag, jerk, measured speed and position; each 0 to 1."""


class Found(NamedTuple):
    """The best attack of each section: how far over the limit it got (negative: under), and how."""

    over_mps: np.ndarray
    history: np.ndarray
    sections: list[str]


def plant(nominal: physics.Vehicle, bounds: Any, dials: jax.Array) -> physics.Vehicle:
    """The plant that the dials describe, within the bounds; the emergency brake always at its slowest."""

    def dial(k: int, low: float, high: float) -> jax.Array:
        return low + (high - low) * dials[k]

    mass, weak = dial(2, *bounds.mass), dial(4, bounds.service_share, 1.0)
    return nominal._replace(
        mass_kg=nominal.mass_kg * mass,
        effective_mass_kg=nominal.effective_mass_kg * mass,
        emergency_n=nominal.emergency_n * mass,
        service_n=nominal.service_n * mass * weak,
        davis_n=nominal.davis_n * dial(3, *bounds.resistance),
        friction_n=nominal.friction_n * weak,
        brake=nominal.brake * weak,
        delay_s=dial(5, 0.0, bounds.delay_s),
        lag_s=dial(6, 0.0, bounds.lag_s),
        jerk_mps3=jnp.where(dials[7] < 0.5, bounds.jerk_mps3, jnp.inf),
    )


def play(campaign: Campaign, rest: physics.State, protection, track, nominal, script, dials) -> jax.Array:
    """Largest speed over the limit of one attack."""
    bounds = campaign.bounds
    x = dials[0] * track.length_m
    node = ((x - protection.start_m) / protection.spacing_m).astype(jnp.int32)
    permitted = jnp.minimum(protection.permitted_mps[node], protection.permitted_mps[node + 1])
    state = rest._replace(position_m=x, speed_mps=permitted * (0.5 + 0.5 * dials[1]))
    vehicle = plant(nominal, bounds, dials)
    low_m, low_mps = bounds.position_error_m * (2 * dials[9] - 1), bounds.speed_error_mps * (2 * dials[8] - 1)
    dt = jnp.asarray(bounds.dt_s)

    def body(carry, k):
        state, memory, worst = carry
        seen = state.position_m - low_m, jnp.maximum(state.speed_mps - low_mps, 0.0)
        command, memory, _ = supervise(
            protection, memory, *seen, Command(script[k // HOLD], jnp.asarray(False))
        )
        after = physics.step(vehicle, track, state, command, dt)
        return (after, memory, jnp.maximum(worst, overspeed(track, state, after))), None

    start = (state, jax.tree.map(jnp.asarray, at_start(protection)), jnp.asarray(-jnp.inf))
    (_, _, worst), _ = jax.lax.scan(body, start, jnp.arange(STEPS))
    return worst


def breed(
    key: jax.Array, scripts: jax.Array, dials: jax.Array, fitness: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The next generation of one section: the best as they are, the rest changed from them."""
    count = fitness.shape[0]
    elite = int(count * ELITE)
    best = jnp.argsort(-fitness)[:elite]
    parent_key, script_key, dial_key, rare_key = jax.random.split(key, 4)
    parents = best[jax.random.randint(parent_key, (count - elite,), 0, elite)]
    much = jnp.where(jax.random.uniform(rare_key, (count - elite, 1)) < 0.3, 0.6, 0.1)
    new_scripts = scripts[parents] + much * jax.random.normal(script_key, (count - elite, scripts.shape[1]))
    steps = 0.3 * much * jax.random.normal(dial_key, (count - elite, dials.shape[1]))
    scripts = jnp.concatenate([scripts[best], jnp.clip(new_scripts, -1.0, 1.0)])
    return scripts, jnp.concatenate([dials[best], jnp.clip(dials[parents] + steps, 0.0, 1.0)])


def search(campaign: Campaign, population: int, generations: int) -> Found:
    """Breed attacks on every section of the campaign, half of them with restrictions."""
    random = np.random.default_rng(campaign.seed)
    protections, tracks, nominals, names = [], [], [], []
    loads = list(campaign.trainset.loads)
    for k, free in enumerate(line_sections()[: campaign.sections]):
        trainset = campaign.trainset.loaded(loads[k % len(loads)])
        section = restricted(free, random) if campaign.restrictions and k % 2 else free
        protections.append(campaign.mutate(protect(section, trainset, campaign.believed or campaign.bounds)))
        tracks.append(physics.track_arrays(section, trainset))
        nominals.append(physics.vehicle_arrays(trainset))
        names.append(section.name)
    longest = max(p.emergency.size for p in protections)
    protections = [p._replace(**{c: padded(getattr(p, c), longest) for c in CURVES}) for p in protections]
    slots = physics.delay_steps(campaign.bounds.delay_s, campaign.bounds.dt_s)
    with physics.double_precision():
        rest = jax.tree.map(jnp.asarray, physics.at_rest(nominals[0], delay_steps=slots))
        ground = jax.tree.map(
            jnp.asarray, (tree_stack(protections), physics.stack(tracks), tree_stack(nominals))
        )
        one = partial(play, campaign, rest)
        fly = jax.jit(jax.vmap(jax.vmap(one, in_axes=(None, None, None, 0, 0))))
        mix = jax.jit(jax.vmap(breed))
        shape = (len(names), population)
        scripts = jnp.asarray(random.uniform(-1.0, 1.0, (*shape, STEPS // HOLD)))
        scripts = scripts.at[:, : population // 4].set(1.0)
        dials = jnp.asarray(random.uniform(0.0, 1.0, (*shape, DIALS)))
        history = []
        for generation in range(generations):
            fitness = fly(*ground, scripts, dials)
            history.append(np.asarray(fitness).max(axis=1))
            keys = jax.random.split(jax.random.key(campaign.seed + 7919 * generation), len(names))
            scripts, dials = mix(keys, scripts, dials, fitness)
    return Found(np.max(history, axis=0), np.array(history), names)
