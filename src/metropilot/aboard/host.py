"""A driver of the host traced for sections: ``init`` runs in Python, ``act`` becomes a graph.

What ``act`` changes in the memory is found by running it: every entry that comes back otherwise than it went
in is a state between two periods, all others are constants.
"""

from __future__ import annotations

import sys
from collections import namedtuple
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from metropilot.aboard.branching import BranchTracer, Symbol
from metropilot.aboard.graph import Graph, drop_unused
from metropilot.env import SectionRows
from metropilot.errors import InputError
from metropilot.railway import Section, Trainset
from metropilot.sim import AbstractDriver, Observation, Run

PACKAGES = ("physics", "protection", "planning", "control", "env", "policy", "drivers", "studies")
"""Packages whose functions a driver runs in a period."""
KEPT = Run | Section | Trainset
"""What is in a memory for reference only."""

Entry = tuple[str, ...]
"""Place of a number or array in a memory."""


class HostGraphs(NamedTuple):
    """Decisions of a driver of the host, one graph a section.

    Attributes:
        decide: From time, position, speed, acceleration, scheduled running time, the level of protection's
            last intervention, and the memory to a command and the next memory.
        memory: Memory at departure: those entries that change on the way.
    """

    decide: tuple[Graph, ...]
    memory: Any


def trace_host(driver: AbstractDriver, runs: Sequence[Run], dtype: type) -> HostGraphs:
    """Trace a driver.

    Args:
        driver: The driver, in the form that it has aboard.
        runs: A run over each of the sections.
        dtype: Number type.

    Raises:
        InputError: Something in it has no form in C.
    """
    traced = [_Trace(driver, run, dtype) for run in runs]
    entries = sorted(set().union(*(each.trace(()) for each in traced)))
    while any(set(each.trace(entries)) - set(entries) for each in traced):
        entries = sorted(set(entries).union(*(each.changing for each in traced)))
    values = [[each.departure(entry) for entry in entries] for each in traced]
    for each in values[1:]:
        if not all(np.array_equal(a, b) for a, b in zip(each, values[0], strict=True)):
            raise InputError("the driver departs with another memory on each section", field="sections")
    names = ["_".join(entry) for entry in entries]
    memory = namedtuple("HostMemory", names)
    return HostGraphs(tuple(each.graph(entries) for each in traced), memory(*values[0]))


class _Trace:
    """Trace of one section."""

    def __init__(self, driver: AbstractDriver, run: Run, dtype: type) -> None:
        self.driver, self.run = driver, run
        self.tracer = tracer = BranchTracer(dtype)
        driver.read_policy()
        self.start = driver.init(run)
        self.lifted = _lift(tracer, self.start)
        self.measured = [tracer.input((), np.dtype(np.float64), k) for k in range(5)]
        self.level = tracer.input((), np.dtype(np.int32), 5)
        # first of all, so that a memory can be written as soon as it is computed
        self.known = tracer.apply("isfinite", self.measured[0])
        for each in self.measured[1:]:
            self.known = self.known & tracer.apply("isfinite", each)
        self.changing: dict[Entry, Symbol] = {}
        self.share: Any = None
        self.after: Any = None

    def trace(self, entries: Sequence[Entry]) -> list[Entry]:
        """Run the driver until no entry changes but those that are symbols; returns those."""
        time_s, position_m, speed_mps, acceleration_mps2, scheduled_s = self.measured
        observation = Observation(
            time_s=time_s,  # pyright: ignore[reportArgumentType]
            position_m=position_m,  # pyright: ignore[reportArgumentType]
            speed_mps=speed_mps,  # pyright: ignore[reportArgumentType]
            acceleration_mps2=acceleration_mps2,  # pyright: ignore[reportArgumentType]
            scheduled_time_s=scheduled_s,  # pyright: ignore[reportArgumentType]
            permitted_mps=np.nan,
            section=self.run.section,
            intervention=self.level,  # pyright: ignore[reportArgumentType]
        )
        wanted = set(entries)
        with self.tracer.apply_to(_modules()):
            while self.share is None or wanted - set(self.changing):
                for entry in sorted(wanted - set(self.changing)):
                    value = self.departure(entry)
                    self.changing[entry] = self.tracer.input(value.shape, value.dtype, 0)
                before = _set(self.lifted, self.changing)
                try:
                    self.share, self.after = self.tracer.run(
                        lambda memory=before: self.driver.act(memory, observation), "act"
                    )
                except (TypeError, AttributeError, NotImplementedError) as error:
                    words = "the driver does something that has no form in C"
                    raise InputError(words, field="export", value=str(error)[:120]) from error
                wanted |= set(_changes(before, self.after))
        return sorted(self.changing)

    def departure(self, entry: Entry) -> np.ndarray:
        """An entry of the memory at departure."""
        value = np.asarray(_get(self.start, entry))
        return value.astype(np.int32) if value.dtype.kind in "iu" else value

    def graph(self, entries: Sequence[Entry]) -> Graph:
        """The graph; where a measurement is not finite the memory stays, and the command is not a number."""
        tracer, known = self.tracer, self.known
        symbols = [self.changing[entry] for entry in entries]
        results = [tracer.select(known.node, self.share, np.nan)]
        for entry, before in zip(entries, symbols, strict=True):
            after = _get(self.after, entry)
            after = after if isinstance(after, Symbol) else tracer.constant(after)
            if before.dtype.kind != "f" and after.dtype != before.dtype:
                raise InputError(
                    "a memory that changes its type has no form in C", field="export", value=entry[-1]
                )
            results.append(tracer.select(known.node, after, before))
        inputs = [each.node for each in (*self.measured, self.level, *symbols)]
        outputs = [each.node for each in results]
        return Graph(inputs, outputs, drop_unused(tracer.nodes, outputs))


def _modules() -> list[ModuleType]:
    """Modules with the functions of drivers, those that are loaded."""
    begins = tuple(f"metropilot.{package}." for package in PACKAGES)
    return [module for name, module in sorted(sys.modules.items()) if name.startswith(begins)]


def _lift(tracer: BranchTracer, tree: Any) -> Any:  # noqa: ANN401 (a memory)
    """A memory whose arrays, and lists of numbers, may be looked up at places known only aboard."""
    if isinstance(tree, tuple):
        parts = [_lift(tracer, each) for each in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if isinstance(tree, np.ndarray | list) and np.ndim(tree) and np.asarray(tree).dtype.kind in "fiub":
        return tracer.constant(tree)
    if isinstance(tree, SectionRows):
        found = copy(tree)
        vars(found).update(
            (name, _lift(tracer, value)) for name, value in vars(tree).items() if name != "tables"
        )
        return found
    if is_dataclass(tree) and not isinstance(tree, type | KEPT):
        found = copy(tree)
        for each in fields(tree):
            object.__setattr__(found, each.name, _lift(tracer, getattr(tree, each.name)))
        return found
    return tree


def _get(tree: Any, entry: Entry) -> Any:  # noqa: ANN401 (a memory)
    for name in entry:
        tree = tree[int(name)] if name.isdigit() else getattr(tree, name)
    return tree


def _set(tree: Any, values: dict[Entry, Symbol], at: Entry = ()) -> Any:  # noqa: ANN401 (a memory)
    """A memory with some of its entries replaced."""
    if at in values:
        return values[at]
    if isinstance(tree, tuple):
        parts = [_set(each, values, (*at, name)) for name, each in zip(_names(tree), tree, strict=True)]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return tree


def _names(tree: tuple[Any, ...]) -> Sequence[str]:
    return getattr(tree, "_fields", None) or [str(k) for k in range(len(tree))]


def _changes(before: Any, after: Any, at: Entry = ()) -> Iterator[Entry]:  # noqa: ANN401 (memories)
    """Entries that are not the same in both."""
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        for name, a, b in zip(_names(before), before, after, strict=True):
            yield from _changes(a, b, (*at, name))
    elif isinstance(before, Symbol) and isinstance(after, Symbol):
        if before.node is not after.node:
            yield at
    elif before is not after and (isinstance(after, Symbol) or before != after):
        yield at
