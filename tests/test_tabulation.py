"""Tables as text."""

import csv
import io

from casid.tabulation import csv_text, markdown_table


def test_csv_keeps_ten_digits_flags_and_commas():
    rows = [["a, b", 1 / 3, True], ["c", 2.0, 3]]
    found = list(csv.reader(io.StringIO(csv_text(["name", "value", "flag"], rows))))
    assert found == [["name", "value", "flag"], ["a, b", "0.3333333333", "true"], ["c", "2", "3"]]


def test_a_bar_in_a_cell_does_not_end_it():
    assert markdown_table(["x|", "y"], [["a|b", "1"]]) == "| x\\| | y |\n|---|---|\n| a\\|b | 1 |"
