"""Graph of a Python function with branches: it runs on symbols, and once for each way that it can take.

:func:`metropilot.aboard.graph.trace_graph` lets JAX trace a function that is written over an array namespace.
A driver on the host is plain Python: ``if``, ``min``, lists, NumPy. Here its numbers are :class:`Symbol`,
which answer NumPy's protocols (NEP 13 and 18) and make operations of the same graph. Where one is asked for
its truth value, the function that asks is run for both answers and their results are joined by a choice; so
every call of a function is a place where ways come together again, and their number stays small.

The functions themselves are those that Python runs. While they are traced their modules see other ``min``,
``max``, ``int``, ``float`` and ``math``, which know symbols, and calls that join.
"""

from __future__ import annotations

import builtins
import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial, wraps
from math import prod
from numbers import Integral
from types import FunctionType, MappingProxyType, ModuleType
from typing import Any, cast

import numpy as np

from metropilot.aboard.graph import Branch, Builder, Graph, Operation, Scope, drop_unused, operands
from metropilot.errors import InputError
from metropilot.physics import NAMESPACES, scalars

LAZY = frozenset({"largest_admissible_command"})
"""Functions of which only the way taken is computed: seldom the long one."""
SHARED: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"supervise": (0,), "admits_braking": (0,), "required_with_build_up": (5,)}
)
"""Functions that are functions in C too, written once for all calls, and which arguments are constants."""
MOST_ENTRIES = 16
"""Entries of an array that may be an argument or a result of one of them."""
MOST_QUESTIONS = 14
"""Branches that one way through a function may have; its ways are up to two to this power."""
UNTOUCHED = frozenset({"_replace", "_make", "_asdict"})


class Undecided(Exception):
    """A symbol was asked for its truth value."""

    def __init__(self, node: Operation) -> None:
        super().__init__("undecided")
        self.node = node


class Symbol:
    """Number or array that is known only aboard.

    Args:
        tracer: What it belongs to.
        node: Operation whose result it is.
    """

    __slots__ = ("node", "tracer")

    def __init__(self, tracer: BranchTracer, node: Operation) -> None:
        self.tracer, self.node = tracer, node

    # ------------------------------------------------------------------------------------------ what it is
    @property
    def shape(self) -> tuple[int, ...]:
        """Shape."""
        return self.node.shape

    @property
    def dtype(self) -> np.dtype:
        """Number type."""
        return self.node.dtype

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.node.shape)

    @property
    def size(self) -> int:
        """Number of entries."""
        return self.node.size

    def __len__(self) -> int:
        return self.node.shape[0]

    def __iter__(self) -> Iterator[Symbol]:
        return (self[k] for k in range(len(self)))

    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        if self.node.op == "const":
            return bool(self.node.params["value"])
        return self.tracer.decide(self.node)

    def tolist(self) -> Symbol:
        """Itself, which answers where a list would."""
        return self

    def item(self) -> Symbol:
        """Itself."""
        return self

    def copy(self) -> Symbol:
        """Another symbol of the same operation, to be changed by itself."""
        return Symbol(self.tracer, self.node)

    def astype(self, dtype: Any, copy: bool = True) -> Symbol:  # noqa: ANN401, ARG002 (NumPy's)
        """The same in another number type; of those of floats single precision, or the graph's."""
        kind = np.dtype(dtype).kind
        found = self.tracer.number if kind == "f" and np.dtype(dtype) != np.float32 else np.dtype(dtype)
        return self.tracer.apply("astype", self, np.dtype(np.int32) if kind in "iu" else found)

    def __getitem__(self, index: Any) -> Symbol:  # noqa: ANN401 (as NumPy's)
        parts = index if isinstance(index, tuple) else (index,)
        found: Symbol = self
        if not any(isinstance(part, Symbol) for part in parts):
            return self.tracer.call(("static", repr(index)), lambda x: x[index], self)
        places = [part for part in parts if isinstance(part, Symbol)]
        if any(part is None or part is Ellipsis for part in parts):
            words = "the driver looks up arrays in a way that has no form in C"
            raise InputError(words, field="export", value=str(parts))
        # a constant index from the end is known here; one that is known only aboard is never negative
        kept = tuple(
            None
            if isinstance(part, Symbol)
            else part + size
            if isinstance(part, Integral) and part < 0
            else part
            for part, size in zip(parts, self.shape, strict=False)
        )

        def look_up(x: Any, *given: Any) -> Any:  # noqa: ANN401 (arrays)
            rest = iter(given)
            where = tuple(next(rest) if part is None else part for part in kept)
            return x.at[where].get(mode="clip", wrap_negative_indices=False)

        return self.tracer.call(("dynamic", repr(kept)), look_up, found, *places)

    def __setitem__(self, index: Any, value: Any) -> None:  # noqa: ANN401 (as NumPy's)
        if not isinstance(index, int | slice):
            raise InputError("the driver changes entries in a way that has no form in C", field="to")
        rows = range(len(self))[index] if isinstance(index, slice) else [range(len(self))[index]]

        def put(x: Any, y: Any) -> Any:  # noqa: ANN401 (arrays)
            import jax.numpy as jnp

            y = jnp.broadcast_to(y, (len(rows), *x.shape[1:])).astype(x.dtype)
            return jnp.concatenate([x[: rows[0]], y, x[rows[-1] + 1 :]])

        self.node = self.tracer.call(("put", repr(index)), put, self, value).node

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 (a method of arrays)
        if name.startswith("_"):
            raise AttributeError(name)
        return partial(self.tracer.apply, name, self)

    # --------------------------------------------------------------------------------------- what it answers
    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **options: Any) -> Any:  # noqa: ANN401
        if method == "accumulate":
            return self.tracer.accumulate(ufunc, given[0])
        if method != "__call__" or options:
            return NotImplemented
        return self.tracer.apply(ufunc.__name__, *given)

    def __array_function__(self, function: Any, types: Any, given: Any, options: Any) -> Any:  # noqa: ANN401
        return self.tracer.apply(function.__name__, *given, **options)

    def __round__(self, digits: int | None = None) -> Symbol:
        return self.tracer.apply("round", self)

    def __pow__(self, power: float) -> Symbol:
        return self.tracer.apply("sqrt", self) if power == 0.5 else self.tracer.apply("power", self, power)


def _operator(name: str, *, turned: bool = False) -> Callable[..., Any]:
    def operate(self: Symbol, *other: Any) -> Any:  # noqa: ANN401 (a number)
        return self.tracer.apply(name, *((*other, self) if turned else (self, *other)))

    return operate


BINARY = {
    "add": "add",
    "sub": "subtract",
    "mul": "multiply",
    "truediv": "divide",
    "floordiv": "floor_divide",
    "mod": "remainder",
    "matmul": "matmul",
    "and": "logical_and",
    "or": "logical_or",
    "xor": "logical_xor",
}
COMPARED = {
    "lt": "less",
    "le": "less_equal",
    "gt": "greater",
    "ge": "greater_equal",
    "eq": "equal",
    "ne": "not_equal",
}
UNARY = {"neg": "negative", "abs": "abs", "invert": "logical_not"}
for _python, _numpy in {**BINARY, **COMPARED, **UNARY}.items():
    setattr(Symbol, f"__{_python}__", _operator(_numpy))
    if _python in BINARY:
        setattr(Symbol, f"__r{_python}__", _operator(_numpy, turned=True))


class _Namespace:
    """Array namespace of symbols; what no symbol is in, is computed as on the host."""

    ndarray = Symbol

    def __init__(self, tracer: BranchTracer) -> None:
        self.tracer = tracer

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(self.tracer.apply, name)


class BranchTracer:
    """Tracer of one function.

    Args:
        number: Number type of the graph, float64 or float32.
    """

    def __init__(self, number: Any) -> None:  # noqa: ANN401 (a dtype)
        self.number = np.dtype(number)
        self.builder = Builder()
        self.programs: dict[Any, Any] = {}
        self.known: list[dict[int, bool]] = [{}]
        self.shared: dict[Any, Any] = {}
        """Functions that calls share: graph, numbers used, answer."""
        self.alive: list[Any] = []
        """What is known by its ``id``, so that none is given anew."""
        NAMESPACES[Symbol] = _Namespace(self)

    @property
    def nodes(self) -> list[Operation]:
        """All operations."""
        return self.builder.scopes[0].nodes

    def input(self, shape: tuple[int, ...], dtype: np.dtype, number: int) -> Symbol:
        """An argument of the traced function."""
        kind = self.number if dtype.kind == "f" else np.dtype(np.int32) if dtype.kind in "iu" else dtype
        return Symbol(self, Operation("input", (), shape, kind, {"number": number}))

    def constant(self, value: Any) -> Symbol:  # noqa: ANN401 (an array or a number)
        """A constant."""
        array = np.asarray(value)
        if array.dtype.kind == "f" and array.dtype != np.float32:
            array = array.astype(self.number)
        elif array.dtype.kind in "iu":
            array = array.astype(np.int32)
        return Symbol(self, self.builder.constant(array))

    # ------------------------------------------------------------------------------------------- operations
    def apply(self, name: str, *given: Any, **options: Any) -> Any:  # noqa: ANN401 (symbols and numbers)
        """A function of NumPy by its name."""
        if not any(isinstance(each, Symbol) for each in _leaves((given, tuple(options.values())))):
            single = hasattr(scalars, name) and not any(map(np.ndim, given))
            return getattr(scalars if single else np, name)(*given, **options)
        if name in {"ndim", "size", "shape"}:
            return getattr(given[0], name)
        inputs: list[Any] = []

        def take(each: Any) -> Any:  # noqa: ANN401 (an argument)
            if isinstance(each, Symbol | np.ndarray):
                inputs.append(each)
                return _Hole(len(inputs) - 1)
            if isinstance(each, np.generic):
                return each.item()
            if isinstance(each, list | tuple):
                return type(each)(map(take, each))
            return each

        form = take(given)
        shape = {key: take(value) for key, value in options.items()}

        def compute(*arrays: Any) -> Any:  # noqa: ANN401 (arrays)
            def fill(each: Any) -> Any:  # noqa: ANN401 (an argument)
                if isinstance(each, _Hole):
                    return arrays[each.number]
                return type(each)(map(fill, each)) if isinstance(each, list | tuple) else each

            return _function(name)(*fill(form), **{key: fill(value) for key, value in shape.items()})

        return self.call((name, repr(form), repr(shape)), compute, *inputs)

    def call(self, key: Any, function: Callable[..., Any], *given: Any) -> Symbol:  # noqa: ANN401 (a key)
        """A function of JAX arrays, as the operations that it consists of."""
        import jax

        nodes = [(each if isinstance(each, Symbol) else self.constant(each)).node for each in given]
        whole = key, tuple((node.shape, node.dtype.str) for node in nodes)
        if whole not in self.programs:
            forms = [jax.ShapeDtypeStruct(node.shape, node.dtype) for node in nodes]
            with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
                self.programs[whole] = jax.make_jaxpr(function)(*forms)
        closed = self.programs[whole]
        (found,) = self.builder.inline(closed.jaxpr, closed.consts, nodes)
        return Symbol(self, found)

    def accumulate(self, ufunc: np.ufunc, values: Symbol) -> Symbol:
        """Running result of a function of two numbers along the last axis of an array."""
        if values.ndim > 1:
            return self.apply(f"{ufunc.__name__}.accumulate", values)
        found = [values[0]]
        for each in list(values)[1:]:
            found.append(ufunc(found[-1], each))
        return self.apply("stack", found)

    # ----------------------------------------------------------------------------------------------- branches
    def decide(self, node: Operation) -> bool:
        """Truth of a condition on the way that is being run.

        Raises:
            Undecided: It is not known yet.
        """
        if id(node) in self.known[-1]:
            return self.known[-1][id(node)]
        self.alive.append(node)
        raise Undecided(node)

    def run(self, function: Callable[[], Any], name: str, *, lazy: bool = False) -> Any:  # noqa: ANN401 (a tree)
        """Result of a function that asks for truth values, its ways joined."""

        def way(known: dict[int, bool]) -> Any:  # noqa: ANN401 (a tree)
            self.known.append(known)
            try:
                return function()
            except Undecided as asked:
                node = asked.node
            finally:
                self.known.pop()
            if len(known) == MOST_QUESTIONS:
                words = "a function of the driver has too many branches for a form in C"
                raise InputError(words, field="export", value=name)
            if not lazy:
                yes, no = (way(known | {id(node): truth}) for truth in (True, False))
                return self.join(yes, no, lambda a, b: self.select(node, a, b))
            return self.choose(node, *(partial(way, known | {id(node): truth}) for truth in (True, False)))

        return way({})

    def remember(self, key: Any, make: Callable[[], Any]) -> Any:  # noqa: ANN401 (a key, a tree)
        """Result made for the same symbols before: a way that is run again finds the same choices."""
        for scope in self.builder.scopes:
            if key in scope.known:
                return scope.known[key]
        self.builder.scopes[-1].known[key] = found = make()
        return found

    def select(self, node: Operation, yes: Any, no: Any) -> Symbol:  # noqa: ANN401 (numbers)
        """One number or the other; both are computed."""
        kind = self._kind(yes, no)
        return self.apply("where", Symbol(self, node), self._turn(yes, kind), self._turn(no, kind))

    def choose(self, node: Operation, yes: Callable[[], Any], no: Callable[[], Any]) -> Any:  # noqa: ANN401 (a tree)
        """Result of one function or the other; only that one is computed."""
        scopes, results = [], []
        for side in (yes, no):
            self.builder.open_scope()
            results.append(side())
            scopes.append(self.builder.close_scope())
        pairs: list[tuple[Any, Any]] = []

        def mark(a: Any, b: Any) -> _Hole:  # noqa: ANN401 (numbers)
            pairs.append((a, b))
            return _Hole(len(pairs) - 1)

        joined = self.join(results[0], results[1], mark)
        kinds = [self._kind(*pair) for pair in pairs]
        sides, lengths = [], []
        for scope, ends in zip(scopes, zip(*pairs, strict=True), strict=True):
            self.builder.open_scope(scope)
            turned = [self._turn(each, kind) for each, kind in zip(ends, kinds, strict=True)]
            # a choice is between numbers, so the few entries of an array are chosen one by one
            last = [entry.node for each in turned for entry in _entries(each)]
            sides.append(Branch(drop_unused(self.builder.close_scope().nodes, last), last))
            lengths = [len(each) if each.ndim else 0 for each in turned]
        rest = iter(self.builder.choice(node, sides[::-1]))
        found = [
            self.apply("stack", [Symbol(self, next(rest)) for _ in range(n)])
            if n
            else Symbol(self, next(rest))
            for n in lengths
        ]
        return _map(lambda each: found[each.number] if isinstance(each, _Hole) else each, joined)

    def repeat(self, count: int, step: Callable[..., Any], state: tuple[Any, ...]) -> Any:  # noqa: ANN401 (a tree)
        """State after some equal steps, as a loop; what changes in it is found by running a step."""
        first = list(_leaves(state))
        kinds: dict[int, np.dtype] = {}
        while True:
            scope, carried = Scope(), []
            self.builder.open_scope(scope)
            try:
                given = list(first)
                for k, kind in kinds.items():
                    size = np.shape(first[k])
                    entries = [Symbol(self, Operation("input", (), (), kind)) for _ in range(prod(size))]
                    carried += entries
                    given[k] = self.apply("stack", entries) if size else entries[0]
                rest = iter(given)
                before = _map(lambda _, rest=rest: next(rest), state)
                after = list(_leaves(self.run(lambda before=before: step(*before), "repeat")))
                found = {
                    k: self._kind(each, first[k])
                    for k, each in enumerate(after)
                    if each is not given[k] and not _same(each, given[k])
                }
                if set(found) <= set(kinds):
                    last = [
                        entry.node
                        for k, kind in kinds.items()
                        for entry in _entries(self._turn(after[k], kind))
                    ]
                    break
            finally:
                self.builder.close_scope()
            kinds |= found
        begin = [entry.node for k, kind in kinds.items() for entry in _entries(self._turn(first[k], kind))]
        side = Branch(drop_unused(scope.nodes, last), last)
        results = iter(self.builder.loop(count, begin, [each.node for each in carried], side))
        for k in kinds:
            size = np.shape(first[k])
            entries = [Symbol(self, next(results)) for _ in range(prod(size))]
            first[k] = self.apply("stack", entries) if size else entries[0]
        rest = iter(first)
        return _map(lambda _: next(rest), state)

    def share(self, function: FunctionType, given: tuple[Any, ...], *, lazy: bool) -> Any:  # noqa: ANN401 (a tree)
        """Result of a call of a function that is one in C too; None: of these arguments it is not."""
        fixed = SHARED[function.__name__]
        rest = [each for k, each in enumerate(given) if k not in fixed]
        leaves = [each for each in _leaves(rest) if _is_number(each)]
        if any(np.ndim(each) > 1 or np.size(each) > MOST_ENTRIES for each in leaves):
            return None
        symbols = [each if isinstance(each, Symbol) else self.constant(each) for each in leaves]
        numbers = [entry for each in symbols for entry in _entries(each)]
        forms = iter(f"{each.dtype.name}{list(each.shape)}" for each in symbols)
        form = _map(lambda each: next(forms) if _is_number(each) else each, rest)
        key = function.__qualname__, _key([each for k, each in enumerate(given) if k in fixed]), _key(form)
        if key not in self.shared:
            self.shared[key] = self._write_shared(function, given, symbols, lazy=lazy)
        if (known := self.shared[key]) is None:
            return None
        graph, used, tree = known
        results = [Symbol(self, each) for each in self.builder.call(graph, [numbers[k].node for k in used])]

        def put(each: Any) -> Any:  # noqa: ANN401 (a result)
            if not isinstance(each, _Entries):
                return each
            found = [results[k] if isinstance(k, int) else k for k in each.places]
            return self.apply("stack", found) if each.is_array else found[0]

        return _map(put, tree)

    def _write_shared(
        self, function: FunctionType, given: tuple[Any, ...], symbols: Sequence[Symbol], *, lazy: bool
    ) -> tuple[Graph, list[int], Any] | None:
        """Graph of a function, which of the numbers given it needs, and its answer made of its results."""
        fixed, inputs = SHARED[function.__name__], []
        scopes, known = self.builder.scopes, self.known
        self.builder.scopes, self.known = [Scope()], [{}]
        try:
            arguments = []
            for each in symbols:
                entries = [Symbol(self, Operation("input", (), (), each.dtype)) for _ in range(each.size)]
                inputs += [entry.node for entry in entries]
                arguments.append(self.apply("stack", entries) if each.ndim else entries[0])
            left = iter(arguments)
            call = [
                each if k in fixed else _map(lambda one: next(left) if _is_number(one) else one, each)
                for k, each in enumerate(given)
            ]
            self.alive.append(call)
            answer = self.run(lambda: function(*call), function.__qualname__, lazy=lazy)
            outputs: list[Operation] = []

            def mark(each: Any) -> Any:  # noqa: ANN401 (a result)
                if not isinstance(each, Symbol) or each.node.op == "const":
                    return each
                places: list[int | Symbol] = []
                for entry in _entries(each):
                    if entry.node.op != "const":
                        outputs.append(entry.node)
                    places.append(entry if entry.node.op == "const" else len(outputs) - 1)
                return _Entries(places, each.ndim > 0)

            if any(isinstance(each, Symbol) and each.ndim > 1 for each in _leaves(answer)):
                return None
            tree = _map(mark, answer)
            nodes = drop_unused(self.builder.scopes[0].nodes, outputs)
        finally:
            self.builder.scopes, self.known = scopes, known
        needed = {id(arg): arg for node in nodes for arg in operands(node)} | {
            id(each): each for each in outputs
        }
        inside = {*map(id, nodes), *map(id, inputs)}
        if any(each.op != "const" and number not in inside for number, each in needed.items()):
            # it takes something from elsewhere
            return None
        used = [k for k, each in enumerate(inputs) if id(each) in needed]
        return Graph([inputs[k] for k in used], outputs, nodes), used, tree

    def _kind(self, a: Any, b: Any) -> np.dtype:  # noqa: ANN401 (numbers)
        """Number type of a choice."""
        first, second = ((each if isinstance(each, Symbol) else self.constant(each)).dtype for each in (a, b))
        if first == second:
            return first
        return np.dtype(np.int32) if first.kind == second.kind == "i" else self.number

    def _turn(self, value: Any, kind: np.dtype) -> Symbol:  # noqa: ANN401 (a number)
        found = value if isinstance(value, Symbol) else self.constant(value)
        return found if found.dtype == kind else self.apply("astype", found, kind)

    def join(self, yes: Any, no: Any, choose: Callable[[Any, Any], Any]) -> Any:  # noqa: ANN401 (trees)
        """Two results as one, a choice wherever they differ."""
        if yes is no:
            return yes
        if isinstance(yes, Symbol) and isinstance(no, Symbol) and yes.node is no.node:
            return yes
        if isinstance(yes, tuple | list) and type(yes) is type(no) and len(yes) == len(no):
            parts = [self.join(a, b, choose) for a, b in zip(yes, no, strict=True)]
            return type(yes)(*parts) if hasattr(yes, "_fields") else type(yes)(parts)
        if _is_number(yes) and _is_number(no):
            return yes if _same(yes, no) else choose(yes, no)
        raise InputError(
            "the driver answers with one thing or another, which has no form in C",
            field="to",
            value=f"{type(yes).__name__} or {type(no).__name__}",
        )

    # ------------------------------------------------------------------------------------------------ modules
    @contextmanager
    def apply_to(self, modules: Sequence[ModuleType]) -> Iterator[None]:
        """Let the functions of modules run on symbols."""
        NAMESPACES[Symbol] = _Namespace(self)
        missing, changed = object(), []
        try:
            for place, name, value in self._replacements(modules):
                changed.append((place, name, vars(place).get(name, missing)))
                setattr(place, name, value)
            yield
        finally:
            for place, name, value in reversed(changed):
                if value is missing:
                    delattr(place, name)
                else:
                    setattr(place, name, value)

    def _replacements(self, modules: Sequence[ModuleType]) -> list[tuple[Any, str, Any]]:
        """Modules and classes, names in them, and what the names stand for while tracing."""
        own, joined = {module.__name__ for module in modules}, {}
        found: list[tuple[Any, str, Any]] = []
        for module in modules:
            for name, value in vars(module).items():
                if inspect.isclass(value) and value.__module__ == module.__name__:
                    found += [(value, *each) for each in self._methods(value)]
                elif inspect.isfunction(value) and inspect.unwrap(value).__module__ in own:
                    joined[value] = joined.get(value) or self._joining(value)
                    found.append((module, name, joined[value]))
            known = self._builtins()
            if module.__name__.startswith("metropilot.studies"):
                # where a study asks for single numbers by name
                known["scalars"] = NAMESPACES[Symbol]
            found += [
                (module, name, value)
                for name, value in known.items()
                if (name in vars(module)) == (name in {"math", "scalars"})
            ]
        return found

    def _methods(self, kind: type) -> Iterator[tuple[str, Any]]:
        for name, value in list(vars(kind).items()):
            if name.startswith("__") or name in UNTOUCHED:
                continue
            if isinstance(value, FunctionType):
                yield name, self._joining(value)
            elif isinstance(value, property) and value.fget is not None:
                yield name, property(self._joining(cast("FunctionType", value.fget)))
            elif isinstance(value, cached_property):
                yield (
                    name,
                    property(partial(_known_or, name, self._joining(cast("FunctionType", value.func)))),
                )

    def _joining(self, function: FunctionType) -> Callable[..., Any]:
        """The function, unchecked, the ways of each call joined."""
        plain = inspect.unwrap(function)
        own = {"unless": self._unless, "repeat": self._repeat, "slice_from": self._slice_from}
        if plain.__name__ in own:
            return partial(own[plain.__name__], plain)
        lazy = plain.__name__ in LAZY

        @wraps(plain)
        def call(*given: Any, **options: Any) -> Any:  # noqa: ANN401 (anything)
            def found() -> Any:  # noqa: ANN401 (anything)
                return self.run(lambda: plain(*given, **options), plain.__qualname__, lazy=lazy)

            key = plain.__qualname__, _key((given, tuple(sorted(options.items()))))
            self.alive.append((given, options))
            if plain.__name__ not in SHARED or options:
                return self.remember(key, found)

            def call_shared() -> Any:  # noqa: ANN401 (anything)
                answer = self.share(plain, given, lazy=lazy)
                return found() if answer is None else answer

            return self.remember(key, call_shared)

        return call

    def _unless(self, plain: Any, done: Any, value: int, rest: Callable[..., Any], *given: Any) -> Any:  # noqa: ANN401
        if not isinstance(done, Symbol):
            return plain(done, value, rest, *given)
        key = "unless", rest.__qualname__, _key((done, value, given))
        return self.remember(key, lambda: self.choose(done.node, lambda: value, lambda: rest(*given)))

    def _repeat(self, plain: Any, count: int, step: Callable[..., Any], *state: Any) -> Any:  # noqa: ANN401 (trees)
        del plain
        return self.repeat(count, step, state)

    def _slice_from(self, plain: Any, values: Any, first: Any, size: int) -> Any:  # noqa: ANN401 (arrays)
        if not isinstance(first, Symbol):
            return plain(values, first, size)
        if first.ndim:
            return values[self.apply("add", first, np.arange(size))]
        return self.call(("slice", size), partial(plain, size=size), values, first)

    def _builtins(self) -> dict[str, Any]:
        """Builtin functions that a symbol cannot answer, in a form that knows symbols."""

        def least(*given: Any, largest: bool = False, **options: Any) -> Any:  # noqa: ANN401 (numbers)
            values = list(given[0]) if len(given) == 1 else list(given)
            if not any(isinstance(each, Symbol) for each in values):
                return (builtins.max if largest else builtins.min)(values, **options)
            if len(given) == 1 and isinstance(given[0], Symbol):
                return given[0].max() if largest else given[0].min()
            found = values[0]
            for each in values[1:]:
                # as Python does: the first of equal ones, and the first where one is not a number
                better = each > found if largest else each < found
                found = self.apply("where", better, each, found)
            return found

        class _Kind(type):
            def __instancecheck__(cls, value: Any) -> bool:  # noqa: ANN401 (anything)
                return isinstance(value, getattr(builtins, cls.__name__))

        def kind(name: str, turn: Callable[[Symbol], Any]) -> Any:  # noqa: ANN401 (a type)
            known = getattr(builtins, name)

            def make(_: Any, *given: Any) -> Any:  # noqa: ANN401 (a type, anything)
                return turn(given[0]) if given and isinstance(given[0], Symbol) else known(*given)

            return _Kind(name, (), {"__new__": make})

        whole = np.dtype(np.int32)
        return {
            "min": least,
            "max": partial(least, largest=True),
            "int": kind("int", lambda x: x.astype(whole)),
            "float": kind("float", lambda x: x.astype(self.number)),
            "math": _Mathematics(self),
        }


class _Mathematics:
    """The module ``math`` for symbols too."""

    def __init__(self, tracer: BranchTracer) -> None:
        self.tracer = tracer

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 (a function or a number)
        known = getattr(math, name)

        def call(*given: Any) -> Any:  # noqa: ANN401 (numbers)
            if not any(isinstance(each, Symbol) for each in given):
                return known(*given)
            found = self.tracer.apply(name, *given)
            return found.astype(np.int32) if name in {"ceil", "floor"} else found

        return call if callable(known) else known


@dataclass(frozen=True)
class _Entries:
    """Entries of a result of a shared function: their numbers among its results, or constants."""

    places: list[int | Symbol]
    is_array: bool


class _Hole:
    """Place of an argument or of a result that is not known yet."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __repr__(self) -> str:
        return f"<{self.number}>"


def _function(name: str) -> Callable[..., Any]:
    """The function of JAX of a name, in operations that have a form in C."""
    import jax
    import jax.numpy as jnp

    def take(values: Any, places: Any) -> Any:  # noqa: ANN401 (arrays)
        return values.at[places].get(mode="clip", wrap_negative_indices=False)

    def interp(x: Any, at: Any, values: Any) -> Any:  # noqa: ANN401 (arrays)
        if jnp.ndim(x):
            raise InputError("the driver interpolates many places, which has no form in C", field="to")
        last = at.shape[0] - 1
        k = jnp.clip(jnp.sum(at <= x) - 1, 0, last - 1).astype(jnp.int32)
        low, high = take(at, k), take(at, k + 1)
        found = take(values, k) + (take(values, k + 1) - take(values, k)) / (high - low) * (x - low)
        return jnp.where(x <= at[0], values[0], jnp.where(x >= at[last], values[last], found))

    def einsum(form: str, a: Any, b: Any) -> Any:  # noqa: ANN401 (arrays)
        given, left = form.split("->")
        first, second = given.split(",")
        axes = "".join(sorted({*first, *second} - {*left})) + left
        spread = []
        for array, letters in ((a, first), (b, second)):
            order = sorted(range(len(letters)), key=lambda k, letters=letters: axes.index(letters[k]))
            shape = [array.shape[letters.index(each)] if each in letters else 1 for each in axes]
            spread.append(jnp.transpose(array, order).reshape(shape))
        return (spread[0] * spread[1]).sum(tuple(range(len(axes) - len(left))))

    def concatenate(parts: Any, axis: int = 0) -> Any:  # noqa: ANN401 (arrays)
        return jnp.concatenate([jnp.stack(each) if isinstance(each, list) else each for each in parts], axis)

    def cumsum(x: Any) -> Any:  # noqa: ANN401 (an array)
        sums = [x[0]]
        for k in range(1, x.shape[0]):
            sums.append(sums[-1] + x[k])
        return jnp.stack(sums)

    own = {
        "concatenate": concatenate,
        "cumsum": cumsum,
        "ceil": lambda x: -jnp.floor(-x),
        "astype": lambda x, dtype: x.astype(dtype),
        "take": take,
        "interp": interp,
        "einsum": einsum,
        "argmin": lambda x: jnp.argmax(-x).astype(jnp.int32),
        "argmax": lambda x: jnp.argmax(x).astype(jnp.int32),
        "empty_like": jnp.zeros_like,
        "diagonal": lambda x: jnp.stack([x[k, k] for k in range(x.shape[0])]),
        "min": jnp.min,
        "max": jnp.max,
        "minimum.accumulate": lambda x: jax.lax.cummin(x, x.ndim - 1),
    }
    return own.get(name) or getattr(jnp, name)


def _leaves(tree: Any) -> Iterator[Any]:  # noqa: ANN401 (a tree)
    if isinstance(tree, tuple | list):
        for each in tree:
            yield from _leaves(each)
    else:
        yield tree


def _key(tree: Any) -> Any:  # noqa: ANN401 (a tree)
    """Key that tells trees apart: operations, numbers, other things by their identity."""
    if isinstance(tree, tuple | list):
        return tuple(map(_key, tree))
    if isinstance(tree, Symbol):
        return "symbol", id(tree.node)
    return (type(tree), tree) if isinstance(tree, str | float | int | np.generic) else id(tree)


def _known_or(name: str, compute: Callable[[Any], Any], instance: Any) -> Any:  # noqa: ANN401 (anything)
    """A cached property: known before, or computed and not kept, as that would be the value of one way."""
    return vars(instance)[name] if name in vars(instance) else compute(instance)


def _entries(value: Symbol) -> list[Symbol]:
    """Entries of a row, or the number itself."""
    return list(value) if value.ndim else [value]


def _same(a: Any, b: Any) -> bool:  # noqa: ANN401 (numbers)
    """Tell if two numbers are the same operation, or equal constants."""
    if isinstance(a, Symbol) or isinstance(b, Symbol):
        return isinstance(a, Symbol) and isinstance(b, Symbol) and a.node is b.node
    return type(a) is type(b) and np.array_equal(a, b, equal_nan=True)


def _is_number(value: Any) -> bool:  # noqa: ANN401 (anything)
    return isinstance(value, Symbol | float | int | np.generic | np.ndarray)


def _map(function: Callable[[Any], Any], tree: Any) -> Any:  # noqa: ANN401 (a tree)
    if isinstance(tree, tuple | list):
        parts = [_map(function, each) for each in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)
    return function(tree)
