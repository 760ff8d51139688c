"""The gallery's example of an own property runs as it stands."""

import runpy
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "own_property.py"


def test_the_example_runs_and_says_what_it_measured(capsys):
    maps = runpy.run_path(str(EXAMPLE))["main"]()
    said = capsys.readouterr().out
    assert "Brightness of the base near its faces" in said
    # the base's filler is denser in its middle: at most some tenths
    assert 0.7 < float(maps["skin"].mean()) < 1.1
    assert maps["skin"].attrs["units"] == "1"
    assert int(maps["skin"].notnull().sum()) > 5000
