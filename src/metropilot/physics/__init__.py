"""The plant: pure functions for one trainset over an array namespace (NumPy or JAX)."""

from metropilot.physics.arrays import to_jax
from metropilot.physics.batch import (
    batch_size,
    double_precision,
    grid,
    rollout,
    rollout_batch,
    spread,
    stack,
)
from metropilot.physics.build import padded_size, restrictive_profile, track_arrays, vehicle_arrays
from metropilot.physics.deceleration import controlled
from metropilot.physics.effort import (
    brake_available_n,
    command_for_force,
    command_force_n,
    electric_available_n,
    traction_available_n,
)
from metropilot.physics.energy import step_energy
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
from metropilot.physics.plant import Command, at_rest, delay_steps, step
from metropilot.physics.resistance import davis_n, resistance_and_gradient
from metropilot.physics.types import Forces, State, Track, Vehicle

__all__ = [
    "INTEGRATORS",
    "Bodies",
    "Command",
    "Consist",
    "Forces",
    "State",
    "Track",
    "Vehicle",
    "at_rest",
    "batch_size",
    "bodies_at",
    "brake_available_n",
    "centre_of_mass_m",
    "command_for_force",
    "command_force_n",
    "consist",
    "controlled",
    "davis_n",
    "delay_steps",
    "double_precision",
    "electric_available_n",
    "grid",
    "heads_m",
    "multibody_step",
    "padded_size",
    "resistance_and_gradient",
    "restrictive_profile",
    "rollout",
    "rollout_batch",
    "spread",
    "stack",
    "step",
    "step_energy",
    "substeps",
    "to_jax",
    "track_arrays",
    "traction_available_n",
    "vehicle_arrays",
]
