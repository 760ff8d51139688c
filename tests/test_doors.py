"""Every public function that takes arrays, against every kind of array that it cannot take.

Each is refused before anything is made of it, and the sentence names what was found. A new function
has to be listed here, or the first test fails.
"""

import inspect

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from PIL import Image

import planish as pl
import planish.analyze as statistics

RNG = np.random.default_rng(3)
SHAPES = {"z": 12, "y": 30, "x": 40, "v": 30, "u": 40}
ARRAY_TYPES = ("Array", "Dataset", "ndarray", "Rows", "Floats", "Bools", "GivenSource")


def labelled(*dims, step=4.0, unit="um"):
    """An array with regular coordinates."""
    shape = [SHAPES[axis] for axis in dims]
    attrs = {"units": unit} if unit else {}
    coords = {axis: (axis, np.arange(SHAPES[axis]) * step, attrs) for axis in dims}
    return xr.DataArray(RNG.normal(100, 20, shape), dims=dims, coords=coords)


MAP, STACK = labelled("y", "x"), labelled("z", "y", "x")
HOLES = xr.Dataset(
    {name: ("mark", RNG.uniform(0, 500, 6), {"units": "um"}) for name in ("x", "y", "diameter")}
)


def dataset(dims, *names):
    grid = labelled(*dims)
    maps = xr.Dataset({name: grid.copy(data=RNG.normal(100, 20, grid.shape)) for name in names})
    return maps.assign(valid=grid > 0) if "image" in names else maps


SURFACES = dataset(("y", "x"), "centre", "top", "bottom")
MAPS = dataset(("v", "u"), "presence", "thickness")
LINKED = dataset(("y", "x"), "image", "thickness")

# --- the functions, what they are given, and what they take -------------------------------------
PIXEL = {"pixel_um": 4.0}


def both(call, **options):
    """A function of two maps, by each of them."""
    return {
        "a": lambda value: call(value, MAP.values, **options),
        "b": lambda value: call(MAP.values, value, **options),
    }


MAP_DOORS = {
    "correlate": both(pl.correlate, **PIXEL)
    | {"mask": lambda value: pl.correlate(MAP.values, MAP.values, mask=value, **PIXEL)},
    "bland_altman": both(statistics.bland_altman, **PIXEL),
    "attenuation_limit": {
        "a": lambda value: statistics.attenuation_limit(value, error_um=5.0, **PIXEL),
        "error_um": lambda value: statistics.attenuation_limit(MAP.values, error_um=value, **PIXEL),
    },
    "coherence": both(statistics.coherence, **PIXEL),
    "compare_instruments": both(statistics.compare_instruments, **PIXEL),
    "cross_correlogram": both(statistics.cross_correlogram, reach_um=20.0, **PIXEL),
    "independent_points": {
        "x": lambda value: statistics.independent_points(value, MAP.values, **PIXEL),
        "y": lambda value: statistics.independent_points(MAP.values, value, **PIXEL),
    },
    "of_short_waves": both(statistics.of_short_waves, **PIXEL),
    "origins": both(statistics.origins, point_um=8.0, **PIXEL),
    "paired_difference": {
        "first": lambda value: statistics.paired_difference(
            (value, MAP.values), (MAP.values, MAP.values), **PIXEL
        ),
        "second": lambda value: statistics.paired_difference(
            (MAP.values, MAP.values), (MAP.values, value), **PIXEL
        ),
    },
    "partial": {
        "a": lambda value: statistics.partial(value, MAP.values, [MAP.values], **PIXEL),
        "b": lambda value: statistics.partial(MAP.values, value, [MAP.values], **PIXEL),
        "covariates": lambda value: statistics.partial(MAP.values, MAP.values, [value], **PIXEL),
    },
    "region_difference": {
        "values": lambda value: statistics.region_difference(value, MAP.values > 100, **PIXEL),
        "inside": lambda value: statistics.region_difference(MAP.values, value, **PIXEL),
    },
    "ring_correlation": both(statistics.ring_correlation, **PIXEL),
    "conley_interval": both(statistics.conley_interval, **PIXEL),
    "light_field": both(statistics.light_field, point_um=4.0),
    "size_curve": both(statistics.size_curve, **PIXEL),
    "split_reliability": {
        "first": lambda value: statistics.split_reliability(value, MAP.values, **PIXEL),
        "second": lambda value: statistics.split_reliability(MAP.values, value, **PIXEL),
    },
    "spread_light": {
        "values": lambda value: statistics.spread_light(value, width_um=50.0, **PIXEL)
    },
    "variogram": {"a": lambda value: statistics.variogram(value, **PIXEL)},
    "print_mottle": {"reflectance": lambda value: statistics.print_mottle(value, **PIXEL)},
    "without_screen": {
        "image": lambda value: statistics.without_screen(value, sigma_um=20.0, **PIXEL),
        "mask": lambda value: statistics.without_screen(
            MAP.values, sigma_um=20.0, mask=value, **PIXEL
        ),
    },
    "cross_fitted": {
        "a": lambda value: statistics.cross_fitted(
            value, MAP.values, lambda a, _: a, valid=None, pixel_um=(4.0, 4.0)
        ),
        "b": lambda value: statistics.cross_fitted(
            MAP.values, value, lambda a, _: a, valid=None, pixel_um=(4.0, 4.0)
        ),
        "valid": lambda value: statistics.cross_fitted(
            MAP.values, MAP.values, lambda a, _: a, valid=value, pixel_um=(4.0, 4.0)
        ),
    },
}
# Values without places.
POINT_DOORS = {
    "deming": {
        "x": lambda value: statistics.deming(value, MAP.values, error_ratio=1, n_eff=50),
        "y": lambda value: statistics.deming(MAP.values, value, error_ratio=1, n_eff=50),
    },
    "straight_or_curved": {
        "x": lambda value: statistics.straight_or_curved(value, MAP.values, n_eff=50),
        "y": lambda value: statistics.straight_or_curved(MAP.values, value, n_eff=50),
    },
    "fit_kubelka_munk": {
        "x": lambda value: statistics.fit_kubelka_munk(value, MAP.values, n_eff=50),
        "y": lambda value: statistics.fit_kubelka_munk(MAP.values, value, n_eff=50),
    },
    "pearson": {
        "x": lambda value: statistics.pearson(value, MAP.values),
        "y": lambda value: statistics.pearson(MAP.values, value),
    },
    "commonality": {
        "b": lambda value: statistics.commonality(value, {"p": MAP.values, "q": MAP.values}),
        "parts": lambda value: statistics.commonality(MAP.values, {"p": MAP.values, "q": value}),
    },
    "random_effects": {
        "effects": lambda value: statistics.random_effects(value, MAP.values),
        "variances": lambda value: statistics.random_effects(MAP.values, value),
    },
    "searched_null": {
        "a": lambda value: statistics.searched_null(value, lambda a, _: a, valid=None),
        "valid": lambda value: statistics.searched_null(MAP.values, lambda a, _: a, valid=value),
    },
}
RAW_DOORS = {
    "volume": {"array": lambda value: pl.volume(value, voxel_um=4.0)},
    "image": {"array": lambda value: pl.image(value, pixel_um=4.0)},
}
VOLUME_DOORS = {
    "find_surfaces": {"volume": pl.find_surfaces},
    "measure_properties": {"volume": lambda value: pl.measure_properties(SURFACES, volume=value)},
    "map_sheet": {"layer": pl.map_sheet},
    "link": {"layers": lambda value: pl.link(value, "image.tif")},
}
IMAGE_DOORS = {
    "correct_light": {"image": lambda value: pl.correct_light(value, white=MAP.values + 300)},
    "find_holes": {"shown": pl.find_holes},
    "register_texture": {
        "moving": lambda value: pl.register_texture(value, MAP),
        "fixed": lambda value: pl.register_texture(MAP, value),
    },
    "resample_maps": {
        "onto": lambda value: pl.resample_maps(
            SURFACES, dataset(("y", "x"), "u", "v"), onto=value, registration=0
        )
    },
    "link": {"layers": lambda value: pl.link("volume.tif", value)},
}
DATASET_DOORS = {
    "find_holes": {"shown": (pl.find_holes, MAPS)},
    "flatten_sheet": {"surfaces": (pl.flatten_sheet, SURFACES)},
    "measure_properties": {"surfaces": (pl.measure_properties, SURFACES)},
    "register_texture": {
        "moving": (lambda value: pl.register_texture(value, MAP), MAPS),
        "fixed": (lambda value: pl.register_texture(MAP, value), MAPS),
    },
    "resample_maps": {
        "measured": (
            lambda value: pl.resample_maps(value, dataset(("y", "x"), "u", "v")),
            SURFACES,
        ),
        "flat": (
            lambda value: pl.resample_maps(SURFACES, value),
            dataset(("y", "x"), "u", "v"),
        ),
    },
    "correlate_maps": {"linked": (pl.correlate_maps, LINKED)},
    "explain": {
        "data": (
            lambda value: pl.explain(value, response="image", of=["thickness"], cell_um=4.0),
            LINKED,
        )
    },
    "scales": {"data": (pl.scales, LINKED)},
}
HOLE_DOORS = {
    "register_marks": {
        "moving": lambda value: pl.register_marks(value, HOLES),
        "fixed": lambda value: pl.register_marks(HOLES, value),
    }
}
TABLES = (
    MAP_DOORS,
    POINT_DOORS,
    RAW_DOORS,
    VOLUME_DOORS,
    IMAGE_DOORS,
    DATASET_DOORS,
    HOLE_DOORS,
)
# What only a run gives: groups of maps of its own, as they stand in its folder.
OF_A_RUN = {
    ("write_report", "groups"),
    ("write_report", "marks"),
    ("register_texture", "holes"),
    ("correlate_layers", "maps"),
    ("correlation_diagnostics", "maps"),
    ("leading_map", "maps"),
    ("mottle_of", "data"),
    ("texture_of", "a"),
    ("texture_of", "b"),
    ("compared_image", "image"),
    ("compared_image", "mask"),
    ("regress", "response"),
    ("regress", "predictors"),
    ("regress", "errors"),
}


def doors():
    """Functions and parameters that take arrays, by their annotations."""
    for package in (pl, statistics):
        for name in package.__all__:
            function = getattr(package, name)
            if not inspect.isfunction(function):
                continue
            for parameter in inspect.signature(function).parameters.values():
                annotation = str(parameter.annotation)
                is_array = any(word in annotation for word in ARRAY_TYPES)
                if (is_array and "Callable" not in annotation) or parameter.name == "array":
                    yield name, parameter.name


def test_every_function_that_takes_arrays_is_listed():
    listed = {(name, parameter) for table in TABLES for name in table for parameter in table[name]}
    assert {*doors()} - listed - OF_A_RUN == set()
    assert (listed | OF_A_RUN) - {*doors()} == set()


def cases(*tables):
    return [
        pytest.param(call, id=f"{name}-{parameter}")
        for table in tables
        for name, calls in table.items()
        for parameter, call in calls.items()
    ]


def said(call, value):
    """The refusal, which is one of ours."""
    with pytest.raises(pl.PlanishError) as caught:
        call(value)
    return str(caught.value)


# --- values that are no numbers -------------------------------------------------------------------
def faulty_values(good):
    yield np.ma.masked_less(good, 90), "masked values, whose mask would be lost"
    yield good.astype(complex), "complex128 values"
    yield good.astype(object), "object values"
    yield good.astype(str), "<U32 values"
    yield good.astype("datetime64[s]"), r"datetime64\[s\] values"
    yield good.astype(np.longdouble), "float128 values"


@pytest.mark.parametrize("call", cases(MAP_DOORS, POINT_DOORS))
def test_statistics_take_numbers_alone(call):
    for value, words in faulty_values(MAP.values):
        kind = "masked" if "masked" in words else "values; needed are"
        assert kind in said(call, value)


@pytest.mark.parametrize(
    ("call", "good"),
    [(RAW_DOORS["volume"]["array"], STACK.values), (RAW_DOORS["image"]["array"], MAP.values)],
)
def test_volumes_and_images_take_numbers_alone(call, good):
    for value, words in faulty_values(good):
        text = said(call, value)
        assert words.replace("\\", "") in text
    assert "bool values" in said(call, good > 100)
    assert "cut off" in said(call, good[:0])
    assert "has the axes" in said(call, good[0])
    assert "has the axes" in said(call, good[..., None, None])
    assert "a list was given" in said(call, good.tolist())
    assert "an array (DataFrame) of 30 x 40" in said(call, pd.DataFrame(MAP.values))


@pytest.mark.ci  # dask is slow to start
def test_masks_of_dask_are_not_lost():
    import dask.array

    masked = dask.array.ma.masked_less(dask.array.from_array(MAP.values, chunks=20), 90)
    assert "dask.array.ma.filled" in said(RAW_DOORS["image"]["array"], masked)
    assert "dask.array.ma.filled" in said(MAP_DOORS["correlate"]["a"], masked)
    plain = dask.array.zeros((30, 40))
    assert "Write np.asarray(a)" in said(MAP_DOORS["correlate"]["a"], plain)
    in_xarray = pl.image(xr.DataArray(masked, dims=("y", "x")), pixel_um=4.0)
    np.testing.assert_array_equal(np.isnan(in_xarray), MAP.values < 90)


def test_pictures_and_frames_get_the_call_to_write():
    grey = Image.fromarray(np.zeros((30, 40), np.uint8))
    assert "Write pl.image(np.asarray(array), pixel_um=...)" in said(pl.image, grey)
    for mode in ("P", "CMYK", "1"):
        text = said(pl.image, grey.convert(mode))
        assert 'Write pl.image(np.asarray(array.convert("RGB")), pixel_um=...)' in text
    frame = pd.DataFrame(MAP.values)
    text = said(lambda value: pl.correlate(value, value, pixel_um=4), frame)
    assert "Write np.asarray(a)" in text


# --- sizes ----------------------------------------------------------------------------------------
def scaled(data, axis, factor=1.0, unit="um", values=None):
    places = data[axis].values * factor if values is None else values
    return data.assign_coords({axis: (axis, places, {"units": unit})})


def faulty_places(good, axis):
    yield scaled(good, axis, 1e-3, "mm"), "are in mm; needed are lengths in um"
    yield scaled(good, axis, 0.25, "pixel"), "are in pixel; needed are lengths in um"
    yield good.isel({axis: slice(None, None, -1)}), "descend; needed are ascending ones"
    uneven = np.delete(np.arange(good.sizes[axis]), [3, 7, 8])
    yield good.isel({axis: uneven}), "are not regular"
    named = good.assign_coords({axis: [f"row {k}" for k in range(good.sizes[axis])]})
    yield named, "needed are lengths in um"


MAPS_WITH_PLACES = [
    case
    for case in cases(MAP_DOORS)
    if case.id.partition("-")[2] not in ("mask", "valid", "inside", "error_um")
]


@pytest.mark.parametrize("call", MAPS_WITH_PLACES)
def test_statistics_follow_the_places_of_maps(call):
    for value, words in faulty_places(MAP, "x"):
        if value.shape == MAP.shape:
            assert words in said(call, value)
    for unit in ("um", ""):
        text = said(call, labelled("y", "x", step=2.0, unit=unit))
        assert "pixel_um= gives 4 x 4 um" in text
        assert "say 2 x 2 um (y, x)" in text
    by_attribute = xr.DataArray(MAP.values, dims=("y", "x"), attrs={"pixel_um": (2.0, 2.0)})
    assert "attribute pixel_um of" in said(call, by_attribute)


def test_places_without_a_unit_are_no_size():
    index = labelled("y", "x", step=1.0, unit="")
    assert "no pixel size" in said(lambda value: pl.correlate(value, value), index)
    assert pl.correlate(MAP, MAP).point_um == 4.0
    assert pl.correlate(MAP, MAP, pixel_um=4.0).point_um == 4.0


PLACED = [
    pytest.param(*case.values, good.assign_attrs(units="1"), id=case.id)
    for tables, good in (
        ((VOLUME_DOORS, {"volume": RAW_DOORS["volume"]}), STACK),
        ((IMAGE_DOORS, {"image": RAW_DOORS["image"]}), MAP),
    )
    for case in cases(*tables)
]


@pytest.mark.parametrize(("call", "good"), PLACED)
def test_volumes_and_images_follow_their_places(call, good):
    for value, words in faulty_places(good, "x"):
        assert words in said(call, value)
    assert "column" in said(call, good.rename(x="column"))


@pytest.mark.parametrize(
    ("call", "good"),
    [case for case in PLACED if "array" not in case.id] + [(pl.volume, STACK), (pl.image, MAP)],
)
def test_a_size_that_the_attribute_contradicts_is_refused(call, good):
    text = said(call, good.assign_attrs(voxel_um=(8, 8, 8), pixel_um=(8, 8)))
    assert "contradicts itself" in text
    assert "4" in text
    assert "8" in text


DATASETS = [
    pytest.param(call, good, id=f"{name}-{parameter}")
    for name, calls in DATASET_DOORS.items()
    for parameter, (call, good) in calls.items()
]


@pytest.mark.parametrize(("call", "good"), DATASETS)
def test_datasets_have_regular_places_in_um(call, good):
    for axis in next(iter(good.data_vars.values())).dims:
        for value, words in faulty_places(good, axis):
            text = said(call, value)
            assert words in text
            assert "drop" not in text
        assert f"no coordinates along {axis}" in said(call, good.drop_vars(axis))
    assert "was given" in said(call, 1)


@pytest.mark.parametrize(("call", "good"), DATASETS)
def test_datasets_hold_numbers(call, good):
    name = next(k for k in ("image", "u", "centre", "presence") if k in good)
    assert "complex128 values" in said(call, good.assign({name: good[name].astype(complex)}))


@pytest.mark.parametrize("call", cases(HOLE_DOORS))
def test_holes_are_numbers_in_um(call):
    assert "x of the holes is in mm; needed is um" in said(
        call, HOLES.assign(x=HOLES.x.assign_attrs(units="mm"))
    )
    assert "object values" in said(call, HOLES.assign(y=HOLES.y.astype(object)))
    assert "not finite" in said(call, HOLES.assign(y=HOLES.y * np.inf))


# --- what is missing ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "call",
    # The maps are too small for the tiles of cross_fitted.
    [case for case in MAPS_WITH_PLACES if "cross_fitted" not in case.id],
)
def test_what_is_infinite_is_missing(call):
    results = []
    for missing in (np.nan, np.inf):
        values = MAP.values.copy()
        values[3:6, 7:9] = missing
        try:
            results.append(repr(call(values)))
        except pl.PlanishError as error:
            results.append(str(error))
    assert results[0] == results[1]


def test_an_image_without_coordinates_keeps_its_size():
    image = pl.image(MAP.values, pixel_um=4.0)
    bare = image.drop_vars(["y", "x"])
    assert pl.find_holes(bare).identical(pl.find_holes(image))
