"""Numbers as they are typed and pasted: either decimal mark, and a refusal where it may be another number."""

import math

import pytest
from nicegui.events import GenericEventArguments

from metropilot.errors import InputError
from metropilot.web.pages.document import parse
from metropilot.web.pages.form import validate
from metropilot.web.pages.numbers import NumberField, parse_number, split_list
from metropilot.web.schemas.requests import DriveIn
from metropilot.web.words.language import answer_in


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("", None),
        ("  ", None),
        ("15", 15),
        ("1.5", 1.5),
        ("1,5", 1.5),
        ("-0,25", -0.25),
        ("−3,5", -3.5),
        ("0,125", 0.125),
        ("1.234", 1.234),
        ("1,2345", 1.2345),
        ("1234,567", 1234.567),
        ("1,234.5", 1234.5),
        ("1.234,5", 1234.5),
        ("1,234,567", 1_234_567),
        ("1.234.567", 1_234_567),
        ("1,234,567.25", 1_234_567.25),
        ("1 234,5", 1234.5),
        ("1\u00a0234", 1234),
        ("1'234.5", 1234.5),
        ("１，５", 1.5),
        ("1。5", 1.5),
        ("1e3", 1000),
        ("5,", 5),
        (",5", 0.5),
    ],
)
def test_either_mark_is_read(text, number):
    assert parse_number(text) == number


@pytest.mark.parametrize(
    "text",
    [
        "1,234",
        "-12,345",
        "999,000",
        "１，２３４",
        "x",
        "-",
        "1,2,3",
        "1.2.3",
        "1,23.4",
        "12,34,567",
        "nan",
        "inf",
        "1_1",
    ],
)
def test_what_is_no_number_or_may_be_two_is_refused_in_one_line(text):
    with pytest.raises(InputError) as refused:
        parse_number(text)
    assert "\n" not in str(refused.value)


def test_the_refusal_names_both_numbers():
    with pytest.raises(InputError, match="thousands or decimals") as refused:
        parse_number("1,234")
    assert refused.value.allowed == "1234 or 1.234"


def test_a_cell_is_read_alike():
    assert [parse(text) for text in ("12", "1,5", "1 000", "2.0", "1,234", "AW0", "")] == [
        12,
        1.5,
        1000,
        2.0,
        "1,234",
        "AW0",
        None,
    ]
    assert isinstance(parse("1 000"), int)
    assert split_list("30, 40,,") == ["30", "40"]
    assert split_list("30,5; 40") == ["30,5", "40"]


def enter(text):
    return GenericEventArguments(sender=None, client=None, args=text)


def test_a_field_says_at_once_what_is_wrong_and_no_request_takes_it():
    field = NumberField.__new__(NumberField)
    for text, value in (("1,1", 1.1), ("1,100", math.nan), ("", None)):
        found = field._event_args_to_value(enter(text))
        assert found == value or (math.isnan(found) and math.isnan(value))
        said = field.refusal(found)
        assert (said is not None) == (text == "1,100")
    field._event_args_to_value(enter("1,100"))
    assert field.refusal(math.nan) == "thousands or decimals (allowed: 1100 or 1.100)"
    with answer_in("zh"):
        assert field.refusal(math.nan) == "是千位分隔还是小数（允许：1100 或 1.100）"
    with pytest.raises(InputError, match="not a number") as refused:
        validate(DriveIn, {"mass_factor": math.nan})
    assert refused.value.field == "mass_factor"
