"""Feedings read from files."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.railway import samples

from metropilot.errors import InputError
from metropilot.railway import Feeding, Substation, import_file, list_feedings, load_feeding, load_line


def test_a_feeding_is_read_in_si(tmp_path):
    path = tmp_path / "toy.toml"
    path.write_text(samples.FEEDING)
    found = load_feeding(path)
    assert found == import_file(path)
    assert found == Feeding(
        id="toy",
        name="Toy feeding",
        line_id="toy",
        substations=(
            Substation(position_m=0.0, name="A", no_load_v=850.0, resistance_ohm=0.02),
            Substation(
                position_m=1500.0,
                name="B",
                no_load_v=850.0,
                resistance_ohm=0.008,
                inverter_v=870.0,
                inverter_ohm=0.04,
            ),
        ),
        conductor_ohm_per_m=8e-6,
        running_ohm_per_m=0.018 / 1000.0,
        max_current_a=6000.0,
        reduced_below_v=550.0,
        cut_off_v=500.0,
        squeezed_above_v=875.0,
        max_v=900.0,
        source={"substations": "made up"},
    )
    assert found.ohm_per_m == pytest.approx(2.6e-5)


def test_values_left_out_are_those_of_the_page(tmp_path):
    path = tmp_path / "bare.toml"
    place = 'units.position = "m"\nlist = [{ name = "A", position = 0 }]'
    names = "[onboard_storage]\n[rails]\n[trains]"
    header = 'kind = "feeding"\nid = "bare"\nname = "Bare"\nline = "toy"'
    path.write_text(f"{header}\n[substations]\n{place}\n[storage]\n{place}\n{names}\n")
    found = load_feeding(path)
    (substation,), (storage,) = found.substations, found.storages
    words = (
        f"{substation.no_load_v:g} V and {1e3 * substation.resistance_ohm:g} mohm (inverters "
        f"{1e3 * substation.inverter_ohm:g} mohm), rails {1e6 * found.conductor_ohm_per_m:g} and "
        f"{1e6 * found.running_ohm_per_m:g} mohm/km, trains {found.max_current_a:g} A, "
        f"{found.reduced_below_v:g}, {found.cut_off_v:g}, {found.squeezed_above_v:g} and {found.max_v:g} V, "
        f"storages {storage.capacity_j / 3.6e6:g} kWh, {storage.power_w / 1e3:g} kW, "
        f"{100 * storage.efficiency:g} %, {storage.charge_above_v:g} and {storage.discharge_below_v:g} V, "
        f"{1e3 * storage.resistance_ohm:g} mohm"
    )
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    assert words in " ".join(page.split())


@pytest.mark.parametrize("key", list_feedings())
def test_a_feeding_of_the_catalogue_stands_at_stations_of_its_line(key):
    found = load_feeding(key)
    line = load_line(found.line_id)
    assert found.id == key
    for each in found.substations:
        assert line.station(each.name).position_m == each.position_m
    assert set(found.source) == {"substations", "rails", "trains"}
    found.check_line(line)
    other = load_line("lu2023")
    with pytest.raises(InputError, match=r"a feeding of another line: 'yizhuang' \(allowed: lu2023\)"):
        found.check_line(other)
    with pytest.raises(InputError, match=r"substation off the line: (?!SJZ).*\(allowed: 0 to 1538 m\)"):
        replace(found, line_id=other.id).check_line(other)


def test_a_no_load_voltage_no_train_runs_on_is_named(tmp_path):
    path = tmp_path / "toy.toml"
    path.write_text(samples.FEEDING.replace("no_load_voltage = 850", "no_load_voltage = 400"))
    words = r"substations\[0\]\.no_load_voltage: out of order: 400.* V \(allowed: between 500 and 900 V\)"
    with pytest.raises(InputError, match=words):
        load_feeding(path)


def test_an_unknown_feeding_lists_the_catalogue():
    with pytest.raises(InputError, match=r"did you mean 'yizhuang'.*or a path"):
        load_feeding("yizuang")


STORAGE = """
[BLOCK]
units = { position = "m", charge_above = "V", discharge_below = "V", resistance = "mohm" }
list = [{ name = "S", position = 100 }]
"""


@pytest.mark.parametrize(
    ("block", "line", "told"),
    [
        ("storage", "charge_above = 950", "storage.charge_above: a voltage that is never reached: 950 V"),
        (
            "storage",
            "discharge_below = 450",
            "storage.discharge_below: a voltage that is never reached: 450 V",
        ),
        (
            "onboard_storage",
            "charge_above = 900",
            "onboard_storage.charge_above: a voltage that is never reached",
        ),
        (
            "storage",
            "resistance = 0.1",
            "storage.resistance: out of range: 0.1 mohm (allowed: 1 to 100000 mohm)",
        ),
    ],
)
def test_a_storage_that_never_does_anything_is_refused(block, line, told, tmp_path):
    text = STORAGE.replace("BLOCK", block).replace("list", f"{line}\nlist")
    if block == "onboard_storage":
        text = "\n".join(each for each in text.splitlines() if not each.startswith("list"))
        text = text.replace('position = "m", ', "")
    path = tmp_path / "toy.toml"
    path.write_text(samples.FEEDING + text)
    with pytest.raises(InputError) as refused:
        load_feeding(path)
    assert told in refused.value.line()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "voltage = 870\n",
            "voltage = 900\n",
            "a voltage that is never reached: 900 V (allowed: below max_voltage of the trains, 900 V)",
        ),
        ("resistance = 20", "resistance = 1e-9", "substations.resistance: out of range: 1e-09 mohm"),
        ("conductor = 8", "conductor = 1e-9", "rails.conductor: out of range: 1e-09 mohm/km"),
    ],
)
def test_what_is_never_reached_or_only_rounding_is_refused(old, new, told, tmp_path):
    path = tmp_path / "toy.toml"
    assert old in samples.FEEDING
    path.write_text(samples.FEEDING.replace(old, new))
    with pytest.raises(InputError) as refused:
        load_feeding(path)
    assert told in refused.value.line()
