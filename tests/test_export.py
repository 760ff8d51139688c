"""``planish export``: what is taken from a run, where it goes, what is refused."""

import csv
import hashlib
import json
import shutil
import sys
from dataclasses import replace

import meshio
import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr

import planish as pl
from exports.contents import files_of
from folders import bytes_of, refused
from planish.core.errors import FileError, InputError, ResourceError, StudyError
from planish.core.grid import Grid, values_at
from planish.exports import FORMATS, ExportParams, ome_zarr, writer_of
from planish.io import map_store, write_tree
from planish.run import open_run

SUFFIXES = {to: form.suffixes[0] for to, form in FORMATS.items() if form.suffixes}
ONE = {"maps": ["coating_top"]}
SURFACE = {"maps": ["top", "thickness"], "mesh_um": 40.0}
OF_A_FILE = {
    "ply": SURFACE,
    "obj": SURFACE,
    "stl": SURFACE,
    "vtk": SURFACE,
    "itk": {},
    "bigwarp": {},
    "nrrd": {},
    "zarr": {},
    "csv": {},
    "netcdf": {},
}
"""Options with which one file is written of the small run."""


def test_an_option_says_in_its_help_which_formats_it_is_for():
    for name in {option for form in FORMATS.values() for option in form.options}:
        help_text = ExportParams.model_fields[name].description
        assert help_text.startswith(
            f"{', '.join(to for to, form in FORMATS.items() if name in form.options)}: "
        )


# --- every format, of a run -----------------------------------------------------------------------
def holds_map(path, run):
    np.testing.assert_allclose(tifffile.imread(path), run.linked["coating_top"].values, rtol=1e-6)


def holds_surface(path, run):
    nodes = meshio.read(path).points[:, :3]
    assert len(nodes) > 300
    x, y = (xr.DataArray(nodes[:, k], dims="node") for k in (0, 1))
    column = run.groups["surfaces"]["top"].sel(x=x, y=y, method="nearest")
    np.testing.assert_allclose(nodes[:, 2], column, rtol=1e-5)


def holds_transform(path, run):
    sitk = pytest.importorskip("SimpleITK")
    transform, points = sitk.ReadTransform(str(path)), np.array([[300.0, 250.0], [900.0, 700.0]])
    found = [transform.TransformPoint(point) for point in points.tolist()]
    np.testing.assert_allclose(found, run.registrations["sheet"](points), atol=0.02)


def holds_landmarks(path, run):
    """From the first pixels on."""
    u0, v0 = Grid.of(run.maps).origin_um
    rows = {
        row[0]: [float(v) for v in row[2:]]
        for row in csv.reader(path.read_text(encoding="utf-8").splitlines())
    }
    for mark in range(run.marks.sizes["mark"]):
        one = run.marks.isel(mark=mark)
        expected = [
            float(v) for v in (one.moving_x - u0, one.moving_y - v0, one.fixed_x, one.fixed_y)
        ]
        np.testing.assert_allclose(rows[str(one.label.values)], expected)


HOLDS = {
    "tiff": holds_map,
    "ply": holds_surface,
    "itk": holds_transform,
    "bigwarp": holds_landmarks,
}
"""One of each content; that the other formats hold what they are given is in tests/exports."""


@pytest.mark.parametrize("to", list(SUFFIXES))
def test_one_file_is_written_of_each_format_and_holds_what_the_run_does(linked_run, tmp_path, to):
    path = tmp_path / "out" / f"Blatt µ{SUFFIXES[to]}"
    assert pl.export(linked_run, path, to=to, **OF_A_FILE.get(to, ONE)) == [path]
    assert list(path.parent.iterdir()) == [path]  # no partial file is left
    study = hashlib.sha256((linked_run / "run.toml").read_bytes()).hexdigest()
    if to not in ("stl", "bigwarp"):  # which have no room for it
        coded = [study.encode(code) for code in ("utf-8", "utf-16-le", "utf-16-be")]
        assert any(code in data for data in files_of(path).values() for code in coded)
    if to in HOLDS:
        HOLDS[to](path, open_run(linked_run))


@pytest.mark.parametrize(
    ("to", "names"),
    [
        ("tiff", {"coating_top.tif", "image.tif"}),
        ("ome-zarr", {"coating_top.ome.zarr", "image.ome.zarr"}),
        (
            "ply",
            {
                f"{name}.ply"
                for name in ("top", "bottom", "interface_top", "interface_bottom", "centre")
            },
        ),
        ("itk", {"sheet_to_image.tfm", "image_to_sheet.tfm"}),
        ("elastix", {"sheet_to_image.txt", "image_to_sheet.txt"}),  # a similarity is affine
        ("bigwarp", {"sheet_to_image.csv"}),
        ("csv", {"linked.csv"}),
        ("zarr", {"sheet_to_image.zarr"}),
    ],
)
def test_a_folder_gets_a_file_for_each(linked_run, tmp_path, to, names):
    out = tmp_path / "out"
    options = {"maps": ["coating_top", "image"]} if "maps" in FORMATS[to].holds[:1] else {}
    made = pl.export(linked_run, out, to=to, **options)
    assert sorted(made) == sorted(out.iterdir())
    assert {path.name for path in made} == names


def test_large_maps_are_read_part_by_part_with_the_same_bytes(linked_run, tmp_path, monkeypatch):
    formats = {"tiff": ".tif", "netcdf": ".nc", "csv": ".csv"}
    for to, suffix in formats.items():
        pl.export(linked_run, tmp_path / f"one{suffix}", to=to, maps=["coating_top", "valid"])
    monkeypatch.setattr(map_store, "LARGE_BYTES", 1)
    for to, suffix in formats.items():
        pl.export(linked_run, tmp_path / f"two{suffix}", to=to, maps=["coating_top", "valid"])
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


def test_chunks_of_a_store_are_copied_and_are_those_that_would_be_written(
    tmp_path, monkeypatch, linked_run
):
    run, maps = stored_run(linked_run, tmp_path), ["coating_top", "valid", "tilt"]
    copied = []
    usual = ome_zarr._copied
    monkeypatch.setattr(ome_zarr, "_copied", lambda *a: copied.append(usual(*a)) or copied[-1])
    pl.export(run, tmp_path / "one.zarr", to="ome-zarr", maps=maps)
    assert copied == [True, False, False]  # truth values and float64 are written anew
    monkeypatch.setattr(ome_zarr, "_copied", lambda *_: False)
    pl.export(run, tmp_path / "two.zarr", to="ome-zarr", maps=maps)
    assert files_of(tmp_path / "one.zarr") == files_of(tmp_path / "two.zarr")


def stored_run(linked_run, tmp_path):
    """A copy of a run whose linked maps are so large that they were stored tile by tile."""
    run = tmp_path / "run"
    shutil.copytree(linked_run, run, ignore=shutil.ignore_patterns("maps.zarr"))
    grid, rng = Grid.regular((1300, 1100), 2.0, (5.0, 7.0)), np.random.default_rng(1)
    coating = rng.normal(17, 4, grid.shape).astype(np.float32)
    coating[rng.random(grid.shape) < 0.3] = np.nan
    names = {
        "coating_top": coating,
        "valid": np.isfinite(coating),
        "tilt": rng.normal(size=grid.shape),
    }
    maps = xr.Dataset(
        {name: (("y", "x"), values, {"units": "um"}) for name, values in names.items()},
        coords=grid.coords,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(map_store, "LARGE_BYTES", 1)
        sink = map_store.StoredMaps(run / "maps.zarr")
        for tile in map_store.map_tiles(grid.shape):
            sink.add("linked", grid, tile, maps.isel(y=tile.rows, x=tile.cols))
    write_tree(run / "maps.zarr", {})
    return run


# --- what is worked out ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    "names", [(), ("image", "coating_top", "tilt", "u", "volume_x", "volume_z")]
)
def test_a_table_of_points_correlates_as_the_run_does(linked_run, tmp_path, names):
    """Also where the map of valid pixels is not among those that are written."""
    path = tmp_path / "points.csv"
    pl.export(linked_run, path, to="csv", maps=names)
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()[1:]))
    a, b = (np.array([float(row[name]) for row in rows]) for name in ("coating_top_um", "image"))
    results = json.loads((linked_run / "results.json").read_text(encoding="utf-8"))
    expected = next(
        r for r in results["correlations"] if r["a_map"] == "coating_top" and r["point_um"] == 100.0
    )
    assert (len(rows), np.corrcoef(a, b)[0, 1]) == (
        expected["n"],
        pytest.approx(expected["r"], abs=1e-6),
    )
    assert {"x_um", "y_um", "volume_x_um", "volume_z_um", "u_um", "tilt_deg", "valid_share"} <= set(
        rows[0]
    )


def test_the_image_comes_to_the_flat_sheet(linked_run, tmp_path):
    path = tmp_path / "image.tif"
    pl.export(linked_run, path, to="tiff", group="maps", maps=["image"])
    run = open_run(linked_run)
    found = tifffile.imread(path)
    grid = Grid.of(run.maps)
    assert found.shape == grid.shape
    x, y = np.meshgrid(grid.x_um, grid.y_um)
    at = run.registrations["sheet"](np.stack([x, y], axis=-1).reshape(-1, 2))
    expected = values_at(run.linked, ["image"], at)[:, 0].reshape(grid.shape)
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.mean() > 0.9
    # Pixels of 4 um are smaller than those of 5 um in the image: bilinear values, places to 0.01
    # pixel.
    steep = np.nanmax(np.abs(np.gradient(run.linked["image"].values, axis=1)))
    assert np.abs(found - expected)[both].max() < 0.02 * steep


@pytest.fixture(scope="module")
def flat(linked_run, tmp_path_factory):
    """The straightened volume of the small run: values, and heights of its planes."""
    path = tmp_path_factory.mktemp("flat") / "flat.ome.zarr"
    pl.export(linked_run, path, to="ome-zarr", group="straightened")
    store = zarr.open_group(path, mode="r")
    scale, first = (
        one[kind]
        for one, kind in zip(
            store.attrs["ome"]["multiscales"][0]["datasets"][0]["coordinateTransformations"],
            ("scale", "translation"),
            strict=True,
        )
    )
    values = store["0"][...]
    return values, first[0] + scale[0] * np.arange(len(values)), (scale, first)


def test_the_sheet_lies_flat_in_the_straightened_volume(linked_run, flat):
    values, heights, (scale, first) = flat
    run = open_run(linked_run)
    grid = Grid.of(run.maps)
    assert (values.shape[1:], scale) == (grid.shape, [4.0, *grid.pixel_um])
    assert first[1:] == list(grid.origin_um[::-1])
    thickness = run.maps["thickness"].values
    known = np.isfinite(thickness) & np.isfinite(values).all(axis=0)
    assert known.mean() > 0.3
    columns, surfaces = values[:, known], run.groups["surfaces"]
    level = 0.5 * (surfaces.attrs["grey_air"] + surfaces.attrs["grey_coating_top"])
    inside, k = columns > level, np.arange(known.sum())
    low, high = np.argmax(inside, axis=0), len(heights) - 1 - np.argmax(inside[::-1], axis=0)
    step = scale[0]
    bottom = heights[low] - step * (columns[low, k] - level) / (
        columns[low, k] - columns[low - 1, k]
    )
    top = heights[high] + step * (columns[high, k] - level) / (
        columns[high, k] - columns[high + 1, k]
    )
    # Crossings of half the contrast are where the faces are for a coating that is thicker than the
    # blur.
    off = top - bottom - thickness[known]
    assert abs(np.median(off)) < 0.2
    assert np.percentile(np.abs(off), 90) < 0.5 * step
    # The centre surface is the mean of both faces, smoothed.
    assert abs(np.mean(0.5 * (top + bottom))) < 1.0


@pytest.mark.parametrize(("to", "suffix"), [("tiff", ".tif"), ("ome-tiff", ".ome.tif")])
def test_heights_of_the_straightened_volume_are_the_same_in_every_format(
    linked_run, tmp_path, flat, to, suffix
):
    path = tmp_path / f"flat{suffix}"
    pl.export(linked_run, path, to=to, group="straightened", depth_um=(-8.0, 12.0))
    first = int(np.flatnonzero(flat[1] == -8.0)[0])
    np.testing.assert_array_equal(tifffile.imread(path), flat[0][first : first + 6])
    # As planish itself reads it.
    np.testing.assert_allclose(pl.read_volume(path).attrs["voxel_um"], flat[2][0], rtol=1e-6)
    with pytest.raises(
        StudyError, match="give two heights in um from the centre surface, the lower one first"
    ):
        pl.export(linked_run, tmp_path / "no", to=to, group="straightened", depth_um=(12.0, -8.0))


def test_an_export_needs_the_very_volume_that_was_mapped(run_copy, specimen_files, tmp_path):
    text = (run_copy / "run.toml").read_text(encoding="utf-8")
    old = next(
        line for line in text.splitlines() if line.startswith("path") and "volume.tif" in line
    )
    data = bytearray(specimen_files[0].read_bytes())
    data[-1] ^= 1
    (tmp_path / "other.tif").write_bytes(data)
    for name, words in (
        (
            "gone.tif",
            (
                r"volume.tif of this run is needed, and .*gone.tif is not there. Put it back, or"
                r" write where"
            ),
        ),
        ("other.tif", "is another file than the one that was mapped"),
    ):
        path = json.dumps(str(tmp_path / name))
        (run_copy / "run.toml").write_text(text.replace(old, f"path = {path}"), encoding="utf-8")
        refused(
            FileError,
            words,
            pl.export,
            run_copy,
            tmp_path / "flat.tif",
            to="tiff",
            group="straightened",
        )


def test_a_crate_describes_the_run(linked_run, tmp_path):
    made = pl.export(linked_run, tmp_path / "crate", to="crate")
    assert made == [tmp_path / "crate"]
    graph = json.loads((tmp_path / "crate" / "ro-crate-metadata.json").read_text(encoding="utf-8"))[
        "@graph"
    ]
    entities = {one["@id"]: one for one in graph}
    assert entities["ro-crate-metadata.json"]["conformsTo"] == {
        "@id": "https://w3id.org/ro/crate/1.1"
    }
    parts = {one["@id"] for one in entities["./"]["hasPart"]}
    assert {"results.json", "run.toml", "report.html", "marks.json", "maps.zarr/"} <= parts
    for name in ("results.json", "marks.json"):
        data = (tmp_path / "crate" / name).read_bytes()
        assert data == (linked_run / name).read_bytes()
        assert entities[name]["sha256"] == hashlib.sha256(data).hexdigest()
    action = entities["#run"]
    assert action["@type"] == "CreateAction"
    assert {one["@id"] for one in action["object"]} == {"#input-sheet", "#input-image"}
    run = open_run(linked_run)
    assert entities["#input-sheet"]["sha256"] == run.results.layers[0].source.sha256
    assert (
        xr.open_datatree(tmp_path / "crate/maps.zarr", engine="zarr")["linked"].sizes
        == run.linked.sizes
    )
    pl.export(linked_run, tmp_path / "again", to="crate")
    assert bytes_of(tmp_path / "crate") == bytes_of(tmp_path / "again")


# --- what is refused ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "out", "error", "words"),
    [
        (
            {"to": "tiff", "maps": ["coatng_top"]},
            "o",
            InputError,
            (
                r"no map 'coatng_top' in the group linked. Did you mean coating_top\? It holds"
                r" base_surface_bottom, .*warp"
            ),
        ),
        (
            {"to": "tiff", "group": "link"},
            "o",
            InputError,
            r"no group 'link'; it holds .* mean linked\?",
        ),
        (
            {"to": "itk", "group": "shet"},
            "o",
            InputError,
            r"No layer 'shet' is registered; .*Did you mean sheet\?",
        ),
        (
            {"to": "ply", "maps": ["topp"]},
            "o",
            InputError,
            r"no map 'topp' in the surfaces. Did you mean top\?",
        ),
        (
            {"to": "ply", "group": "maps"},
            "o",
            InputError,
            "PLY holds surfaces, and group= says maps",
        ),
        (
            {"to": "netcdf", "group": "straightened"},
            "o",
            InputError,
            "as tiff, ome-tiff, ome-zarr, not as netcdf",
        ),
        (
            {"to": "tiff"},
            "maps.png",
            FileError,
            r"maps.png ends as PNG does .* Give a name that ends in .tif",
        ),
        ({"to": "tiff"}, "maps.ome.tif", FileError, "ends as OME-TIFF does"),
        (
            {"to": "csv"},
            "points.tsv",
            FileError,
            r"has the ending .tsv, and to= says csv. Give a name that",
        ),
        (
            {"to": "png"},
            "map.png",
            StudyError,
            "map.png holds one map, and 25 are asked for. Choose one with map=",
        ),
        (
            {"to": "ply"},
            "s.ply",
            StudyError,
            "s.ply holds one surface, and there are 5. Choose one of top, bottom",
        ),
        (
            {"to": "itk", "maps": ["image"]},
            "o",
            StudyError,
            "ITK holds a registration, and map= chooses maps",
        ),
        (
            {"to": "csv", "mesh_um": 50.0},
            "o",
            StudyError,
            "mesh_um= is for ply, obj, stl, vtk, and to= says csv",
        ),
        (
            {"to": "tiff", "depth_um": (0.0, 9.0)},
            "o",
            StudyError,
            'depth_um= is for group="straightened"',
        ),
        ({"to": "crate", "maps": ["image"]}, "o", StudyError, "An RO-Crate holds the whole run"),
    ],
)
def test_what_cannot_be_is_refused(linked_run, tmp_path, options, out, error, words):
    refused(error, words, pl.export, linked_run, tmp_path / out, **options)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_stays(linked_run, tmp_path):
    (tmp_path / "maps.tif").write_text("mine")
    (tmp_path / "folder").mkdir()
    for name in ("maps.tif", "folder"):
        with pytest.raises(FileError, match=r"exists already. Results are never written over"):
            pl.export(linked_run, tmp_path / name, to="tiff")
    assert (tmp_path / "maps.tif").read_text() == "mine"
    with pytest.raises(FileError, match="which is read; nothing is written there"):
        pl.export(linked_run, linked_run / "maps", to="tiff")


@pytest.mark.parametrize(("to", "out"), [("netcdf", "o"), ("ome-zarr", "o.zarr")])
def test_an_export_that_fails_leaves_nothing(linked_run, tmp_path, monkeypatch, to, out):
    write = writer_of(to)

    def broken(content, path, history, params):
        write(content, path, history, params)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys.modules[write.__module__], write.__name__, broken)
    refused(
        ResourceError,
        "The disk is full while writing",
        pl.export,
        linked_run,
        tmp_path / out,
        to=to,
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", ["gwy", "ply"])  # a map, and a surface
def test_what_is_too_large_for_a_format_is_refused_before_work(
    refuses, linked_run, monkeypatch, to
):
    monkeypatch.setitem(FORMATS, to, replace(FORMATS[to], most=1000))
    refuses(
        "export",
        linked_run,
        "--to",
        to,
        words=f"{FORMATS[to].title} is written of at most 0 million",
        code=5,
    )
    monkeypatch.setitem(FORMATS, to, replace(FORMATS[to], most=10**9, byte_cost=10**12))
    refuses("export", linked_run, "--to", to, words="Allow more with --memory", code=5)


def test_a_library_of_the_extra_is_named(linked_run, tmp_path, monkeypatch):
    monkeypatch.setitem(FORMATS, "gwy", replace(FORMATS["gwy"], needs="no_such_library"))
    with pytest.raises(
        InputError, match=r'needs the library no_such_library.* pip install "planish\[export\]"'
    ):
        pl.export(linked_run, tmp_path / "o.gwy", to="gwy")


def test_a_damaged_store_is_refused(run_copy, tmp_path):
    (run_copy / "maps.zarr" / "linked" / "coating_top" / "c" / "0" / "0").unlink()
    with pytest.raises(
        FileError, match="is damaged: 1 of 1 chunks of linked/coating_top are not there"
    ):
        pl.export(run_copy, tmp_path / "o", to="tiff")


def test_a_run_in_memory_without_a_link_has_maps_and_no_registration(linked_run, tmp_path):
    run = open_run(linked_run)
    sheet = run.results.model_copy(update={"layers": run.results.layers[:1]})
    groups = {name: group for name, group in run.groups.items() if name != "linked"}
    alone = replace(run, results=sheet, groups=groups, registrations={}, folder=None)
    made = pl.export(alone, tmp_path / "maps.nc", to="netcdf")
    with xr.open_dataset(made[0], engine="h5netcdf") as found:
        assert set(found.data_vars) == set(run.maps.data_vars)
        np.testing.assert_array_equal(found["tilt"], run.maps["tilt"])
    refused(InputError, "nothing is registered", pl.export, alone, tmp_path / "no", to="itk")
    with pytest.raises(InputError, match="no map 'image' in the group maps"):
        pl.export(alone, tmp_path / "no", to="tiff", maps=["image"])


# --- the command ----------------------------------------------------------------------------------
def test_the_command_reports_what_it_made(passes, refuses, linked_run, tmp_path):
    made = tmp_path / "c.gwy"
    out, _ = passes("export", linked_run, "--to", "gwy", "--map", "coating_top", "--out", made)
    assert (
        out.strip()
        == f"{made}: Gwyddion, 1 file; missing values: the mask; below it the mean of the map"
    )
    out, _ = passes("export", linked_run, "--to", "elastix", "--out", tmp_path / "e", "--json")
    files = [name.rpartition("/")[2] for name in json.loads(out)["files"]]
    assert files == ["sheet_to_image.txt", "image_to_sheet.txt"]
    png = ("--to", "png", "--out", tmp_path / "p.png")
    refuses(
        "export", linked_run, *png, words="holds one map, and 25 are asked for", code=2, out=False
    )
