"""Working days read from metropilot's TOML."""

from __future__ import annotations

from metropilot._schema import field_default, field_specs
from metropilot.errors import InputError
from metropilot.railway.day import LATEST_S, Period, ServiceDay
from metropilot.railway.formats.reader import ANY, Node, Range
from metropilot.railway.formats.toml import Document
from metropilot.units import parse_clock


def read_day(root: Node) -> ServiceDay:
    """The working day that a TOML document describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    document = Document(root)
    block, trains = document.block("periods"), document.optional("trains")
    block.may_have_units("headway", "dwell")
    periods = tuple(_period(block, entry, f"list[{k}]") for k, entry in enumerate(block.items("list")))
    more = {}
    if trains is not None:
        usual = float(field_default(ServiceDay, "longest_wait_s"))
        more["longest_wait_s"] = _seconds(trains, "longest_wait", ServiceDay, usual)
        if (fleet := trains.get("fleet")) is not None:
            bounds = _range(ServiceDay, "fleet")
            more["fleet"] = _whole(trains, "fleet", trains.number(fleet, "fleet", None, bounds), "")
    return document.build(
        ServiceDay,
        name=root.text("name"),
        line_id=root.text("line"),
        periods=periods,
        **more,
    )


def _period(block: Node, entry: object, where: str) -> Period:
    if not isinstance(entry, dict):
        raise block.fail("must be a table", where, entry, "{ name, from, to, headway }")
    # The units of the block hold for its entries.
    node = Node({"units": block.get("units")} | entry, block.file, block.at(where))
    node.may_have_units("headway", "dwell")
    name = node.text("name")
    from_s, to_s = (
        parse_clock(node.text(key, allowed="HH:MM"), file=node.file, field=node.at(key), latest_s=LATEST_S)
        for key in ("from", "to")
    )
    headway_s = _seconds(node, "headway", Period)
    dwell_s = _seconds(node, "dwell", Period) if node.get("dwell") is not None else None
    node.close()
    try:
        return Period(name=name, from_s=from_s, to_s=to_s, headway_s=headway_s, dwell_s=dwell_s)
    except InputError as error:
        raise error.at(file=node.file, field=node.at("to")) from None


def _seconds(node: Node, key: str, kind: type, default: float | None = None) -> int:
    """Whole seconds in the range of the field."""
    seconds = node.quantity(key, "time", _range(kind, f"{key}_s"), default)
    return _whole(node, key, seconds, " of seconds")


def _range(kind: type, name: str) -> Range:
    return field_specs(kind)[name].range or ANY


def _whole(node: Node, key: str, value: float, of: str) -> int:
    if value != round(value):
        raise node.fail("must be whole", key, node.get(key), f"a whole number{of}")
    return round(value)
