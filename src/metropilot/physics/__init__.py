"""The plant: pure functions for one trainset over an array namespace (NumPy or JAX)."""

from metropilot.physics.arrays import locate, namespace, scalars, to_jax, unless
from metropilot.physics.batch import batch_size, double_precision, grid, rollout, rollout_batch, spread, stack
from metropilot.physics.build import (
    emergency_jerk_mps3,
    padded_size,
    restrictive_profile,
    track_arrays,
    vehicle_arrays,
)
from metropilot.physics.deceleration import controlled
from metropilot.physics.effort import (
    Effort,
    brake_available_n,
    command_for_effort,
    command_for_force,
    command_force_n,
    curve_n,
    effort_at,
    electric_available_n,
    traction_available_n,
)
from metropilot.physics.energy import map_value, step_energy
from metropilot.physics.integrators import INTEGRATORS
from metropilot.physics.multibody import (
    Bodies,
    Consist,
    bodies_at,
    centre_of_mass_m,
    consist,
    heads_m,
    multibody_step,
    substeps,
)
from metropilot.physics.plant import Command, at_rest, delay_steps, pushed, step
from metropilot.physics.resistance import davis_n, felt_slopes, resistance_and_gradient
from metropilot.physics.types import Forces, State, Track, Vehicle

__all__ = [
    "INTEGRATORS",
    "Bodies",
    "Command",
    "Consist",
    "Effort",
    "Forces",
    "State",
    "Track",
    "Vehicle",
    "at_rest",
    "batch_size",
    "bodies_at",
    "brake_available_n",
    "centre_of_mass_m",
    "command_for_effort",
    "command_for_force",
    "command_force_n",
    "consist",
    "controlled",
    "curve_n",
    "davis_n",
    "delay_steps",
    "double_precision",
    "effort_at",
    "electric_available_n",
    "emergency_jerk_mps3",
    "felt_slopes",
    "grid",
    "heads_m",
    "locate",
    "map_value",
    "multibody_step",
    "namespace",
    "padded_size",
    "pushed",
    "resistance_and_gradient",
    "restrictive_profile",
    "rollout",
    "rollout_batch",
    "scalars",
    "spread",
    "stack",
    "step",
    "step_energy",
    "substeps",
    "to_jax",
    "track_arrays",
    "traction_available_n",
    "unless",
    "vehicle_arrays",
]
