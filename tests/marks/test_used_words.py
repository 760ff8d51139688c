"""The column ``used`` of a table of marks, as spreadsheets of several languages save it."""

import pytest

from planish.core.errors import MarkError
from planish.marks import read_any

HEADER = "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um,used"


def table(path, words):
    rows = [f"{k},{k}00,{k * k}00,{k}50,{k * k}50,{word}" for k, word in enumerate(words, 1)]
    path.write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    return path


def test_words_for_no_in_several_languages_leave_a_row_out(tmp_path):
    words = ["true", "WAHR", "ja", "", "1", "FALSCH", "nein", "Faux", "0"]
    marks = read_any(table(tmp_path / "m.csv", words))
    assert marks["label"].values.tolist() == ["1", "2", "3", "4", "5"]


def test_another_word_is_a_fault_of_its_row(tmp_path):
    path = table(tmp_path / "m.csv", ["yes", "maybe", "yes", "yes"])
    with pytest.raises(MarkError, match=r"row 3: used is 'maybe', which is neither yes nor no"):
        read_any(path)
