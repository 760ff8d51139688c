"""What is easily written wrong in Python, and the sentence that each gets: given, needed, what to
write."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import planish as pl

GREYS, SHOWN = np.zeros((20, 30, 40), np.uint8), np.zeros((30, 40))
VOLUME, IMAGE = pl.volume(GREYS, voxel_um=3), pl.image(SHOWN, pixel_um=5)
PLAIN = xr.DataArray(GREYS, dims=("z", "y", "x"))
MAPS = xr.Dataset(
    {"presence": (("v", "u"), SHOWN)}, coords={"v": np.arange(30) * 5.0, "u": np.arange(40) * 5.0}
)

CASES = [
    # --- a volume or an image is something else
    (
        lambda: pl.find_surfaces(PLAIN),
        (
            "The volume has no size along its axes. Write pl.find_surfaces(pl.volume(array,"
            " voxel_um=...))."
        ),
    ),
    (
        lambda: pl.find_surfaces(GREYS),
        (
            "pl.find_surfaces takes a volume, and an array (ndarray) of 20 x 30 x 40 values was"
            " given. Write pl.find_surfaces(pl.volume(array, voxel_um=...))."
        ),
    ),
    (
        lambda: pl.find_surfaces("volume.tif"),
        (
            "pl.find_surfaces takes a volume, and a path ('volume.tif') was given. Write "
            "pl.find_surfaces(pl.read_volume('volume.tif'))."
        ),
    ),
    (
        lambda: pl.find_surfaces(VOLUME.transpose("x", "y", "z")),
        (
            "A volume has the axes (z, y, x), and an array of 40 x 30 x 20 with (x, y, z) was"
            " given. Write array.transpose('z', 'y', 'x')."
        ),
    ),
    (
        lambda: pl.find_surfaces(VOLUME, params={"cutof_um": 300}),
        "pl.find_surfaces: cutof_um: unknown; did you mean cutoff_um?",
    ),
    (
        lambda: pl.read_volume(GREYS),
        (
            "pl.read_volume takes the path of a file, and an array (ndarray) of 20 x 30 x 40 values"
            " was given. Write pl.volume(array, voxel_um=...)."
        ),
    ),
    (
        lambda: pl.read_image(IMAGE),
        (
            "pl.read_image takes the path of a file, and a DataArray with the dims (y, x) was"
            " given. Write pl.image(array, pixel_um=...)."
        ),
    ),
    (
        lambda: pl.find_holes(SHOWN),
        (
            "pl.find_holes takes an image, and an array (ndarray) of 30 x 40 values was given."
            " Write pl.find_holes(pl.image(array, pixel_um=...))."
        ),
    ),
    # --- sizes
    (
        lambda: pl.volume(GREYS, voxel_um=3000),
        (
            "The volume: the voxel size along z is 3000 um (voxel_um= gives it); possible are"
            " 0.0001 to 1000 um. Check the number and its unit. Give the right one with voxel_um=,"
            " in um."
        ),
    ),
    (
        lambda: pl.volume(GREYS, voxel_um=(3, 3)),
        "voxel_um= has 2 values, it needs 1 or 3 (z,y,x), in um.",
    ),
    # --- results of another stage
    (
        lambda: pl.flatten_sheet(VOLUME),
        (
            "pl.flatten_sheet takes surfaces, and a DataArray with the dims (z, y, x) was given."
            " Write pl.flatten_sheet(pl.find_surfaces(volume))."
        ),
    ),
    (
        lambda: pl.measure_properties(MAPS, params={"maps": ["porosity"], "solid_grey": 180}),
        (
            'property="porosity": measured in the volume, which is not given. Give it with volume=,'
            " or leave them out."
        ),
    ),
    (
        lambda: pl.register_marks(MAPS, IMAGE),
        (
            "pl.register_marks takes holes, and a Dataset with presence was given. Write "
            "pl.register_marks(pl.find_holes(...), fixed)."
        ),
    ),
    (
        lambda: pl.resample_maps(MAPS, MAPS, onto="image.tif"),
        (
            "pl.resample_maps takes measured surfaces, and a Dataset with presence was given. Write"
            " pl.resample_maps(pl.measure_properties(surfaces, volume=volume), flat)."
        ),
    ),
    (
        lambda: pl.correlate_maps(MAPS),
        (
            "pl.correlate_maps takes linked maps, and a Dataset with presence was given. Write"
            " pl.correlate_maps(pl.resample_maps(measured, flat, onto=image,"
            " registration=registration))."
        ),
    ),
    # --- correlations
    (
        lambda: pl.correlate(SHOWN, SHOWN[1:], pixel_um=5),
        "b has (29, 40) pixels, a has (30, 40). Bring both onto one grid first.",
    ),
    (
        lambda: pl.correlate(SHOWN, SHOWN),
        (
            "The maps have no pixel size: they are no maps with coordinates in um. Give it with"
            " pixel_um=."
        ),
    ),
    # --- runs
    (
        lambda: pl.link("volume.tif"),
        "Something to link it to is missing: give two layers or more, the reference last.",
    ),
    (
        lambda: pl.link(GREYS, SHOWN),
        (
            "pl.link takes a volume, and an array (ndarray) of 20 x 30 x 40 values was given. Write"
            " pl.link(pl.volume(array, voxel_um=...), ...)."
        ),
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, thruogh="y"),
        "pl.link: thruogh= is unknown; did you mean through=?",
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, volume={"thruogh": "y"}),
        "volume.thruogh: unknown; did you mean through?",
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, volume="y"),
        "pl.link: volume='y': needed is a dict of options, or one of them by itself.",
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, frame="y"),
        "pl.link: frame= is unknown. The words are those of the command line: planish link --help.",
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, through="w"),
        "through: 'w' is not possible; needed is 'z', 'y' or 'x'",
    ),
    (
        lambda: pl.link(VOLUME, IMAGE, memory="lots"),
        "pl.link: memory: write an amount of memory such as 4GB or 500MB (found 'lots').",
    ),
    (
        lambda: pl.map_sheet(VOLUME, image_side="top"),
        "pl.map_sheet: image_side= is for pl.link, which has an image and marks. Leave it out.",
    ),
    (
        lambda: pl.map_sheet(VOLUME, cutoff_um=-3),
        "cutoff_um: Input should be greater than 0 (found -3)",
    ),
    (
        lambda: pl.open_run("nowhere"),
        f"{Path('nowhere').absolute()} does not exist. Check the name and the folder.",
    ),
    (
        lambda: pl.open_run(None),
        'pl.open_run takes the folder of a run, and None was given. Write pl.open_run("run").',
    ),
    (
        lambda: pl.export("nowhere", "maps", to="tif"),
        "to: 'tif' is not possible; needed is 'tiff'",
    ),
    (lambda: pl.export("nowhere", "maps"), "to: missing."),
    (
        lambda: pl.write_report("page.html"),
        'pl.write_report takes a run, and None was given. Write pl.write_report("page.html", run).',
    ),
    # --- a package is called
    (
        lambda: pl.measure(GREYS),
        "pl.measure is a package, not a function. Call pl.measure_properties(...).",
    ),
    (
        lambda: pl.flatten(GREYS),
        "pl.flatten is a package, not a function. Call pl.flatten_sheet(...).",
    ),
    (
        lambda: pl.map_sheet(VOLUME, property="skin"),
        "There is no property 'skin'. Choose from absorption, ",
    ),
    (
        lambda: pl.make_specimen("demo"),
        (
            "pl.make_specimen takes SpecimenParams, and a path ('demo') was given. Write "
            'pl.make_specimen(folder="sheet").'
        ),
    ),
]


@pytest.mark.parametrize(("call", "sentence"), CASES, ids=[str(k) for k in range(len(CASES))])
def test_a_mistake_gets_its_sentence(call, sentence):
    with pytest.raises(pl.PlanishError) as caught:
        call()
    assert str(caught.value).startswith(sentence)
    assert "--" not in str(caught.value).replace("planish link --help", "")


def test_a_package_that_may_be_called_by_mistake_is_imported_as_before():
    import planish.measure as measure
    from planish.flatten import flatten_sheet

    assert sys.modules["planish.measure"] is measure is pl.measure
    assert (measure.measure_properties, flatten_sheet) == (pl.measure_properties, pl.flatten_sheet)


def test_what_is_no_run_is_refused(tmp_path, linked_run):
    (tmp_path / "file.txt").write_text("x")
    with pytest.raises(pl.PlanishError, match=r"file\.txt is no run. Give the folder that"):
        pl.open_run(tmp_path / "file.txt")
    run = pl.open_run(linked_run)
    with pytest.raises(
        pl.PlanishError,
        match=r"pl.write_report takes the path of the page first, and a Run was given",
    ):
        pl.write_report(run)
    pl.write_report(tmp_path / "page.html", run)
    assert (tmp_path / "page.html").read_bytes() == (linked_run / "report.html").read_bytes()


def test_a_registration_the_other_way_round_is_refused(linked_run):
    run = pl.open_run(linked_run)
    sheet, image = (
        pl.find_holes(run.maps),
        pl.find_holes(run.linked.image.assign_attrs(pixel_um=(5.0, 5.0))),
    )
    swapped = pl.register_marks(image, sheet)
    words = "goes from the image to the sheet; needed is one from the sheet to the image"
    with pytest.raises(pl.PlanishError, match=words):
        pl.resample_maps(
            run.groups["surfaces"], run.groups["flat"], onto=run.linked.image, registration=swapped
        )
    with pytest.raises(
        pl.PlanishError,
        match=r"takes an image, and a path \('i.tif'\) was given.*onto=pl.read_image",
    ):
        pl.resample_maps(
            run.groups["surfaces"], run.groups["flat"], onto="i.tif", registration=swapped
        )


def test_maps_without_a_value_and_words_of_the_command_line(linked_run, tmp_path):
    nothing = xr.DataArray(np.full((30, 40), np.nan), dims=("y", "x"), coords=IMAGE.coords)
    found = pl.correlate(nothing, IMAGE)
    assert np.isnan(found.r)
    assert found.point_um == 5.0  # by the coordinates
    assert found.warnings == ("Only 0 points are valid in both maps.",)
    files = pl.export(linked_run, tmp_path / "map.csv", to="csv", map=["coating_top"])
    assert [path.name for path in files] == ["map.csv"]


def test_a_function_named_as_its_module_stays_a_function():
    assert import_module("planish.measure.depth_profiles").depth_profiles is (
        pl.measure.depth_profiles
    )
