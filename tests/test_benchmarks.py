"""The benchmarks' page and numbers; what they measure is measured by `make bench`."""

import pytest
from benchmarks.report import Benchmark, Row, cells, circumstances, format_page, number, replace_section


@pytest.mark.parametrize(
    ("value", "text"), [(12_345_678, "12,300,000"), (3.14159, "3.14"), (0.01234, "0.0123")]
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_a_section_of_the_page_is_replaced_and_the_rest_kept():
    page = replace_section(replace_section("# Benchmarks\n", "plant", "old"), "plan", "other")
    again = replace_section(page, "plant", "new")
    assert "old" not in again
    assert again == page.replace("old", "new")
    assert again.index("new") < again.index("other")


def test_a_table_says_where_and_when_it_was_measured():
    about = circumstances(("numpy",))
    assert set(about) == {"machine", "date", "commit", "versions"}
    assert "numpy" in about["versions"]
    rows = [Row("baseline", 10.0, "steps/s", 1.0), Row("ours", 1000.0, "steps/s", 100.0, "more")]
    text = format_page(Benchmark("x", "A title", (), lambda: rows, "A note."), rows, about)
    assert "| " + " | ".join(cells(rows[1])) + " |" in text
    assert about["commit"] in text
