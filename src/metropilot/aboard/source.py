"""Folder of C files of a supervised driver: header, source, example with its plant, test vectors."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from metropilot._io import fill_folder
from metropilot._provenance import provenance
from metropilot.aboard.emit import emit_body
from metropilot.aboard.preamble import preamble
from metropilot.aboard.program import NUMBERS, AboardProgram, scheduled_time_s
from metropilot.aboard.tables import TYPES, Tables, literal
from metropilot.aboard.wasm import compile_wasm
from metropilot.physics import Forces, State
from metropilot.railway import Section
from metropilot.sim import Rollout, Run

TOLERANCES = {"double": "1e-9", "float": "2e-3"}
"""Largest difference of a command in the test vectors."""
SPARED = {"double": "0.0", "float": "0.05"}
"""Share of the periods in which it may be larger: in single precision a policy may switch earlier."""
DRIVER_FILES = ("driver.h", "driver.c")
VECTOR_SECTIONS = 4
"""Sections in the test vectors."""


@dataclass(frozen=True)
class AboardReport:
    """Report on the files of a driver.

    Attributes:
        folder: The folder.
        files: Names of the files.
        sections: Sections, as ``ORIGIN-DESTINATION``.
        number: Number type.
        table_bytes: Size of the constant tables, network included.
        vectors: Periods in the test vectors.
    """

    folder: Path
    files: tuple[str, ...]
    sections: tuple[str, ...]
    number: str
    table_bytes: int
    vectors: int


def write_driver(
    program: AboardProgram, folder: Path, *, compiler: Sequence[str] | None = None
) -> AboardReport:
    """Write the folder.

    Args:
        program: The driver.
        folder: Folder; it is made, and files of the same names are replaced.
        compiler: Command of a compiler for WebAssembly (:func:`find_zig`), to write the module too.

    Raises:
        InputError: It cannot be written, an operation has no form in C, or the compiler refuses the source.
    """
    texts, table_bytes = driver_texts(program, door=compiler is not None)
    rows = vector_rows(program)
    head = "section,time_s,position_m,speed_mps,acceleration_mps2,scheduled_s,share,level"
    texts["vectors.csv"] = "\n".join([head, *rows]) + "\n"

    with fill_folder(folder) as scratch:
        for name, text in texts.items():
            (scratch / name).write_text(text, encoding="utf-8")
        if compiler is not None:
            compile_wasm(scratch, identifier(program.name), compiler)
        names = sorted(path.name for path in scratch.iterdir())
    return AboardReport(
        folder=folder,
        files=tuple(names),
        sections=tuple(_section_name(each) for each in program.sections),
        number=program.number,
        table_bytes=table_bytes,
        vectors=len(rows),
    )


def identifier(name: str) -> str:
    """A name as a C identifier."""
    found = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"driver_{found}" if not found or found[0].isdigit() else found


def driver_texts(program: AboardProgram, *, door: bool = False) -> tuple[dict[str, str], int]:
    """Texts of all files but the vectors, by name, and the size of the driver's tables in bytes.

    Args:
        program: The driver.
        door: With the files for WebAssembly; door and module are yet to be put into the page.
    """
    name, dtype = identifier(program.name), np.dtype(NUMBERS[program.number])
    policy, supervision = program.memory
    tables, plant_tables = Tables(), Tables()
    values = {
        "NAME": name,
        "GUARD": name.upper(),
        "REAL": program.number,
        "TITLE": _plain(f"Driver {program.name} under protection"),
        "ABOUT": _about(program),
        "TRAINSET": _plain(program.trainset.id),
        "PERIOD": f"{program.bounds.dt_s:g}",
        "COUNT": str(len(program.sections)),
        "TOLERANCE": TOLERANCES[program.number],
        "SPARED": SPARED[program.number],
        "ENUM": "\n".join(
            f"    {name.upper()}_{identifier(_section_name(each)).upper()} = {k},"
            for k, each in enumerate(program.sections)
        ),
        "JS_SECTIONS": "\n".join(_section_script(each) for each in program.sections),
        "DOOR": "@DOOR@",
        "WASM": "@WASM@",
        "SECTIONS": "\n".join(_section_row(each, dtype) for each in program.sections),
        "POLICY": _fields(policy._asdict(), dtype, 8),
        "PROTECTION": _fields(supervision._asdict(), dtype, 8),
        "STATE": _fields(_flat_state(program.plant), dtype, 4),
        "INIT": "\n".join(
            [*_initial("state->policy", policy, dtype), *_initial("state->protection", supervision, dtype)]
        ),
        "DECIDE": _decide(program, tables),
        "SUPERVISE": _supervise(program, tables),
        "MOVE": _move(program, plant_tables),
    }
    for key, table in (("TABLES", tables), ("PLANT_TABLES", plant_tables)):
        values[key] = "\n".join(table.lines)
    values["PREAMBLE"] = preamble(values["TABLES"] + values["DECIDE"] + values["SUPERVISE"])
    plant = values | {"PREAMBLE": preamble(values["MOVE"]), "TABLES": values["PLANT_TABLES"]}
    texts = {f"{name}{Path(each).suffix}": _fill(each, values) for each in DRIVER_FILES}
    texts |= {each: _fill(each, plant) for each in ("plant.h", "plant.c")}
    texts |= {each: _fill(each, values) for each in ("example.c", "check.c", "ats.c", "Makefile")}
    if door:
        texts |= {each: _fill(each, values) for each in ("door.c", "door.mjs", "drive.html")}
    return texts, tables.bytes


def _fill(template: str, values: Mapping[str, str]) -> str:
    """A template with its ``@NAME@`` replaced."""
    text = files("metropilot.aboard").joinpath("templates", template).read_text(encoding="utf-8")
    return re.sub(r"@([A-Z_]+)@", lambda match: values[match[1]], text)


def _about(program: AboardProgram) -> str:
    known, (first, *_) = provenance(), program.sections
    sections = ", ".join(_section_name(each) for each in program.sections[:4])
    more = f" and {len(program.sections) - 4} more" if len(program.sections) > 4 else ""
    bounds = program.bounds
    margins = (*bounds.mass, *bounds.resistance)
    low, high, least, most = (f"{each:g}" for each in margins)
    allowance = f"{low} to {high} times the nominal mass and {least} to {most} times the resistance"
    trainset = f"{program.trainset.id}, {program.trainset.mass_kg:g} kg"
    lines = (
        f"{trainset}, {first.line_id}, {sections}{more}.",
        f"Protection allows for {allowance},",
        "and no error of odometry.",
        f"metropilot {known['metropilot']}, commit {known.get('commit', 'unknown')[:10]}.",
    )
    return "\n * ".join(map(_plain, lines))


def _plain(text: str) -> str:
    """A text that ends no comment, string or element, in C, make, JavaScript or HTML; ``?`` for the rest."""
    return re.sub(r"[^\w .,:;@+()/-]", "?", text, flags=re.ASCII)


def _section_name(section: Section) -> str:
    return f"{section.origin.code}-{section.destination.code}"


def _section_row(section: Section, dtype: np.dtype) -> str:
    """Initialiser of a section: stations, length, scheduled running time."""
    numbers = (dtype.type(section.length_m), dtype.type(section.planned_time_s or 0.0))
    stations = (_plain(each.code) for each in (section.origin, section.destination))
    words = [*(f'"{each}"' for each in stations), *(literal(each, dtype) for each in numbers)]
    return f"    {{{', '.join(words)}}},"


def _section_script(section: Section) -> str:
    """The same for JavaScript."""
    values = {
        "origin": section.origin.name,
        "destination": section.destination.name,
        "length_m": section.length_m,
        "scheduled_s": section.planned_time_s or 0.0,
    }
    return f"  {json.dumps(values)},".replace("<", "\\u003c")


def _c_type(value: Any, dtype: np.dtype) -> str:  # noqa: ANN401 (a number or an array)
    found = np.asarray(value).dtype
    return TYPES[dtype.name if found.kind == "f" else found.name]


def _fields(values: Mapping[str, Any], dtype: np.dtype, indent: int) -> str:
    """Members of a struct."""
    lines = []
    for name, value in values.items():
        size = f"[{np.size(value)}]" if np.ndim(value) else ""
        lines.append(f"{' ' * indent}{_c_type(value, dtype)} {name}{size};")
    return "\n".join(lines)


def _initial(place: str, tree: Any, dtype: np.dtype) -> Iterable[str]:  # noqa: ANN401 (a NamedTuple of arrays)
    """Statements that set the members that are not zero at departure."""
    for name, value in tree._asdict().items():
        array = np.asarray(value)
        kind = dtype if array.dtype.kind == "f" else array.dtype
        for k, each in enumerate(array.reshape(-1)):
            if each != 0:
                yield f"    {place}.{name}{f'[{k}]' if array.ndim else ''} = {literal(each, kind)};"


def _members(place: str, names: Iterable[str]) -> list[str]:
    return [f"{place}{name}" for name in names]


def _decide(program: AboardProgram, tables: Tables) -> str:
    """The function that decides; of a driver with a graph for each section one that calls theirs."""
    name = identifier(program.name)
    memory = _members("state->policy.", program.memory.policy._fields)
    measured = [
        f"input->{name}" for name in ("time_s", "position_m", "speed_mps", "acceleration_mps2", "scheduled_s")
    ]
    given = [*measured, "state->protection.level", *memory]
    several, parts = len(program.decide) > 1, []
    for number, graph in enumerate(program.decide):
        section = ["state->section"] if len(graph.inputs) > len(given) else []
        body = emit_body(graph, [*section, *given], ["share", *memory], tables)
        head = f"static {name}_real decide{f'_{number}' if several else ''}({name}_state *state, "
        head += f"const {name}_input *input)\n{{\n    {name}_real share;"
        parts.append("\n".join([head, *body, "    return share;\n}"]))
    if several:
        cases = [f"    case {k}: return decide_{k}(state, input);" for k in range(len(program.decide) - 1)]
        parts.append(
            "\n".join(
                [
                    f"static {name}_real decide({name}_state *state, const {name}_input *input)\n{{",
                    "    switch (state->section) {",
                    *cases,
                    f"    default: return decide_{len(program.decide) - 1}(state, input);",
                    "    }\n}",
                ]
            )
        )
    return "\n\n".join(parts)


def _supervise(program: AboardProgram, tables: Tables) -> str:
    memory = _members("state->protection.", program.memory.supervision._fields)
    given = ["state->section", "input->position_m", "input->speed_mps", "share", "emergency", *memory]
    verdict = ["level", "output->permitted_mps", "output->emergency_mps", "output->valid"]
    return "\n".join(
        emit_body(program.supervise, given, ["output->share", "output->emergency", *memory, *verdict], tables)
    )


def _flat_state(plant: State) -> dict[str, Any]:
    """Fields of a state of the plant, its forces among the others."""
    values: dict[str, Any] = {}
    for name, value in plant._asdict().items():
        values |= value._asdict() if isinstance(value, Forces) else {name: value}
    return values


def _move(program: AboardProgram, tables: Tables) -> str:
    members = _members("plant->", _flat_state(program.plant))
    return "\n".join(
        emit_body(program.move, ["plant->section", *members, "share", "emergency"], members, tables)
    )


def vector_rows(program: AboardProgram) -> list[str]:
    """Drives in Python as rows of test vectors: the first sections, each in its scheduled running time."""
    rows = []
    for number, section in enumerate(program.sections[:VECTOR_SECTIONS]):
        rows += [",".join(map(_number, row)) for row in drive_vectors(program, section, number)]
    return rows


def _number(value: float | int) -> str:
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def drive_vectors(program: AboardProgram, section: Section, number: int) -> Sequence[tuple[float | int, ...]]:
    """Measurements and supervised commands of one drive in Python, by period."""
    scheduled_s = scheduled_time_s(section, program.trainset)
    run = Run(section, program.trainset, scheduled_s, dt=program.bounds.dt_s)
    rollout = Rollout(run, program.driver)
    rows: list[tuple[float | int, ...]] = []
    while rollout.outcome is None:
        plant = rollout.state.plant
        measured = (plant.time_s, plant.position_m, rollout.state.measured_mps, plant.acceleration_mps2)
        moment = rollout.advance()
        given = (float(each) for each in (*measured, rollout.scheduled_time_s, moment.command))
        rows.append((number, *given, moment.level))
    return rows
