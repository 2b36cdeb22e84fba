"""Graph of a traced function: calls inlined, constants folded, equal operations shared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from metropilot.errors import InputError

CALLS = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "custom_vmap_call"}
"""Primitives that only call another traced function; which one, is in a parameter of one of these names."""
CALLED = ("jaxpr", "call_jaxpr", "call")
UNCHANGED: Mapping[str, tuple[float | bool, bool | None]] = MappingProxyType(
    {"and": (True, False), "or": (False, True), "mul": (1.0, None), "div": (1.0, None)}
)
"""Operand that leaves the other as it is, and one that decides alone. (A sum with 0 turns -0 into 0.)"""
ONE_SIDED = {"div"}
"""Operations of which only the second operand may be the one that leaves the other."""
SAME = {"copy", "copy_p", "stop_gradient", "optimization_barrier"}


@dataclass(eq=False, repr=False)
class Operation:
    """One operation and its result.

    Attributes:
        op: Name of the JAX primitive, or ``input``, ``const``, ``cond``, ``loop``, ``call``, ``result``.
        args: Operands.
        shape: Shape of the result.
        dtype: Number type of the result.
        params: Parameters of the primitive; of ``const`` the value, of ``cond`` the branches, of ``loop`` the
            number of rounds, the inputs of one, and what it computes, of ``call`` the function's graph.
    """

    op: str
    args: tuple[Operation, ...]
    shape: tuple[int, ...]
    dtype: np.dtype
    params: dict[str, Any] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of entries."""
        return prod(self.shape)


class Branch(NamedTuple):
    """One side of a ``cond`` or a round of a ``loop``: the operations that only it needs, and its results."""

    nodes: list[Operation]
    results: list[Operation]


class Graph(NamedTuple):
    """A traced function as operations in order.

    Attributes:
        inputs: Arguments, flattened.
        outputs: Results, flattened.
        nodes: Operations that the results need, each after its operands.
    """

    inputs: list[Operation]
    outputs: list[Operation]
    nodes: list[Operation]


def trace_graph(function: Callable[..., Any], *arguments: Any) -> Graph:  # noqa: ANN401 (trees of arrays)
    """Trace a function of JAX arrays.

    Args:
        function: The function; what it closes over becomes constants.
        arguments: Arguments of the shapes and number types to trace with.

    Raises:
        InputError: It does something that has no graph, as a loop whose end depends on its data.
    """
    import jax

    closed = jax.make_jaxpr(function)(*arguments)
    builder = Builder()
    inputs = [
        Operation("input", (), tuple(v.aval.shape), np.dtype(v.aval.dtype), {"number": k})
        for k, v in enumerate(closed.jaxpr.invars)
    ]
    outputs = builder.inline(closed.jaxpr, closed.consts, inputs)
    return Graph(inputs, outputs, drop_unused(builder.scopes[0].nodes, outputs))


class Scope:
    """Operations of the function or of a branch, and which of them are known."""

    def __init__(self) -> None:
        self.nodes: list[Operation] = []
        self.known: dict[Any, Operation] = {}


class Builder:
    """Interpreter of a jaxpr that builds the graph."""

    def __init__(self) -> None:
        self.scopes = [Scope()]
        self.constants: dict[Any, Operation] = {}

    def constant(self, value: Any) -> Operation:  # noqa: ANN401 (a number or an array)
        """A constant, the known one where there is an equal one."""
        array = np.asarray(value)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self.constants:
            self.constants[key] = Operation("const", (), array.shape, array.dtype, {"value": array})
        return self.constants[key]

    def inline(self, jaxpr: Any, consts: Sequence[Any], given: Sequence[Operation]) -> list[Operation]:  # noqa: ANN401
        """Add the operations of a jaxpr; returns its results."""
        known: dict[Any, Operation] = dict(zip(jaxpr.invars, given, strict=True))
        known |= {var: self.constant(value) for var, value in zip(jaxpr.constvars, consts, strict=True)}

        def read(var: Any) -> Operation:  # noqa: ANN401 (a variable or a literal)
            if hasattr(var, "val"):
                return self.constant(np.asarray(var.val, var.aval.dtype))
            return known[var]

        for equation in jaxpr.eqns:
            results = self.add(equation, [read(var) for var in equation.invars])
            known |= dict(zip(equation.outvars, results, strict=True))
        return [read(var) for var in jaxpr.outvars]

    def add(self, equation: Any, given: list[Operation]) -> list[Operation]:  # noqa: ANN401 (an equation)
        """Results of one equation."""
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            called = next(params[key] for key in CALLED if key in params)
            return self.inline(called.jaxpr, called.consts, given)
        if name in SAME:
            return given
        if all(node.op == "const" for node in given):
            found = equation.primitive.bind(*(node.params["value"] for node in given), **params)
            return [self.constant(v) for v in (found if equation.primitive.multiple_results else [found])]
        if name == "cond":
            return self.branch(params["branches"], given)
        if equation.primitive.multiple_results:
            raise InputError(f"the driver needs the operation {name}, which has no form in C", field="to")
        aval = equation.outvars[0].aval
        if name in {"dynamic_slice", "gather"} and is_uniform(given[0]):
            return [self.constant(np.full(aval.shape, given[0].params["value"].flat[0], aval.dtype))]
        if name == "dynamic_slice":
            given = self.narrow(given, params["slice_sizes"])
        return [self.node(name, tuple(given), tuple(aval.shape), np.dtype(aval.dtype), params)]

    def narrow(self, given: list[Operation], sizes: Sequence[int]) -> list[Operation]:
        """Operands of a slice, without a start that has no choice, nor columns that it cannot reach."""
        array, *starts = given
        zero = self.constant(np.int32(0))
        choices = zip(starts, array.shape, sizes, strict=True)
        starts = [zero if whole == size else first for first, whole, size in choices]
        if array.op != "const":
            return [array, *starts]
        value = array.params["value"]
        for axis, (first, size) in enumerate(zip(starts, sizes, strict=True)):
            if first.op == "const" and size < value.shape[axis]:
                begin = int(np.clip(first.params["value"], 0, value.shape[axis] - size))
                value = np.take(value, np.arange(begin, begin + size), axis)
                starts[axis] = zero
        return [self.constant(value), *starts]

    def node(
        self,
        op: str,
        args: tuple[Operation, ...],
        shape: tuple[int, ...],
        dtype: np.dtype,
        params: dict[str, Any],
    ) -> Operation:
        """A node, the known one where there is an equal one."""
        if op == "convert_element_type" and args[0].dtype == dtype:
            return args[0]
        if (same := _same(op, args)) is not None and same.shape == shape:
            return same
        key = (op, tuple(map(id, args)), shape, dtype.str, repr(sorted(params.items())))
        for scope in self.scopes:
            if key in scope.known:
                return scope.known[key]
        made = Operation(op, args, shape, dtype, params)
        self.scopes[-1].nodes.append(made)
        self.scopes[-1].known[key] = made
        return made

    def branch(self, branches: Sequence[Any], given: list[Operation]) -> list[Operation]:
        """Results of a ``cond``."""
        index, rest = given[0], given[1:]
        sides = []
        for side in branches:
            self.open_scope()
            results = self.inline(side.jaxpr, side.consts, rest)
            sides.append(Branch(drop_unused(self.close_scope().nodes, results), results))
        return self.choice(index, sides)

    def open_scope(self, scope: Scope | None = None) -> None:
        """Begin the operations of a branch, or go on with them."""
        self.scopes.append(scope or Scope())

    def close_scope(self) -> Scope:
        """End them; returns them."""
        return self.scopes.pop()

    def choice(self, index: Operation, sides: list[Branch]) -> list[Operation]:
        """Results of the branch of a number."""
        if any(result.size != 1 for side in sides for result in side.results):
            raise InputError("the driver chooses between arrays, which has no form in C", field="to")
        return self.results(Operation("cond", (index,), (), np.dtype(np.int32), {"sides": sides}))

    def loop(
        self, count: int, first: Sequence[Operation], carried: list[Operation], body: Branch
    ) -> list[Operation]:
        """Results of some rounds.

        Args:
            count: Number of rounds.
            first: Numbers at the beginning.
            carried: Inputs that stand for them in a round.
            body: The round; its results are the inputs of the next.
        """
        params = {"count": count, "carried": carried, "sides": [body]}
        return self.results(Operation("loop", tuple(first), (), np.dtype(np.int32), params))

    def call(self, function: Graph, given: Sequence[Operation]) -> list[Operation]:
        """Results of a function that other calls share; its arguments and results are single numbers."""
        params = {"function": function}
        return self.results(Operation("call", tuple(given), (), np.dtype(np.int32), params), function.outputs)

    def results(self, made: Operation, ends: Sequence[Operation] | None = None) -> list[Operation]:
        """Add an operation with sides, or with other ends; returns its results."""
        self.scopes[-1].nodes.append(made)
        picked = [
            Operation("result", (made,), result.shape, result.dtype, {"number": k})
            for k, result in enumerate(made.params["sides"][0].results if ends is None else ends)
        ]
        self.scopes[-1].nodes += picked
        return picked


def operands(node: Operation) -> list[Operation]:
    """Operands of a node; those of a ``cond`` or ``loop`` include what its sides take from outside."""
    outside = list(node.args)
    for side in node.params.get("sides", ()):
        inside = {*map(id, side.nodes), *map(id, node.params.get("carried", ()))}
        used = [*side.results, *(each for inner in side.nodes for each in operands(inner))]
        outside += [each for each in used if id(each) not in inside]
    return outside


def is_uniform(node: Operation) -> bool:
    """Tell if a node is a constant of which all entries have the same bits."""
    if node.op != "const" or node.size == 0:
        return False
    value = node.params["value"]
    return value.tobytes() == value.flat[0].tobytes() * value.size


def _same(op: str, args: tuple[Operation, ...]) -> Operation | None:
    """The operand that an operation gives back whatever the others are, to the last bit; None: none."""
    if op == "select_n" and is_uniform(args[0]):
        return args[1 + int(args[0].params["value"].flat[0])]
    if op not in UNCHANGED:
        return None
    neutral, final = UNCHANGED[op]
    for each, other in (args, args[::-1]):
        if is_uniform(each) and (each is args[1] or op not in ONE_SIDED):
            value = each.params["value"].flat[0]
            if value.dtype.kind in ("f" if final is None else "b"):
                if value == neutral:
                    return other
                if final is not None and value == final:
                    return each
    return None


def drop_unused(nodes: Sequence[Operation], results: Sequence[Operation]) -> list[Operation]:
    """The nodes that the results need, in order."""
    wanted, kept = set(map(id, results)), []
    for node in reversed(nodes):
        if id(node) in wanted:
            kept.append(node)
            wanted |= set(map(id, operands(node)))
    return kept[::-1]
