"""Generated sources compiled and called from Python: for comparison, and for a simulator in the loop."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from metropilot.aboard.program import NUMBERS, AboardProgram
from metropilot.aboard.source import identifier
from metropilot.errors import InputError
from metropilot.physics import Command, at_rest, delay_steps, track_arrays, vehicle_arrays
from metropilot.railway import Section
from metropilot.sim import (
    RUNNING,
    OutcomeRule,
    RunParams,
    RunState,
    control_period,
    first_state,
)

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-ffp-contract=off")
"""Options under which a generated source compiles without a warning."""
C_TYPES: Mapping[str, Any] = MappingProxyType(
    {
        "float64": ctypes.c_double,
        "float32": ctypes.c_float,
        "int32": ctypes.c_int32,
        "bool": ctypes.c_bool,
    }
)


class Supervised(NamedTuple):
    """Answer of a compiled driver in one control period; see the header."""

    share: float
    emergency: bool
    level: int
    permitted_mps: float
    emergency_mps: float
    valid: bool


class CompiledDriver:
    """A compiled driver with one state.

    Args:
        program: The driver.
        path: Shared library of its source.
    """

    def __init__(self, program: AboardProgram, path: Path) -> None:
        self.program = program
        self.library = ctypes.CDLL(str(path))
        name, self.number = identifier(program.name), np.dtype(NUMBERS[program.number])
        real = C_TYPES[self.number.name]
        self.state_type = _structure(
            section=ctypes.c_int32,
            policy=self._members(program.memory.policy),
            protection=self._members(program.memory.supervision),
        )
        measured = ("time_s", "position_m", "speed_mps", "acceleration_mps2", "scheduled_s")
        self.input_type = _structure(**dict.fromkeys(measured, real))
        self.output_type = _structure(
            share=real,
            emergency=ctypes.c_bool,
            level=ctypes.c_int32,
            permitted_mps=real,
            emergency_mps=real,
            valid=ctypes.c_bool,
        )
        self.state, self.input, self.output = self.state_type(), self.input_type(), self.output_type()
        pointers = [ctypes.POINTER(each) for each in (self.state_type, self.input_type, self.output_type)]
        self._init = getattr(self.library, f"{name}_init")
        self._step = getattr(self.library, f"{name}_step")
        self._supervise = getattr(self.library, f"{name}_supervise")
        self._init.argtypes, self._init.restype = [pointers[0], ctypes.c_int32], ctypes.c_int
        self._step.argtypes, self._step.restype = pointers, None
        self._supervise.argtypes = [*pointers[:2], real, ctypes.c_bool, pointers[2]]
        self._supervise.restype = None

    def _members(self, tree: Any) -> Any:  # noqa: ANN401 (a NamedTuple of arrays)
        members = {}
        for name, value in tree._asdict().items():
            kind = np.asarray(value).dtype
            each = C_TYPES[self.number.name if kind.kind == "f" else kind.name]
            members[name] = each * np.size(value) if np.ndim(value) else each
        return _structure(**members)

    def init(self, section: int) -> None:
        """State at departure.

        Raises:
            InputError: There is no such section.
        """
        if self._init(self.state, section) != 0:
            allowed = f"0 to {len(self.program.sections) - 1}"
            raise InputError("no such section", field="section", value=section, allowed=allowed)

    def step(
        self,
        time_s: float,
        position_m: float,
        speed_mps: float,
        acceleration_mps2: float,
        scheduled_s: float,
    ) -> Supervised:
        """One control period: the driver decides, protection has the last word."""
        self._measure(time_s, position_m, speed_mps, acceleration_mps2, scheduled_s)
        self._step(self.state, self.input, self.output)
        return self._answer()

    def supervise(
        self, position_m: float, speed_mps: float, share: float, *, emergency: bool = False
    ) -> Supervised:
        """One control period by hand: protection alone."""
        self._measure(0.0, position_m, speed_mps, 0.0, 0.0)
        self._supervise(self.state, self.input, share, emergency, self.output)
        return self._answer()

    def _measure(self, *values: float) -> None:
        for (name, _), value in zip(self.input_type._fields_, values, strict=True):
            setattr(self.input, name, value)

    def _answer(self) -> Supervised:
        return Supervised(*(getattr(self.output, name) for name in Supervised._fields))


def _structure(**members: Any) -> Any:  # noqa: ANN401 (a type of ctypes)
    return type("Structure", (ctypes.Structure,), {"_fields_": list(members.items())})


def compile_driver(
    program: AboardProgram,
    folder: Path,
    *,
    compiler: Sequence[str] = ("cc",),
    options: Sequence[str] = ("-O2",),
) -> CompiledDriver:
    """Compile the source of a folder into a shared library beside it, and load it.

    Args:
        program: The driver whose folder it is.
        folder: Folder that :func:`write_driver` wrote.
        compiler: Command of the compiler.
        options: Options besides ``STRICT``.

    Raises:
        InputError: There is no compiler, or it refuses the source.
    """
    name = identifier(program.name)
    library = folder / f"{name}.so"
    command = [*compiler, *STRICT, *options, "-shared", "-fPIC", f"{name}.c", "-lm", "-o", library.name]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise InputError("no compiler", value=compiler[0], allowed=str(error.strerror)) from None
    if done.returncode:
        raise InputError(
            "the compiler refuses the source", file=folder / f"{name}.c", value=done.stderr[:200]
        )
    return CompiledDriver(program, library)


class DrivenRun(NamedTuple):
    """A run driven by a compiled driver.

    Attributes:
        states: State at the end of each control period.
        supervised: Answer of the driver in each.
    """

    states: tuple[RunState, ...]
    supervised: tuple[Supervised, ...]


def drive_compiled(driver: CompiledDriver, number: int, scheduled_s: float) -> DrivenRun:
    """Drive a section with a compiled driver, its own protection included, on the nominal plant of Python.

    Args:
        driver: The driver.
        number: Number of the section.
        scheduled_s: Scheduled running time.
    """
    program = driver.program
    section: Section = program.sections[number]
    vehicle, dt = vehicle_arrays(program.trainset), program.bounds.dt_s
    params = RunParams(
        vehicle=vehicle,
        track=track_arrays(section, program.trainset),
        protection=None,
        length_m=section.length_m,
        scheduled_s=scheduled_s,
        speed_noise_mps=0.0,
        dt=dt,
    )
    driver.init(number)
    supervised: list[Supervised] = []

    def decide(memory: None, state: RunState) -> tuple[Command, None]:
        plant = state.plant
        answer = driver.step(
            time_s=float(plant.time_s),
            position_m=float(plant.position_m),
            speed_mps=float(state.measured_mps),
            acceleration_mps2=float(plant.acceleration_mps2),
            scheduled_s=scheduled_s,
        )
        supervised.append(answer)
        return Command(supervised[-1].share, supervised[-1].emergency), memory

    state = first_state(at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), dt)), None)
    states = []
    while state.outcome == RUNNING:
        state, _, _ = control_period(params, state, None, decide, rule=OutcomeRule())
        states.append(state)
    return DrivenRun(tuple(states), tuple(supervised))
