"""Tables of specimens and studies with [[specimens]]: what they become, and what is wrong with
them."""

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from planish.cli import planish
from planish.core.errors import InputError, PlanishError
from planish.series import read_plan


def write(folder, text, name="specimens.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_table_gives_files_factors_and_options(tmp_path):
    table = write(
        tmp_path,
        "volume,image,Paper,sheet,volume.through\na/v.tif,a/i.tif,Süd"
        " 1,1,y\nb/v.tif,b/i.tif,Nord,1,\n",
    )
    first, second = read_plan(table).specimens
    assert first.name == "Süd 1-1"
    assert first.files == (str(tmp_path / "a" / "v.tif"), str(tmp_path / "a" / "i.tif"))
    assert (first.factors, first.changes) == (
        {"paper": "Süd 1", "sheet": "1"},
        ("volume.through=y",),
    )
    assert second.changes == ()


@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_the_table_of_any_spreadsheet_is_read(tmp_path, sign):
    table = tmp_path / "specimens.csv"
    table.write_bytes("name;volume\r\nA 1;v.tif\r\n".replace(";", sign).encode("utf-8-sig"))
    assert [one.name for one in read_plan(table).specimens] == ["A 1"]


def test_specimens_are_named_by_factors_files_or_numbers_and_studies_name_each_other(tmp_path):
    def names(text):
        return [one.name for one in read_plan(write(tmp_path, text)).specimens]

    assert names("volume,sheet\na.tif,1\nb.tif,2\n") == ["1", "2"]
    assert names("volume,sheet\na.tif,1\nb.tif,1\n") == ["a", "b"]
    assert names("volume,sheet\nx/v.tif,1\ny/v.tif,1\n") == ["specimen-1", "specimen-2"]
    series = write(tmp_path, SERIES, "series.toml")
    single = write(tmp_path, '[volume]\npath = "v.tif"\n', "study.toml")
    for verb, path, other in (("run", series, "planish study"), ("study", single, "planish run")):
        done = CliRunner().invoke(planish, [verb, str(path), "--out", str(tmp_path / "out")])
        assert other in str(done.exception)
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("image,sheet\ni.tif,1\n", "neither a column volume nor layers"),
        ("volume,image\n", "names no specimen"),
        ("", "is empty"),
        ("volume,image\nv.tif\n", "row 2 has 1 columns, the header 2"),
        ("name,volume\nA,a.tif\na,b.tif\n", "row 3: the name 'a' as row 2"),
        ("name,volume\nA,a.tif\nB,a.tif\n", "row 3: the same files and options as row 2"),
        ("name,volume\nA/B,a.tif\n", "cannot name a specimen"),
        ("name,volume,image\nA,,i.tif\n", "row 2: no volume"),
        ("name,volume,layers\nA,a.tif,x.tif;y.tif\n", "not both"),
        (
            "name;volume;image.pixel_um\nA;a.tif;4,1\n",
            "row 2: image.pixel_um '4,1' may be 4.1, or the two numbers 4 and 1",
        ),
    ],
)
def test_what_is_wrong_with_a_table_is_named_with_its_row(tmp_path, text, words):
    with pytest.raises(InputError, match=r"specimens\.csv") as caught:
        read_plan(write(tmp_path, text))
    assert words in str(caught.value)


SERIES = """
[volume]
through = "y"
[correlate]
point_um = 50
[compare]
margin = { coating_top = 0.5 }
[[specimens]]
volume = "v.tif"
image = "i.tif"
sheet = 1
set = ["volume.top=low"]
[[specimens]]
volume = "w.tif"
image = "i.tif"
sheet = 2
"""


def test_a_study_with_specimens_shares_its_options(tmp_path):
    plan = read_plan(write(tmp_path, SERIES, "series.toml"), ("volume.voxel_um=3",))
    first, second = plan.specimens
    assert plan.declared.margin == {"coating_top": 0.5}
    assert (first.factors, second.factors) == ({"sheet": "1"}, {"sheet": "2"})
    tifffile.imwrite(tmp_path / "v.tif", np.zeros((9, 8, 7), np.uint8), imagej=True)
    tifffile.imwrite(tmp_path / "i.tif", np.zeros((8, 7), np.uint8))
    study = plan.study(first)
    volume = study.layers[0].volume
    assert (volume.through, volume.top, volume.voxel_um) == ("y", "low", (3.0, 3.0, 3.0))
    assert study.correlate.point_um == 50.0
    # a file that is missing concerns its specimen alone.
    with pytest.raises(PlanishError, match=r"w\.tif"):
        plan.study(second)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('through = "y"', 'thruogh = "y"', "line 3, volume.thruogh: unknown; did you mean through"),
        ("point_um = 50", "point_um = -1", "line 5, correlate.point_um"),
        ("margin = { coating_top = 0.5 }", "margni = 1", "compare.margni"),
        (
            "margin = { coating_top = 0.5 }",
            "compare = 'paper'",
            "no specimen has that factor; there are sheet",
        ),
        ("sheet = 1", "sheet = [1]", "line 8: sheet has to be a text or a number"),
        ('set = ["volume.top=low"]', 'set = "volume.top=low"', "set is a list of texts"),
        ('volume = "v.tif"\n', "", "line 8: no volume"),
        ("[correlate]", "layers = []\n[correlate]", "layers"),
    ],
)
def test_what_is_wrong_with_a_series_is_named_with_its_line(tmp_path, old, new, words):
    assert old in SERIES
    with pytest.raises(InputError) as caught:
        read_plan(write(tmp_path, SERIES.replace(old, new, 1), "series.toml"))
    assert words in str(caught.value)


def test_unknown_maps_and_foreign_folders_are_refused_before_anything_is_linked(tmp_path):
    misspelt = write(
        tmp_path,
        SERIES.replace("margin = {", "headline = ['coatng_top']\nmargin = {"),
        "misspelt.toml",
    )
    series = write(tmp_path, SERIES, "series.toml")
    (tmp_path / "foreign").mkdir()
    for study, out, words in (
        (misspelt, "out", "Did you mean coating_top?"),
        (series, "foreign", "exists already"),
    ):
        done = CliRunner().invoke(planish, ["study", str(study), "--out", str(tmp_path / out)])
        assert words in str(done.exception)
    assert not (tmp_path / "out").exists()
    assert list((tmp_path / "foreign").iterdir()) == []
