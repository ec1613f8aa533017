"""Tables of the terminal."""

from aerodima.workbench.core.text_table import shown_value


def test_rounding_of_a_zero_is_a_zero_and_an_empty_text_is_none():
    assert [shown_value(value) for value in (-5.4e-16, 13.6012, None, "", True)] == [
        "0",
        "13.6",
        "–",
        "none",
        "True",
    ]
