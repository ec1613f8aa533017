"""Tables of the terminal."""

from aerodima.workbench.text_table import shown_value, text_table


def test_rounding_of_a_zero_is_a_zero_and_an_empty_text_is_none():
    assert [shown_value(value) for value in (-5.4e-16, 13.6012, None, "", True)] == [
        "0",
        "13.6",
        "–",
        "none",
        "True",
    ]


def test_columns_are_as_wide_as_their_cells_and_headings_do_not_count():
    rows = [["a heading that is long"], ["x", "1"], ["yyy", "22"]]
    assert text_table(["", "run"], rows) == [
        "     run",
        "a heading that is long",
        "x    1",
        "yyy  22",
    ]
