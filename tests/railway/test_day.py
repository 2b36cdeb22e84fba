"""Working days read from files."""

import pytest
from tests.railway import samples

from metropilot.errors import InputError
from metropilot.railway import Period, ServiceDay, import_file, list_days, load_day, load_line
from metropilot.units import format_clock, parse_clock


def test_a_day_is_read_in_seconds(tmp_path):
    path = tmp_path / "toy.toml"
    path.write_text(samples.DAY)
    found = load_day(path)
    assert found == import_file(path)
    assert found == ServiceDay(
        id="toy",
        name="Toy day",
        line_id="toy",
        periods=(
            Period(name="early", from_s=19800, to_s=21600, headway_s=600),
            Period(name="late", from_s=83730, to_s=90000, headway_s=1200, dwell_s=45),
        ),
        fleet=3,
        longest_wait_s=300,
        source={"periods": "made up"},
    )


@pytest.mark.parametrize("key", list_days())
def test_a_day_of_the_catalogue_is_one_of_its_line(key):
    found = load_day(key)
    assert found.id == key
    assert load_line(found.line_id).id == found.line_id
    assert set(found.source) == {"periods", "trains"}


def test_a_file_of_another_kind_and_an_unknown_day_are_named(tmp_path):
    with pytest.raises(InputError, match=r"did you mean 'yizhuang'.*or a path"):
        load_day("yizuang")
    path = tmp_path / "feeding.toml"
    path.write_text(samples.FEEDING)
    with pytest.raises(InputError, match="describes a feeding, not a day"):
        load_day(path)


@pytest.mark.parametrize("time_s", [0, 59, 3661, 86399, 86400, 100_000])
def test_a_clock_reads_back(time_s):
    assert parse_clock(format_clock(time_s)) == time_s


@pytest.mark.parametrize(
    "text", ["", "7", "7:5", "07:60", "-1:00", "07:00:60", "07:00:00.5", "\u0660\u0667:00"]
)
def test_no_clock_is_refused(text):
    with pytest.raises(InputError, match="not a time"):
        parse_clock(text, field="from")


def test_a_time_beyond_the_day_is_refused_as_a_time(tmp_path):
    path = tmp_path / "day.toml"
    path.write_text(
        'kind = "day"\nid = "late"\nname = "Late"\nline = "toy"\n[periods]\nunits = { headway = "s" }\n'
        'list = [{ name = "night", from = "23:00", to = "37:00", headway = 600 }]\n'
    )
    with pytest.raises(InputError) as refused:
        load_day(path)
    said = refused.value.line()
    assert "periods.list[0].to: out of range: '37:00' (allowed: 00:00:00 to 36:00:00)" in said
