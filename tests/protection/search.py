"""Worst cases of one trainset: what an attack is made of, where it is flown, and how it is judged.

An attack is a script of commands, a start, a plant within the declared bounds, a rail that gets slippery or a
wind that gets up on the way, and errors of the measurement. It is flown over a section of the line with its
restrictions, or over rough ground: gradients and limits at random. Judged by the largest speed over the limit
or, where the movement authority ends on the section, by how far beyond its end the trainset got.
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
    add_restrictions,
    line_sections,
    overspeed,
    pad,
    tree_stack,
)
from tests.protection.optimiser import Worst, hunt, scatter, share

from metropilot import physics
from metropilot.physics import Command
from metropilot.protection import Bounds, Protection, at_start, protect, supervise
from metropilot.railway import Section, Steps

STEPS = 160
HOLD = 4
PIECES = 5
"""Stretches of a run in each of which the errors of measurement stay the same."""
SCRIPT = STEPS // HOLD
DIALS = (
    "start",
    "speed",
    "mass",
    "resistance",
    "wind",
    "gust",
    "service",
    "slip",
    "slips",
    "grips",
    "delay",
    "lag",
    "jerk",
    "emergency_delay",
    "emergency_jerk",
)
SIZE = SCRIPT + len(DIALS) + 2 * PIECES
WIND_MPS = 15.0
NODES = 4096
NEAR_M = 400.0
STEEP_PERMIL = 35.0


class Place(NamedTuple):
    """Places of attacks: one row a place, all in one compiled program.

    Attributes:
        protection: Protection of each section.
        track: The section.
        nominal: The trainset as protection knows it.
        end_m: End of the movement authority; infinite: none.
    """

    protection: Protection
    track: physics.Track
    nominal: physics.Vehicle
    end_m: Any


def rough(section: Section, random: np.random.Generator) -> Section:
    """The section with gradients up to the steepest and limits at random, in short pieces."""

    def pieces(low: float, high: float, values: Any) -> Steps:
        edges = np.cumsum(random.uniform(low, high, int(section.length_m / low) + 1))
        edges = np.append(-500.0, edges[edges < section.length_m])
        return Steps(edges, values(edges.size))

    return Section(
        line_id=section.line_id,
        origin=section.origin,
        destination=section.destination,
        length_m=section.length_m,
        gradient_permil=pieces(40.0, 250.0, lambda n: STEEP_PERMIL * (2.0 * random.beta(0.5, 0.5, n) - 1.0)),
        limit_mps=pieces(80.0, 600.0, lambda n: random.uniform(4.0, 22.0, n)),
    )


def places(campaign: Campaign, count: int, authority: bool) -> Place:
    """So many places: a third each of the line as it is, with restrictions, and of rough ground."""
    random = np.random.default_rng(campaign.seed)
    free = [s for s in line_sections()[: campaign.sections] if s.length_m < NODES - 1000.0]
    loads, rows = list(campaign.trainset.loads), []
    for k in range(count):
        section = free[int(random.integers(len(free)))]
        section = (lambda s, _: s, add_restrictions, rough)[k % 3](section, random)
        trainset = campaign.trainset.with_load(loads[int(random.integers(len(loads)))])
        end = section.length_m * random.uniform(0.4, 1.0) if authority else None
        protection = protect(section, trainset, campaign.believed or campaign.bounds, stop_at_m=end)
        track, vehicle = physics.track_arrays(section, trainset), physics.vehicle_arrays(trainset)
        rows.append((protection, track, vehicle, np.inf if end is None else end))
    protections, tracks, vehicles, ends = zip(*rows, strict=True)
    reach = max(protection.ahead.size for protection in protections)
    known = [campaign.mutate(widen(protection, reach)) for protection in protections]
    return Place(tree_stack(known), physics.stack(list(tracks)), tree_stack(list(vehicles)), np.array(ends))


def widen(protection: Protection, reach: int) -> Protection:
    """The same on a grid of one size for all, so that every place shares one compiled program."""
    curves = {name: pad(getattr(protection, name), NODES + reach) for name in CURVES}
    return protection._replace(**curves, ahead=np.arange(reach, dtype=np.int32))


def dials_of(attack: jax.Array) -> dict[str, jax.Array]:
    return dict(zip(DIALS, share(attack[SCRIPT : SCRIPT + len(DIALS)]), strict=True))


def plant(nominal: physics.Vehicle, bounds: Bounds, dial: dict[str, jax.Array]) -> physics.Vehicle:
    """The plant of an attack: anything within the bounds, the emergency brake as guaranteed."""

    def within(name: str, low: float, high: float) -> jax.Array:
        return low + (high - low) * dial[name]

    mass, weak = within("mass", *bounds.mass), within("service", bounds.service_share, 1.0)
    slowest = bounds.emergency_jerk_mps3
    quick = jnp.where(dial["emergency_jerk"] < 0.5, slowest, 10.0 * slowest)
    return nominal._replace(
        mass_kg=nominal.mass_kg * mass,
        effective_mass_kg=nominal.effective_mass_kg * mass,
        emergency_n=nominal.emergency_n * mass,
        service_n=nominal.service_n * mass * weak,
        friction_n=nominal.friction_n * weak,
        brake=nominal.brake * weak,
        delay_s=within("delay", 0.0, bounds.delay_s),
        lag_s=within("lag", 0.0, bounds.lag_s),
        jerk_mps3=jnp.where(dial["jerk"] < 0.5, bounds.jerk_mps3, jnp.inf),
        emergency_delay_s=within("emergency_delay", 0.0, bounds.emergency_reaction_s),
        emergency_jerk_mps3=quick,
    )


def draw_davis(nominal: physics.Vehicle, bounds: Bounds, dial: dict[str, jax.Array]) -> tuple[Any, Any]:
    """Davis coefficients before and after a wind gets up, both within the declared resistance."""
    low, high = bounds.resistance
    a, b, c = nominal.davis_n
    wind = WIND_MPS * (2.0 * dial["wind"] - 1.0)
    windy = jnp.stack([a + c * wind * wind, b + 2.0 * c * wind, c])
    powers = jnp.vander(jnp.linspace(0.0, nominal.max_speed_mps, 33), 3, increasing=True)
    ratio = (powers @ windy) / (powers @ nominal.davis_n) - 1.0
    most = jnp.minimum(
        (high - 1.0) / jnp.maximum(ratio.max(), 1e-9), (1.0 - low) / jnp.maximum(-ratio.min(), 1e-9)
    )
    blown = nominal.davis_n + jnp.minimum(most, 1.0) * (windy - nominal.davis_n)
    return nominal.davis_n * (low + (high - low) * dial["resistance"]), blown


def fly_one(bounds: Bounds, rest: physics.State, place: Place, attack: jax.Array) -> jax.Array:
    """One attack: largest speed over the limit or, behind an end of authority, way beyond it."""
    protection, track, nominal, end_m = place
    dial, errors = dials_of(attack), 2.0 * share(attack[SCRIPT + len(DIALS) :]) - 1.0
    script = 2.0 * share(attack[:SCRIPT]) - 1.0
    bounded = jnp.isfinite(end_m)
    x = jnp.where(bounded, end_m - 5.0 - NEAR_M * dial["start"], dial["start"] * track.length_m)
    node = ((x - protection.start_m) / protection.spacing_m).astype(jnp.int32)
    permitted = jnp.minimum(protection.permitted_mps[node], protection.permitted_mps[node + 1])
    state = rest._replace(position_m=x, speed_mps=permitted * (0.5 + 0.5 * dial["speed"]))
    whole, (calm, windy) = plant(nominal, bounds, dial), draw_davis(nominal, bounds, dial)
    weakest = bounds.service_share / (bounds.service_share + (1.0 - bounds.service_share) * dial["service"])
    dt, moments = jnp.asarray(bounds.dt_s), STEPS * jnp.stack([dial["gust"], dial["slips"], dial["grips"]])

    def body(carry: Any, k: jax.Array) -> tuple[Any, None]:
        state, memory, worst = carry
        at, piece = k.astype(dt.dtype), k // (STEPS // PIECES)
        slippery = (at >= moments[1]) & (at < moments[2])
        vehicle = whole._replace(
            davis_n=jnp.where(at < moments[0], calm, windy),
            traction=whole.traction * jnp.where(slippery, 0.05 + 0.95 * dial["slip"], 1.0),
            service_n=whole.service_n * jnp.where(slippery, weakest, 1.0),
        )
        seen_m = state.position_m + bounds.position_error_m * errors[PIECES + piece]
        seen_mps = jnp.maximum(state.speed_mps + bounds.speed_error_mps * errors[piece], 0.0)
        wish = Command(script[k // HOLD], jnp.asarray(False))
        command, memory, _ = supervise(protection, memory, seen_m, seen_mps, wish)
        after = physics.step(vehicle, track, state, command, dt)
        beyond = after.position_m - end_m
        worst = jnp.maximum(worst, jnp.where(bounded, beyond, overspeed(track, state, after)))
        return (after, memory, worst), None

    start = (state, jax.tree.map(jnp.asarray, at_start(protection)), jnp.asarray(-jnp.inf))
    (_, _, worst), _ = jax.lax.scan(body, start, jnp.arange(STEPS))
    return worst


class Field:
    """A campaign's attacks as one compiled program, flown over any places of it."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        bounds = campaign.bounds
        slots = physics.delay_steps(bounds.delay_s, bounds.dt_s)
        vehicle = physics.vehicle_arrays(campaign.trainset)
        self._rest = physics.at_rest(vehicle, delay_steps=slots)
        one = partial(fly_one, bounds, self._rest)
        self._fly = jax.jit(jax.vmap(jax.vmap(one, in_axes=(None, 0))))

    def over(self, where: Place) -> Any:
        """Value of every attack (P, population, D) on these places."""

        def fly(attacks: np.ndarray) -> np.ndarray:
            with physics.double_precision():
                return np.asarray(self._fly(*jax.tree.map(jnp.asarray, (where, attacks))))

        return fly

    def search(self, where: Place, population: int, generations: int, seed: int) -> Worst:
        """CMA-ES, every second place begun at full traction from the permitted speed."""
        count = np.shape(where.end_m)[0]
        start = np.random.default_rng(seed).uniform(0.2, 0.8, (count, SIZE))
        start[::2, :SCRIPT] = 0.9
        start[::2, SCRIPT + 1] = 0.9
        return hunt(self.over(where), start, population, generations, seed)

    def scatter(self, where: Place, population: int, generations: int, seed: int) -> Worst:
        """Random search with as many attacks."""
        count = np.shape(where.end_m)[0]
        return scatter(self.over(where), count, SIZE, population, generations, seed)
