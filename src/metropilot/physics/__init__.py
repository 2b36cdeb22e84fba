"""The plant: pure functions for one trainset over an array namespace (NumPy or JAX)."""

from metropilot.physics.arrays import to_jax
from metropilot.physics.build import padded_size, restrictive_profile, track_arrays, vehicle_arrays
from metropilot.physics.effort import (
    brake_available_n,
    command_for_force,
    command_force_n,
    electric_available_n,
    traction_available_n,
)
from metropilot.physics.energy import step_energy
from metropilot.physics.integrators import INTEGRATORS
from metropilot.physics.plant import Command, at_rest, delay_steps, step
from metropilot.physics.resistance import davis_n, resistance_and_gradient
from metropilot.physics.types import Forces, State, Track, Vehicle

__all__ = [
    "INTEGRATORS",
    "Command",
    "Forces",
    "State",
    "Track",
    "Vehicle",
    "at_rest",
    "brake_available_n",
    "command_for_force",
    "command_force_n",
    "davis_n",
    "delay_steps",
    "electric_available_n",
    "padded_size",
    "resistance_and_gradient",
    "restrictive_profile",
    "step",
    "step_energy",
    "to_jax",
    "track_arrays",
    "traction_available_n",
    "vehicle_arrays",
]
