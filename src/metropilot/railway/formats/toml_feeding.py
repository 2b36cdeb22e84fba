"""Feedings of lines read from metropilot's TOML."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from metropilot._schema import field_default, field_specs
from metropilot.errors import rename_fields
from metropilot.railway.feeding import Feeding, Storage, Substation
from metropilot.railway.formats.reader import ANY, Node
from metropilot.railway.formats.toml import Document

SUBSTATION = {"no_load_voltage": ("no_load_v", "voltage"), "resistance": ("resistance_ohm", "resistance")}
INVERTER = {"voltage": ("inverter_v", "voltage"), "resistance": ("inverter_ohm", "resistance")}
STORAGE = {
    "capacity": ("capacity_j", "energy"),
    "power": ("power_w", "power"),
    "efficiency": ("efficiency", "share"),
    "charge_above": ("charge_above_v", "voltage"),
    "discharge_below": ("discharge_below_v", "voltage"),
    "resistance": ("resistance_ohm", "resistance"),
}
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
    if inverters:
        inverters.require("at", "names of substations, [] for none")
    names = inverters.texts("at") if inverters else ()
    substations = []
    for name, position_m, own in _places(block, Substation, SUBSTATION):
        given = usual | own | (inverter if name in names else {})
        with rename_fields({"inverter_v": "inverters.voltage"}, root.file):
            substations.append(Substation(name=name, position_m=position_m, **given))
    beside, aboard = document.optional("storage"), document.optional("onboard_storage")
    storages = []
    if beside is not None:
        usual = _read(beside, Storage, STORAGE)
        for name, position_m, own in _places(beside, Storage, STORAGE):
            with rename_fields({"charge_above_v": "storage.charge_above"}, root.file):
                storages.append(Storage(name=name, position_m=position_m, **usual | own))
    with rename_fields({"charge_above_v": "onboard_storage.charge_above"}, root.file):
        onboard = None if aboard is None else Storage(name="on board", **_read(aboard, Storage, STORAGE))
    known = [each.name for each in substations]
    for index, name in enumerate(names):
        if inverters and name not in known:
            raise inverters.fail("no such substation", f"at[{index}]", name, ", ".join(known))
    return document.build(
        Feeding,
        name=root.text("name"),
        line_id=root.text("line"),
        substations=tuple(substations),
        storages=tuple(storages),
        onboard=onboard,
        **_read(document.block("rails"), Feeding, RAILS),
        **_read(document.block("trains"), Feeding, TRAINS),
    )


def _places(block: Node, kind: type[Any], keys: Keys) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Name, position and own values of each entry of a block's list."""
    for index, entry in enumerate(block.items("list")):
        where = f"list[{index}]"
        if not isinstance(entry, dict):
            raise block.fail("must be a table", where, entry, "{ name, position }")
        # The units of the block hold for its entries.
        node = Node({"units": block.get("units")} | entry, block.file, block.at(where))
        name = node.text("name")
        position_m = node.quantity("position", "length", ANY)
        own = _read(node, kind, {key: keys[key] for key in keys if key in entry})
        node.may_have_units("position", *keys)
        node.close()
        yield name, position_m, own
    block.may_have_units("position")


def _read(block: Node, kind: type[Any], keys: Keys) -> dict[str, float]:
    """Values of a block by field; a key that is missing has the field's default."""
    return {
        name: block.quantity(key, of, bounds, field_default(kind, name))
        for key, (name, of) in keys.items()
        if (bounds := field_specs(kind)[name].range) is not None
    }
