"""C99 of a graph: loops with fixed bounds over local arrays, constant tables, no call but ``sqrt``."""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import prod
from types import MappingProxyType
from typing import Any

import numpy as np

from metropilot.aboard.graph import Graph, Operation, is_uniform, operands
from metropilot.aboard.tables import TYPES, WIDTH, Tables, fill, literal
from metropilot.errors import InputError

SHORT = MappingProxyType({"float64": "f64", "float32": "f32", "int32": "i32", "int64": "i64", "bool": "bool"})
VARIABLE = re.compile(r"\bv\d+\b")
DEFINITION = re.compile(r"^ *const \w+ (v\d+) = [^;]*;\n", re.MULTILINE)
VIEWS = frozenset(
    {"broadcast_in_dim", "reshape", "squeeze", "expand_dims", "slice", "transpose", "rev", "dynamic_slice"}
)
"""Operations that only rename entries: they become arithmetic on indices."""
ARITHMETIC = MappingProxyType({"add": "+", "sub": "-", "mul": "*", "div": "/"})
COMPARISONS = MappingProxyType({"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="})
LOGIC = MappingProxyType({"and": "&&", "or": "||", "xor": "!="})
CALLS = MappingProxyType(
    {
        **{op: op for op in ("exp", "log", "tanh", "floor", "sign", "max", "min")},
        "is_finite": "finite",
    }
)
"""Operations that are functions of the preamble, ``NAME_f64`` and ``NAME_f32``."""
ELEMENTWISE = frozenset(
    {*ARITHMETIC, *COMPARISONS, *LOGIC, *CALLS, "not", "neg", "abs", "sqrt", "pow", "integer_pow", "rem"}
    | {"round", "select_n", "clamp", "convert_element_type", "iota", "square", "logistic"}
)
REDUCTIONS = MappingProxyType({"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min"})
ARRAY, LEAST, CHEAP = 32, 16, 24
"""An array from this size on is computed anew for each reader if that takes few operations, one or all."""
LOGICAL_REDUCTIONS = MappingProxyType({"reduce_and": "and", "reduce_or": "or"})


def emit_body(
    graph: Graph, inputs: Sequence[str], outputs: Sequence[str], tables: Tables, indent: str = "    "
) -> list[str]:
    """Lines of C that compute a graph, to stand in a function.

    Args:
        graph: The graph.
        inputs: Lvalue of each input, an array where the input is not a single number.
        outputs: Lvalue of each output, which may be that of an input too: it is written when no operation
            reads the input any more.
        tables: Constant tables of the file.
        indent: Indentation.

    Raises:
        InputError: An operation has no form in C.
    """
    emitter = _plan_arrays(graph, inputs, outputs, tables)
    body = emitter.body(indent)
    return [*emitter.arrays(indent), *body]


class _Arena:
    """Local array of one number type that results share, each for as long as it is needed.

    Args:
        plan: Place of each result in the order in which they are needed; None: the first that is free.
    """

    def __init__(self, plan: Sequence[int] | None = None) -> None:
        self.size = self.moment = 0
        self.planned = plan
        self.starts: list[int] = []
        self.taken: dict[int, int] = {}
        self.spans: list[tuple[int, int, int]] = []
        """Size of each result, and the moments from which on and up to which it is needed."""

    def take(self, size: int) -> int:
        start = 0
        if self.planned is None:
            for first, number in sorted(self.taken.items()):
                if start + size <= first:
                    break
                start = max(start, first + self.spans[number][0])
        else:
            start = self.planned[len(self.spans)]
        self.taken[start] = len(self.spans)
        self.starts.append(start)
        self.moment += 1
        self.spans.append((size, self.moment, sys.maxsize))
        self.size = max(self.size, start + size)
        return start

    def release(self, start: int) -> None:
        number = self.taken.pop(start)
        size, first, _ = self.spans[number]
        self.spans[number] = size, first, self.moment

    def plan(self) -> list[int]:
        """Places for the same results in less room: the largest first, each as low as it fits."""
        places: dict[int, int] = {}
        for number in sorted(range(len(self.spans)), key=lambda k: (-self.spans[k][0], k)):
            size, first, last = self.spans[number]
            start = 0
            others = ((place, self.spans[other]) for other, place in places.items())
            meanwhile = sorted((place, one[0]) for place, one in others if one[1] <= last and first <= one[2])
            for place, length in meanwhile:
                if place < start + size:
                    start = max(start, place + length)
            places[number] = start
        least = max((start + self.spans[number][0] for number, start in places.items()), default=0)
        return [places[k] for k in range(len(self.spans))] if least < self.size else self.starts


class _Arenas(dict[str, _Arena]):
    """Local arrays by their number types, each made when it is needed."""

    def __init__(self, plans: Mapping[str, Sequence[int]]) -> None:
        super().__init__()
        self.plans = plans

    def __missing__(self, kind: str) -> _Arena:
        self[kind] = _Arena(self.plans.get(kind))
        return self[kind]


class _Emitter:
    """Writer of one function's body."""

    def __init__(
        self,
        graph: Graph,
        inputs: Sequence[str],
        outputs: Sequence[str],
        tables: Tables,
        plans: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        self.graph, self.tables, self.outputs = graph, tables, outputs
        self.sides: dict[int, list[Operation]] = {}
        """Operations of the sides of choices and loops in the order of their statements, by their results."""
        self.names: dict[int, str] = {id(node): name for node, name in zip(graph.inputs, inputs, strict=True)}
        self.targets = self._find_targets(outputs)
        self.order = _flatten(graph.nodes)
        self.own = self._own_variables()
        self.nodes = self._sink(self._hoist_outputs(graph.nodes))
        self.order = _flatten(self.nodes, self.sides)
        self.last = self._last_uses()
        self.arenas = _Arenas(plans or {})
        self.places: dict[int, tuple[str, int, int]] = {}
        self.starts: dict[int, int] = {}
        self.offsets: dict[int, list[str]] = {}
        self.rows: dict[int, str] = {}
        self.lines: list[str] = []
        self.count = 0

    def arrays(self, indent: str) -> list[str]:
        """Lines that declare the local arrays, once the others are written."""
        return [
            f"{indent}{TYPES[kind]} w_{SHORT[kind]}[{arena.size}];"
            for kind, arena in sorted(self.arenas.items())
        ]

    def body(self, indent: str) -> list[str]:
        """All lines but the local arrays."""
        outputs = self.outputs
        self.block(self.nodes, indent)
        copies = []
        for node, target in zip(self.graph.outputs, outputs, strict=True):
            if node.size > 1 and self.names.get(id(node)) == target:
                continue
            base, kind = _base(node), node.dtype.name
            if base.op != "input" or self.names[id(base)] not in {*outputs} - {target}:
                copies += self.copy(node, target, indent)
            elif node.shape == ():
                # what it is a part of may be written before
                name = self.variable()
                self.lines.append(f"{indent}const {TYPES[kind]} {name} = {self.at(node, [])};")
                copies.append(f"{indent}{target} = {name};")
            else:
                name, start = f"w_{SHORT[kind]}", self.arenas[kind].take(node.size)
                self.lines += self.copy(node, f"({name} + {start})", indent)
                copies += _loops((node.size,), [f"{target}[i0] = {name}[{_plus(start, 'i0')}];"], indent)
        return _drop_unread([*self.lines, *copies])

    def copy(self, node: Operation, target: str, indent: str) -> list[str]:
        """Lines that write a result to where it belongs."""
        if node.shape == ():
            return [f"{indent}{target} = {self.at(node, [])};"]
        flat = _flat([f"i{k}" for k in range(len(node.shape))], node.shape)
        value = self.at(node, [f"i{k}" for k in range(len(node.shape))])
        return _loops(node.shape, [f"{target}[{flat}] = {value};"], indent)

    # ---------------------------------------------------------------------------------------- what is stored
    def _find_targets(self, outputs: Sequence[str]) -> dict[int, tuple[Operation, str]]:
        """Arrays that may be computed where they belong: the input that is there before, and its lvalue."""
        inputs = {self.names[id(node)]: node for node in self.graph.inputs}
        count = Counter(map(id, self.graph.outputs))
        return {
            id(node): (inputs[target], target)
            for node, target in zip(self.graph.outputs, outputs, strict=True)
            if node.size > 1 and count[id(node)] == 1 and target in inputs
        }

    def _hoist_outputs(self, nodes: Sequence[Operation]) -> list[Operation]:
        """The operations, arrays of outputs as early as they can be computed: so they need no other place."""
        known = {id(node) for node in self.graph.inputs}
        late = [node for node in nodes if id(node) in self.targets]
        found: list[Operation] = []
        for node in nodes:
            if id(node) in known:
                continue
            found.append(node)
            known.add(id(node))
            for each in [one for one in late if id(one) not in known]:
                if all(arg.op == "const" or id(arg) in known for arg in operands(each)):
                    found.append(each)
                    known.add(id(each))
        return found

    def _sink(self, nodes: Sequence[Operation]) -> list[Operation]:
        """The operations of a block; an array larger than what it is made of only where it is needed."""
        waiting: dict[int, Operation] = {}
        found: list[Operation] = []

        def write(node: Operation) -> None:
            for arg in operands(node):
                if id(arg) in waiting:
                    write(waiting.pop(id(arg)))
            found.append(node)

        for node in nodes:
            for side in node.params.get("sides", ()):
                self.sides[id(side)] = self._sink(side.nodes)
            if self._may_wait(node):
                waiting[id(node)] = node
            else:
                write(node)
        while waiting:
            write(waiting.pop(next(iter(waiting))))
        return found

    def _may_wait(self, node: Operation) -> bool:
        if node.op in VIEWS or (node.op in ELEMENTWISE and id(node) not in self.own):
            return True
        if id(node) in self.targets or node.size < ARRAY or node.op not in {*ELEMENTWISE, "gather"}:
            return False
        by_id = {id(arg): arg for arg in self._list_stored(node)}
        return sum(arg.size for arg in by_id.values() if arg.size >= ARRAY) < node.size

    def _list_stored(self, node: Operation) -> Iterator[Operation]:
        """Stored results that the statement of a node reads."""
        for arg in operands(node):
            if id(arg) in self.own and arg.op not in VIEWS:
                yield arg
            elif arg.op not in {"const", "input", "result"}:
                yield from self._list_stored(arg)

    def _place(self, node: Operation) -> tuple[str, int]:
        """Array that a result is written to, and its first entry there."""
        kind, position = node.dtype.name, self.position[id(node)]
        inline = self._find_reads(node)
        if id(node) in self.targets:
            before, target = self.targets[id(node)]
            if self.last.get(id(before), -1) <= position and inline.get(id(before), True):
                return target, 0
        name = f"w_{SHORT[kind]}"
        for key, same in inline.items():
            found = self.places.get(key)
            if (
                same
                and found is not None
                and (found[0], found[2]) == (kind, node.size)
                and self.last[key] <= position
            ):
                # the entry is read before it is written
                self.places[id(node)] = self.places.pop(key)
                return name, found[1]
        start = self.arenas[kind].take(node.size)
        self.places[id(node)] = kind, start, node.size
        return name, start

    def _find_reads(self, node: Operation) -> dict[int, bool]:
        """Arrays that a statement reads; of each whether only the entry that is written meanwhile."""
        found: dict[int, bool] = {}

        def read(arg: Operation, same: bool) -> None:
            if arg.op == "const":
                return
            if arg.op == "input" or (id(arg) in self.own and arg.op not in VIEWS):
                found[id(arg)] = found.get(id(arg), True) and same and arg.shape == node.shape
                return
            for each in arg.args:
                read(each, same and arg.op in ELEMENTWISE)

        for arg in node.args:
            read(arg, node.op in ELEMENTWISE)
        return found

    def _own_variables(self) -> set[int]:
        """Nodes whose result is stored, not computed anew wherever it is read."""
        readers: dict[int, list[Operation | None]] = defaultdict(list)
        grown: set[int] = set()
        for reader in [*self.order, None]:
            if reader is not None and reader.op in VIEWS:
                continue
            # what its sides read, they read themselves
            ends = (
                []
                if reader is None
                else [end for side in reader.params.get("sides", ()) for end in side.results]
            )
            used = self.graph.outputs if reader is None else [*reader.args, *ends]
            for arg in used:
                base, size = _base(arg), arg.size
                readers[id(base)].append(reader)
                if size > base.size or (
                    reader is not None and reader.size > size and reader.op in ELEMENTWISE
                ):
                    grown.add(id(base))
        own: set[int] = set()
        cost: dict[int, int] = {}
        for node in self.order:
            if node.op in VIEWS:
                continue
            found = readers[id(node)]
            fits = all(each is not None and self._reads_once(each, node) for each in found)
            again = 1 + sum(cost.get(id(_base(arg)), 1) for arg in node.args)
            cheap = node.size >= ARRAY and (again <= LEAST or again * len(found) <= CHEAP)
            if (
                node.size == 1
                or node.op not in ELEMENTWISE
                or not fits
                or id(node) in grown
                or not (len(found) == 1 or cheap)
            ):
                own.add(id(node))
            else:
                cost[id(node)] = again
        return own

    def _reads_once(self, reader: Operation, node: Operation) -> bool:
        """Tell if an operation reads each entry of a node once for each that it writes."""
        if reader.op == "gather":
            single = prod(reader.params["slice_sizes"]) == 1
            return node.size >= ARRAY and single and _base(reader.args[0]) is not node
        return reader.op in {*ELEMENTWISE, *REDUCTIONS, *LOGICAL_REDUCTIONS}

    def _last_uses(self) -> dict[int, int]:
        """Position in the order after which a stored array is not read any more."""
        last: dict[int, int] = {}

        def read(node: Operation, position: int) -> None:
            last[id(node)] = max(last.get(id(node), 0), position)
            if node.op in VIEWS or (id(node) not in self.own and node.op not in {"input", "const"}):
                for arg in node.args:
                    read(arg, position)

        for position, node in enumerate(self.order):
            for arg in operands(node):
                read(arg, position)
        for node in self.graph.outputs:
            read(node, len(self.order))
        self.position = {id(node): k for k, node in enumerate(self.order)}
        return last

    # -------------------------------------------------------------------------------------------- statements
    def block(self, nodes: Sequence[Operation], indent: str) -> None:
        """Write the statements of some nodes."""
        for node in nodes:
            if node.op == "cond":
                self.branches(node, indent)
            elif node.op == "loop":
                self.rounds(node, indent)
            elif node.op == "call":
                self.call(node, indent)
            elif node.op == "dynamic_slice":
                self.start(node, indent)
            elif id(node) in self.own and node.op != "result":
                self.store(node, indent)
            self.free(self.position[id(node)])

    def free(self, position: int) -> None:
        """Give back the arrays that were read for the last time."""
        for key, (kind, start, _) in list(self.places.items()):
            if self.last.get(key, position) <= position:
                self.arenas[kind].release(start)
                del self.places[key]

    def store(self, node: Operation, indent: str) -> None:
        """Write the statement or loop that computes a node."""
        kind = TYPES[node.dtype.name]
        if node.size == 1:
            name = self.variable()
            index = ["0"] * len(node.shape)
            if node.op in ELEMENTWISE:
                self.lines += wrap(f"{indent}const {kind} {name} = {self.value(node, index)};", indent)
            elif node.op in {"concatenate", "stack"}:
                (part,) = (arg for arg in node.args if arg.size)
                value = self.at(part, ["0"] * len(part.shape))
                self.lines += wrap(f"{indent}const {kind} {name} = {value};", indent)
            else:
                self.lines.append(f"{indent}{kind} {name};")
                self.lines += self.loop(node, lambda _: name, indent)
            self.names[id(node)] = name
            return
        name, start = self._place(node)
        self.lines += self.loop(
            node, lambda index: f"{name}[{_plus(start, _flat(index, node.shape))}]", indent
        )
        self.names[id(node)], self.starts[id(node)] = name, start

    def loop(self, node: Operation, target: Callable[[list[str]], str], indent: str) -> list[str]:
        """Lines that write every entry of a node."""
        index = [f"i{k}" for k in range(len(node.shape))] if node.size > 1 else ["0"] * len(node.shape)
        shape = node.shape if node.size > 1 else ()
        if node.op in ELEMENTWISE:
            return _loops(shape, [f"{target(index)} = {self.value(node, index)};"], indent)
        if node.op in {*REDUCTIONS, *LOGICAL_REDUCTIONS}:
            return self.reduction(node, target(index), index, shape, indent)
        if node.op in {"concatenate", "stack"}:
            return self.concatenate(node, target, indent)
        if node.op in {"dot_general", "cummin"}:
            return (self.product if node.op == "dot_general" else self.accumulate)(node, target, indent)
        if node.op == "gather":
            return self.gather(node, target(index), index, shape, indent)
        if node.op == "argmax":
            return self.largest(node, target(index), indent)
        raise InputError(f"the driver needs the operation {node.op}, which has no form in C", field="to")

    def branches(self, node: Operation, indent: str) -> None:
        """Write a ``cond``: an ``if`` per branch, the last for every other number."""
        sides = node.params["sides"]
        names = [self.variable() for _ in sides[0].results]
        for name, result in zip(names, sides[0].results, strict=True):
            self.lines.append(f"{indent}{TYPES[result.dtype.name]} {name};")
        self.names[id(node)] = "\n".join(names)
        which = self.at(node.args[0], [])
        for number, side in enumerate(sides):
            if node.args[0].dtype.kind == "b":
                test = which if number else f"!({which})"
            else:
                test = f"{which} <= 0" if number == 0 else f"{which} == {number}"
            last = number == len(sides) - 1
            head = f"if ({test}) {{" if number == 0 else "} else {" if last else f"}} else if ({test}) {{"
            self.lines.append(indent + head)
            self.block(self.sides[id(side)], indent + "    ")
            for name, result in zip(names, side.results, strict=True):
                value = self.at(result, ["0"] * len(result.shape))
                self.lines.append(f"{indent}    {name} = {value};")
        self.lines.append(f"{indent}}}")

    def rounds(self, node: Operation, indent: str) -> None:
        """Write a ``loop``: variables that a round reads and, at its end, writes anew."""
        (side,), carried = node.params["sides"], node.params["carried"]
        names = [self.variable() for _ in carried]
        for name, each, first in zip(names, carried, node.args, strict=True):
            self.lines.append(f"{indent}{TYPES[each.dtype.name]} {name} = {self.at(first, [])};")
            self.names[id(each)] = name
        self.names[id(node)] = "\n".join(names)
        count = self.variable()
        self.lines.append(
            f"{indent}for (int32_t {count} = 0; {count} < {node.params['count']}; {count}++) {{"
        )
        deeper = indent + "    "
        self.block(self.sides[id(side)], deeper)
        ends = []
        for name, each in zip(names, side.results, strict=True):
            # first all are read, as one may be the other of the round before
            end = self.variable()
            self.lines.append(f"{deeper}const {TYPES[each.dtype.name]} {end} = {self.at(each, [])};")
            ends.append(f"{deeper}{name} = {end};")
        self.lines += [*ends, f"{indent}}}"]

    def call(self, node: Operation, indent: str) -> None:
        """Write the call of a shared function, whose results it writes to variables."""
        function = node.params["function"]
        names = [self.variable() for _ in function.outputs]
        self.lines += [
            f"{indent}{TYPES[each.dtype.name]} {name};"
            for name, each in zip(names, function.outputs, strict=True)
        ]
        given = [*(self.at(arg, []) for arg in node.args), *(f"&{name}" for name in names)]
        name, sizes, _ = _shared_function(function, self.tables)
        lent = {kind: self.arenas[kind].take(size) for kind, size in sizes.items()}
        given += [f"w_{SHORT[kind]} + {start}" for kind, start in lent.items()]
        for kind, start in lent.items():
            self.arenas[kind].release(start)
        self.lines += wrap(f"{indent}{name}({', '.join(given)});", indent)
        self.names[id(node)] = "\n".join(names)

    def start(self, node: Operation, indent: str) -> None:
        """Write the first index of a slice, kept inside the array."""
        starts = []
        for arg, whole, part in zip(node.args[1:], node.args[0].shape, node.shape, strict=True):
            if whole == part:
                starts.append("0")
            elif arg.op == "const":
                starts.append(str(int(np.clip(arg.params["value"], 0, whole - part))))
            else:
                name = self.variable()
                self.lines += wrap(
                    f"{indent}const int32_t {name} = within({self.at(arg, [])}, {whole - part});", indent
                )
                starts.append(name)
        self.offsets[id(node)] = starts
        if node.args[0].op == "const" and prod(node.shape[:-1]) == 1 and starts[-1] == "0":
            lines, entry = self.whole_row(node.args[0], _flat(starts[:-1], node.args[0].shape[:-1]))
            self.lines += [f"{indent}{line}" for line in lines]
            if entry is not None:
                self.rows[id(node)] = entry

    def whole_row(self, array: Operation, row: str) -> tuple[list[str], str | None]:
        """Lines that read a row of a table, and an entry ``@`` of it; of most tables entries are read."""
        found = self.tables.row(array.params["value"]) if array.size and not is_uniform(array) else None
        if found is None:
            return [], None
        (name, table), values = found, self.variable()
        unit, kind = literal(array.dtype.type(table.unit), array.dtype), TYPES[array.dtype.name]
        lines = [f"int64_t {values}[{table.columns}];", f"step_row(&{name}, {row}, {values});"]
        return lines, f"(({kind}){values}[@] * {unit})"

    def reduction(
        self, node: Operation, target: str, index: list[str], shape: tuple[int, ...], indent: str
    ) -> list[str]:
        """Sum, largest, smallest, all or any."""
        (arg,), axes, kind = node.args, tuple(node.params["axes"]), TYPES[node.dtype.name]
        inner = [f"j{k}" for k in axes]
        rest = iter(index)
        read = self.at(arg, [f"j{k}" if k in axes else next(rest) for k in range(len(arg.shape))])
        first = {"reduce_sum": literal(0, node.dtype), "reduce_and": "true", "reduce_or": "false"}.get(
            node.op, f"{'-' if node.op == 'reduce_max' else ''}({kind})INFINITY"
        )
        op = REDUCTIONS.get(node.op) or LOGICAL_REDUCTIONS[node.op]
        if node.dtype.kind in "iu" and node.op != "reduce_sum":
            raise InputError(
                f"the driver needs {node.op} of whole numbers, which has no form in C", field="to"
            )
        step = self.apply(op, ["s", read], node.dtype, node.dtype)
        depth = indent + "    " * (len(shape) if shape else 0)
        lines = [f"{kind} s = {first};", *_loops([arg.shape[k] for k in axes], [f"s = {step};"], "", inner)]
        lines += [f"{target} = s;"]
        if shape:
            return _loops(shape, lines, indent)
        return [f"{depth}{{", *(f"{depth}    {line}" for line in lines), f"{depth}}}"]

    def accumulate(self, node: Operation, target: Callable[[list[str]], str], indent: str) -> list[str]:
        """Least entries so far along an axis."""
        if node.params["reverse"]:
            raise InputError("the driver needs a running minimum from behind: no form in C", field="to")
        (arg,), axis, kind = node.args, node.params["axis"], TYPES[node.dtype.name]
        index = [f"i{k}" for k in range(len(node.shape))]
        step = self.apply("min", ["s", self.at(arg, index)], node.dtype, node.dtype)
        along = _loops([node.shape[axis]], [f"s = {step};", f"{target(index)} = s;"], "", [index.pop(axis)])
        shape = [n for k, n in enumerate(node.shape) if k != axis]
        return _loops(shape, [f"{kind} s = ({kind})INFINITY;", *along], indent, index)

    def concatenate(self, node: Operation, target: Callable[[list[str]], str], indent: str) -> list[str]:
        """Arrays one after the other."""
        stacked = node.op == "stack"
        axis, begin = node.params["axis" if stacked else "dimension"], 0
        lines = []
        for arg in (each for each in node.args if each.size):
            index = [f"i{k}" for k in range(len(arg.shape))]
            if arg.size == 1:
                index = ["0"] * len(arg.shape)
            place = list(index)
            if stacked:
                place.insert(axis, str(begin))
                begin += 1
            else:
                place[axis] = _plus(begin, place[axis])
                begin += arg.shape[axis]
            shape = arg.shape if arg.size > 1 else ()
            lines += _loops(shape, [f"{target(place)} = {self.at(arg, index)};"], indent)
        return lines

    def product(self, node: Operation, target: Callable[[list[str]], str], indent: str) -> list[str]:
        """Product of matrices, the entries of a sum in order."""
        (left_axes, right_axes), (left_batch, right_batch) = node.params["dimension_numbers"]
        left, right = node.args
        if left_batch or right_batch or len(left_axes) != 1:
            raise InputError("the driver multiplies arrays in a way that has no form in C", field="to")
        (k_left,), (k_right,) = left_axes, right_axes
        rows = [n for k, n in enumerate(left.shape) if k != k_left]
        columns = [n for k, n in enumerate(right.shape) if k != k_right]
        i, j = [f"i{k}" for k in range(len(rows))], [f"j{k}" for k in range(len(columns))]
        out = target([*i, *j])
        at_left, at_right = list(i), list(j)
        at_left.insert(k_left, "k")
        at_right.insert(k_right, "k")
        zero = literal(0, node.dtype)
        if _gives_running_sums(right) and k_right == 0:
            # the same sums to the last bit, without the terms that are multiplied by zero
            add = self.apply("add", ["s", self.at(left, at_left)], node.dtype, node.dtype)
            inner = [f"{target([*i, 'k'])} = s;", f"s = {add};"]
            lines = [f"{TYPES[node.dtype.name]} s = {zero};", *_loops([left.shape[k_left]], inner, "", ["k"])]
            return _loops(rows, [*lines, f"{target([*i, str(columns[0] - 1)])} = s;"], indent, i)
        term = self.apply("mul", [self.at(left, at_left), self.at(right, at_right)], node.dtype, node.dtype)
        add = self.apply("add", [out, term], node.dtype, node.dtype)
        inner = _loops(columns, [f"{out} = {add};"], "", j)
        lines = [*_loops(columns, [f"{out} = {zero};"], "", j)]
        lines += _loops([left.shape[k_left]], inner, "", ["k"])
        return _loops(rows, lines, indent, i)

    def gather(
        self, node: Operation, target: str, index: list[str], shape: tuple[int, ...], indent: str
    ) -> list[str]:
        """Entries looked up by indices, which are kept inside the array."""
        dims, (array, places) = node.params["dimension_numbers"], node.args
        if tuple(dims.operand_batching_dims):
            raise InputError("the driver looks up arrays in a way that has no form in C", field="to")
        batch = [i for k, i in enumerate(index) if k not in dims.offset_dims]
        within = iter([i for k, i in enumerate(index) if k in dims.offset_dims])
        sizes, read = node.params["slice_sizes"], []
        for axis, whole in enumerate(array.shape):
            place = "0" if axis in dims.collapsed_slice_dims else next(within)
            if axis in dims.start_index_map and whole > sizes[axis]:
                first = self.first_index(places, batch, dims.start_index_map.index(axis), whole - sizes[axis])
                place = first if place == "0" else f"{first} + {place}"
            read.append(place)
        row, *rest = [axis for axis, whole in enumerate(array.shape) if whole > 1] or [0]
        if (
            not batch
            and array.op == "const"
            and node.shape == array.shape[-1:]
            and rest == [len(array.shape) - 1]
        ):
            lines, entry = self.whole_row(array, read[row])
            if entry is not None:
                inner = _loops(shape, [f"{target} = {entry.replace('@', read[-1])};"], "    ")
                return [f"{indent}{line}" for line in ("{", *(f"    {line}" for line in lines), *inner, "}")]
        return _loops(shape, [f"{target} = {self.at(array, read)};"], indent)

    def first_index(self, places: Operation, batch: list[str], number: int, last: int) -> str:
        """Expression of one of the indices of a look-up, at most ``last``; a constant one as such."""
        part = places
        if places.op == "concatenate" and all(arg.shape[-1] == 1 for arg in places.args):
            part = places.args[number]
        if is_uniform(part):
            return str(int(np.clip(part.params["value"].flat[0], 0, last)))
        return f"within({self.at(places, [*batch, str(number)])}, {last})"

    def largest(self, node: Operation, target: str, indent: str) -> list[str]:
        """Number of the largest entry, the first of equal ones."""
        (arg,) = node.args
        kind = TYPES[node.dtype.name]
        if len(arg.shape) != 1:
            raise InputError("the driver needs argmax of a matrix, which has no form in C", field="to")
        test = f"if ({self.at(arg, ['k'])} > {self.at(arg, [target])}) {target} = ({kind})k;"
        return [f"{indent}{target} = 0;", *_loops(arg.shape, [test], indent, ["k"])]

    def variable(self) -> str:
        """A new name."""
        self.count += 1
        return f"v{self.count}"

    # ------------------------------------------------------------------------------------------- expressions
    def at(self, node: Operation, index: list[str]) -> str:  # noqa: C901, PLR0911 (one per kind of node)
        """Expression of one entry of a node."""
        if node.op == "const":
            value = node.params["value"]
            if is_uniform(node):
                return literal(value.flat[0], value.dtype)
            if all(i.isdigit() for i in index):
                return literal(value[tuple(map(int, index))], value.dtype)
            # a column of a table is a table of its own: the others may never be read
            while value.ndim > 1 and index[-1].isdigit():
                value, index = value[..., int(index[-1])], index[:-1]
            return self.tables.at(value, _flat(index, value.shape))
        if node.op == "input":
            name = self.names[id(node)]
            return f"{name}[{_flat(index, node.shape)}]" if node.shape else name
        if node.op == "result":
            return self.names[id(node.args[0])].split("\n")[node.params["number"]]
        if id(node) in self.own:
            name = self.names[id(node)]
            if node.size == 1:
                return name
            return f"{name}[{_plus(self.starts[id(node)], _flat(index, node.shape))}]"
        if id(node) in self.rows:
            return self.rows[id(node)].replace("@", index[-1])
        if node.op in VIEWS:
            return self.at(node.args[0], self.through(node, index))
        return self.value(node, index)

    def through(self, node: Operation, index: list[str]) -> list[str]:  # noqa: PLR0911 (one per view)
        """Index of an entry of a view in what it is a view of."""
        (arg, *_), params = node.args, node.params
        if arg.size == 1:
            return ["0"] * len(arg.shape)
        if node.op == "broadcast_in_dim":
            dims = params["broadcast_dimensions"]
            return ["0" if n == 1 else index[k] for n, k in zip(arg.shape, dims, strict=True)]
        if node.op in {"squeeze", "reshape", "expand_dims"}:
            kept = iter([i for n, i in zip(node.shape, index, strict=True) if n != 1])
            if [n for n in node.shape if n != 1] != [n for n in arg.shape if n != 1]:
                raise InputError("the driver reshapes an array in a way that has no form in C", field="to")
            return ["0" if n == 1 else next(kept) for n in arg.shape]
        if node.op == "slice":
            strides = params["strides"] or (1,) * len(index)
            starts = params["start_indices"]
            return [_plus(b, _times(s, i)) for b, s, i in zip(starts, strides, index, strict=True)]
        if node.op == "transpose":
            found = dict(zip(params["permutation"], index, strict=True))
            return [found[k] for k in range(len(index))]
        if node.op == "rev":
            turned = params["dimensions"]
            return [f"({arg.shape[k] - 1} - {i})" if k in turned else i for k, i in enumerate(index)]
        starts = self.offsets[id(node)]
        return [
            b if i == "0" else i if b == "0" else f"{b} + {i}" for b, i in zip(starts, index, strict=True)
        ]

    def value(self, node: Operation, index: list[str]) -> str:
        """Expression of one entry of an elementwise operation."""
        if node.op == "iota":
            return f"({TYPES[node.dtype.name]})({index[node.params['dimension']]})"
        values = [
            self.at(arg, ["0" if n == 1 else i for n, i in zip(arg.shape, index, strict=False)])
            for arg in node.args
        ]
        return self.apply(node.op, values, node.args[0].dtype, node.dtype, node.params, node)

    def apply(  # noqa: PLR0911 (one per kind of operation)
        self,
        op: str,
        values: list[str],
        given: np.dtype,
        dtype: np.dtype,
        params: Mapping[str, Any] = MappingProxyType({}),
        node: Operation | None = None,
    ) -> str:
        """Expression of an operation on numbers."""
        kind = SHORT[given.name]
        if op in ARITHMETIC and dtype.kind == "f":
            return f"({values[0]} {ARITHMETIC[op]} {values[1]})"
        if op in ARITHMETIC and dtype.kind == "i" and op != "div":
            # unsigned, as the overflow of a signed number is undefined
            whole = f"uint{8 * dtype.itemsize}_t"
            return f"({TYPES[dtype.name]})(({whole})({values[0]}) {ARITHMETIC[op]} ({whole})({values[1]}))"
        if op in COMPARISONS:
            return f"({values[0]} {COMPARISONS[op]} {values[1]})"
        if op in LOGIC and dtype.kind == "b":
            return f"({values[0]} {LOGIC[op]} {values[1]})"
        if op in {"max", "min", "clamp"} and given.kind == "f" and node is not None:
            return self.limit(node, values, kind)
        if op in CALLS and given.kind == "f":
            return f"{CALLS[op]}_{kind}({', '.join(values)})"
        if op in {"max", "min"}:
            sign = ">" if op == "max" else "<"
            return f"({values[0]} {sign} {values[1]} ? {values[0]} : {values[1]})"
        written = {
            "not": lambda x: f"(!{x})",
            "neg": lambda x: f"(-{x})",
            "abs": lambda x: f"abs_{kind}({x})",
            "square": lambda x: f"({x} * {x})",
            "sqrt": lambda x: f"{'sqrt' if kind == 'f64' else 'sqrtf'}({x})",
            "logistic": lambda x: f"({literal(1.0, dtype)} / ({literal(1.0, dtype)} + exp_{kind}(-{x})))",
        }
        if op in written:
            return written[op](*values)
        return self.special(op, values, given, dtype, params, node)

    def limit(self, node: Operation, values: list[str], kind: str) -> str:
        """Expression of the larger or smaller of two numbers, of which a constant needs no test for NaN."""

        def bound(op: str, first: tuple[Operation, str], second: tuple[Operation, str]) -> str:
            # of two zeros the first is taken
            for (limit, constant), (_, other) in ((second, first), (first, second)):
                value = limit.params["value"].flat[0] if is_uniform(limit) else np.nan
                if not np.isnan(value) and (value != 0.0 or limit is second[0]):
                    return f"at_{'least' if op == 'max' else 'most'}_{kind}({other}, {constant})"
            return f"{op}_{kind}({first[1]}, {second[1]})"

        parts = list(zip(node.args, values, strict=True))
        if node.op != "clamp":
            return bound(node.op, *parts)
        low, (x, value), high = parts
        return bound("min", (x, bound("max", (x, value), low)), high)

    def special(
        self,
        op: str,
        values: list[str],
        given: np.dtype,
        dtype: np.dtype,
        params: Mapping[str, Any],
        node: Operation | None,
    ) -> str:
        """Expression of the operations that only some of their operands or parameters have a form for."""
        kind = SHORT[given.name]
        if op == "select_n" and len(values) == 3 and given.kind == "b":
            return f"({values[0]} ? {values[2]} : {values[1]})"
        if op == "convert_element_type":
            return _convert(values[0], given, dtype)
        if op == "round":
            even = int(params.get("rounding_method", 0)) == 1
            return f"{'even' if even else 'round'}_{kind}({values[0]})"
        by = None if node is None or len(node.args) < 2 else node.args[1].params.get("value")
        if op == "rem" and by is not None and by.size == 1 and float(by) == 1.0:
            return f"fraction_{kind}({values[0]})"
        if op == "pow" and by is not None and by.size == 1 and float(by) == 0.5:
            return self.apply("sqrt", values[:1], given, dtype)
        if op == "integer_pow" and 1 <= params["y"] <= 4:
            return f"({' * '.join(values * params['y'])})"
        raise InputError(f"the driver needs the operation {op}, which has no form in C", field="to")


def _plan_arrays(graph: Graph, inputs: Sequence[str], outputs: Sequence[str], tables: Tables) -> _Emitter:
    """Writer of a graph that knows from a first attempt how long each result is needed."""
    first = _Emitter(graph, inputs, outputs, tables)
    first.body("")
    return _Emitter(graph, inputs, outputs, tables, {k: arena.plan() for k, arena in first.arenas.items()})


def _shared_function(function: Graph, tables: Tables) -> tuple[str, dict[str, int], Graph]:
    """The C function of a graph of single numbers: its name, and the entries that its caller lends to it.

    It is written at its first call. Its arrays lie where the caller has room at that moment, so that the
    stack is not that of both.
    """
    if id(function) not in tables.functions:
        given = [f"a{k}" for k in range(len(function.inputs))]
        results = [f"r{k}" for k in range(len(function.outputs))]
        outputs = [f"*{name}" for name in results]
        emitter = _plan_arrays(function, given, outputs, tables)
        body = emitter.body("    ")
        read = set(re.findall(r"\ba\d+\b", " ".join(body)))
        body = [*(f"    (void){name};" for name in given if name not in read), *body]
        sizes = {kind: arena.size for kind, arena in sorted(emitter.arenas.items())}
        name = f"f{len(tables.functions)}"
        words = [f"{TYPES[each.dtype.name]} {k}" for k, each in zip(given, function.inputs, strict=True)]
        words += [f"{TYPES[each.dtype.name]} *{k}" for k, each in zip(results, function.outputs, strict=True)]
        words += [f"{TYPES[kind]} *w_{SHORT[kind]}" for kind in sizes]
        head = wrap(f"static void {name}({', '.join(words)})", "")
        tables.lines += ["", *head, "{", *body, "}"]
        tables.functions[id(function)] = name, sizes, function
    return tables.functions[id(function)]


def _convert(value: str, given: np.dtype, dtype: np.dtype) -> str:
    """A number in another type; a float outside an integer's range becomes its nearest, NaN 0."""
    if dtype.kind == "b":
        return f"({value} != {literal(0, given)})"
    if given.kind == "b":
        return f"({value} ? {literal(1, dtype)} : {literal(0, dtype)})"
    if given.kind == "f" and dtype.kind == "i":
        return f"({TYPES[dtype.name]})to_i32({value if given == np.float64 else f'(double){value}'})"
    return f"({TYPES[dtype.name]}){value}"


def _drop_unread(lines: Sequence[str]) -> list[str]:
    """Lines without the variables that nothing reads, as an index into a column of equal entries."""
    text, before = "\n".join(lines), ""
    while text != before:
        before, read = text, Counter(VARIABLE.findall(text))
        text = DEFINITION.sub(lambda match, read=read: match[0] if read[match[1]] > 1 else "", before)
    return text.split("\n")


def _flatten(
    nodes: Sequence[Operation], sides: Mapping[int, Sequence[Operation]] = MappingProxyType({})
) -> list[Operation]:
    """All nodes in the order of their statements; a ``cond`` or ``loop`` follows its sides."""
    order: list[Operation] = []
    for node in nodes:
        for side in node.params.get("sides", ()):
            order += _flatten(sides.get(id(side), side.nodes), sides)
        order.append(node)
    return order


def _gives_running_sums(node: Operation) -> bool:
    """Tell if a product by this matrix gives the sums of all terms before each entry, the last of all."""
    if node.op != "const" or len(node.shape) != 2 or node.shape[1] != node.shape[0] + 1:
        return False
    terms, places = node.shape
    return np.array_equal(node.params["value"], np.tri(places, terms, -1).T)


def _base(node: Operation) -> Operation:
    """Operation whose entries a view shows."""
    while node.op in VIEWS:
        node = node.args[0]
    return node


def _flat(index: Sequence[str], shape: Sequence[int]) -> str:
    """Number of an entry in row-major order."""
    terms, constant = [], 0
    for k, i in enumerate(index):
        stride = prod(shape[k + 1 :])
        if shape[k] == 1 or i == "0":
            continue
        if i.isdigit():
            constant += stride * int(i)
        else:
            terms.append(_times(stride, i))
    return _plus(constant, " + ".join(terms)) if terms else str(constant)


def _times(stride: int, i: str) -> str:
    if stride == 1:
        return i
    if i.isdigit():
        return str(stride * int(i))
    return f"{stride} * {i}" if i.isidentifier() else f"{stride} * ({i})"


def _plus(begin: int, i: str) -> str:
    if begin == 0:
        return i
    return str(begin + int(i)) if i.isdigit() else f"{begin} + {i}"


def _loops(
    shape: Sequence[int], inner: Sequence[str], indent: str, names: Sequence[str] | None = None
) -> list[str]:
    """Nested loops over a shape around some lines."""
    names = names or [f"i{k}" for k in range(len(shape))]
    lines, depth = [], indent
    for n, name in zip(shape, names, strict=True):
        lines.append(f"{depth}for (int32_t {name} = 0; {name} < {n}; {name}++) {{")
        depth += "    "
    for line in inner:
        lines += wrap(depth + line, depth)
    for _ in shape:
        depth = depth[:-4]
        lines.append(f"{depth}}}")
    return lines


def wrap(line: str, indent: str) -> list[str]:
    """A statement in lines of at most ``WIDTH``, broken at spaces."""
    return [line] if len(line) <= WIDTH else fill(line.split(), indent + "    ")
