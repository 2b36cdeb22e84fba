"""Feedings of lines read from metropilot's TOML."""

from __future__ import annotations

from typing import Any

from metropilot._schema import field_default, field_specs
from metropilot.errors import rename_fields
from metropilot.railway.feeding import Feeding, Substation
from metropilot.railway.formats.reader import ANY, Node
from metropilot.railway.formats.toml import Document

SUBSTATION = {"no_load_voltage": ("no_load_v", "voltage"), "resistance": ("resistance_ohm", "resistance")}
INVERTER = {"voltage": ("inverter_v", "voltage"), "resistance": ("inverter_ohm", "resistance")}
RAILS = {
    "conductor": ("conductor_ohm_per_m", "resistance per length"),
    "running": ("running_ohm_per_m", "resistance per length"),
}
TRAINS = {
    "max_current": ("max_current_a", "current"),
    "reduced_below": ("reduced_below_v", "voltage"),
    "cut_off": ("cut_off_v", "voltage"),
    "squeezed_above": ("squeezed_above_v", "voltage"),
    "max_voltage": ("max_v", "voltage"),
}
Keys = dict[str, tuple[str, str]]


def read_feeding(root: Node) -> Feeding:
    """The feeding that a TOML document describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    document = Document(root)
    block, inverters = document.block("substations"), document.optional("inverters")
    usual = _read(block, Substation, SUBSTATION)
    inverter = _read(inverters, Substation, INVERTER) if inverters else {}
    names = inverters.texts("at") if inverters else ()
    substations = []
    for index, entry in enumerate(block.items("list")):
        where = f"list[{index}]"
        if not isinstance(entry, dict):
            raise block.fail("must be a table", where, entry, "{ name, position }")
        # The units of the block hold for its entries.
        node = Node({"units": block.get("units")} | entry, block.file, block.at(where))
        name = node.text("name")
        position_m = node.quantity("position", "length", ANY)
        own = _read(node, Substation, {key: SUBSTATION[key] for key in SUBSTATION if key in entry})
        node.may_have_units("position", *SUBSTATION)
        node.close()
        given = usual | own | (inverter if name in names else {})
        with rename_fields({"inverter_v": "inverters.voltage"}, root.file):
            substations.append(Substation(name=name, position_m=position_m, **given))
    known = [each.name for each in substations]
    for index, name in enumerate(names):
        if inverters and name not in known:
            raise inverters.fail("no such substation", f"at[{index}]", name, ", ".join(known))
    block.may_have_units("position")
    return document.build(
        Feeding,
        name=root.text("name"),
        line_id=root.text("line"),
        substations=tuple(substations),
        **_read(document.block("rails"), Feeding, RAILS),
        **_read(document.block("trains"), Feeding, TRAINS),
    )


def _read(block: Node, kind: type[Any], keys: Keys) -> dict[str, float]:
    """Values of a block by field; a key that is missing has the field's default."""
    return {
        name: block.quantity(key, of, bounds, field_default(kind, name))
        for key, (name, of) in keys.items()
        if (bounds := field_specs(kind)[name].range) is not None
    }
