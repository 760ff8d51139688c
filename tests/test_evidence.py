"""What a link says of its correlations: independent points, intervals, scales, what could be
seen."""

import math

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from planish.analyze import (
    CorrelateParams,
    commonality,
    correlate,
    correlate_layers,
    correlation_diagnostics,
    leading_map,
    partial,
)
from planish.analyze.compare import CorrelationRow
from planish.core.area import area_mean
from planish.core.errors import InputError
from planish.measure.registry import PARTS, registered, shared_parts
from planish.report import summary
from planish.report.sentences import table
from planish.report.sentences.partial import say_over_control
from planish.report.sentences.wording import Wording
from planish.results import Results
from planish.run import Compute, as_study, preflight
from report.runs import a_run


@pytest.fixture(scope="module")
def results(linked_run):
    return Results.read(linked_run / "results.json")


@pytest.fixture(scope="module")
def layers(specimen_files):
    """The two layers of a study."""
    volume, image = (str(path) for path in specimen_files[:2])
    return {"volume": {"path": volume}, "image": {"path": image}}


def test_a_row_is_what_the_function_says_of_the_maps(results, linked):
    row = next(r for r in results.correlations if r.a_map == "coating_top" and r.point_um == 100)
    valid = linked["valid"].values.astype(bool)
    pixel = tuple(float(np.diff(linked[k].values[:2])[0]) for k in "yx")
    found = correlate(
        linked["coating_top"].values.astype(float),
        linked["image"].values.astype(float),
        mask=valid,
        pixel_um=pixel,
        point_um=100.0,
    )
    assert (row.n, row.r, row.n_eff) == pytest.approx((found.n, found.r, found.n_eff), nan_ok=True)
    assert row.warnings == found.warnings


def test_registrations_are_compared_on_the_same_pixels(results):
    at_pixel = [r for r in results.comparison if r.point_um == results.comparison[0].point_um]
    assert len(at_pixel) >= 3
    assert len({r.n for r in at_pixel}) == 1
    assert math.isnan(at_pixel[-1].difference)
    for row in at_pixel[:-1]:
        assert row.difference == pytest.approx(at_pixel[-1].r - row.r)
        assert row.difference_interval[0] <= row.difference <= row.difference_interval[1]


def test_the_headline_has_its_scales_and_attenuation_limit(results):
    (found,) = results.evidence
    assert (found.a_map, found.b_map, found.declared) == ("coating_top", "image", False)
    assert len(found.sizes) >= 4
    assert len(found.bands) >= 2
    for row in found.sizes:
        if row.band is not None:
            assert row.band[0] < row.interval[0] < row.r < row.interval[1] < row.band[1]
    assert 0.9 < found.attenuation_limit <= 1
    assert found.curve is None or found.curve.r2_line <= found.curve.r2_parabola


def test_what_to_be_careful_about_stands_on_the_first_page():
    results = Results.model_validate(a_run()["results"])
    rows = [
        row.model_copy(update={"warnings": ("Only 17 independent points.",)})
        for row in results.correlations
    ]
    assert summary.cautions(results.model_copy(update={"correlations": tuple(rows)})) == [
        "Only 17 independent points."
    ]
    withheld = [row.model_copy(update={"trust": "withheld"}) for row in rows]
    assert summary.cautions(results.model_copy(update={"correlations": tuple(withheld)})) == []


def test_a_relation_that_saturates_is_named():
    maps = drawn(shape=(240, 320))
    thick = 10 + 2 * ndimage.gaussian_filter(maps["sheet"]["coating_top"].values, 6) / 0.047
    maps["sheet"]["coating_top"][:] = thick
    maps["image"]["image"][:] = 1 - np.exp(-thick / 5) + 0.01 * maps["image"]["image"].values
    found = evidence_of(maps, point_um=50)
    assert found.curve.words == "curved, saturating"
    assert any("curved, saturating" in s for s in sentences(found, 50.0))


def test_the_page_says_who_named_the_headline(linked_run):
    page = (linked_run / "report.html").read_text(encoding="utf-8")
    assert "the study declared none" in page
    assert "Scales at which coating thickness (top side) and" in page
    assert "<script" not in page


@pytest.mark.parametrize(
    ("option", "names", "words"),
    [
        ("--headline", ["coating_topp"], "coating_top,"),
        ("--beside", ["gloss"], "there will be no such map"),
        ("--beside", ["thickness", "thickness"], "stands there twice"),
        ("--beside", ["coating_top"], "leads already"),
        (
            "--beside",
            ["thickness", "base_thickness", "coating_bottom"],
            "nothing is left to correlate",
        ),
    ],
)
def test_maps_that_cannot_lead_or_stand_beside_are_refused_before_the_volume_is_read(
    refuses, specimen_files, option, names, words
):
    given = [word for name in names for word in (option, name)]
    assert "read:" not in refuses("link", *specimen_files, *given, words=words)


@pytest.mark.parametrize(
    ("properties", "name"),
    [
        ({"coating_g_cm3": 1.6}, "coat_weight_top"),  # by its density
        ({"coat_weight_bottom_g_m2": 12.0}, "coat_weight_bottom"),  # as weighed
        ({"base_g_cm3": 0.8}, "grammage"),  # of a sheet that turns out not to be coated
        ({"solid_grey": 180.0}, "porosity"),
        ({"maps": ["fibre_angle"]}, "fibre_cos2"),  # measured together with it
        ({}, "tilt"),  # costs nothing
    ],
)
def test_a_map_that_its_numbers_make_may_lead_or_stand_beside(layers, properties, name):
    """The rules ``when`` and ``together`` of the properties; without its number a map will not
    be."""
    for place in ({"headline": name}, {"beside": [name]}):
        parts = layers | {"correlate": place}
        assert (
            preflight.check_request(as_study(parts | {"properties": properties}), Compute()) is None
        )
        if properties:
            with pytest.raises(InputError, match=f'{name}"?: there will be no such map'):
                preflight.check_request(as_study(parts), Compute())


def test_angles_of_an_axis_have_no_r_and_neither_lead_nor_stand_beside(layers):
    words = "fibre_angle holds angles of an axis.* fibre_cos2 and fibre_sin2"
    properties = {"properties": {"maps": ["fibre_angle"]}}
    for place in ({"headline": "fibre_angle"}, {"beside": ["fibre_angle"]}):
        with pytest.raises(InputError, match=words):
            preflight.check_request(as_study(layers | properties | {"correlate": place}), Compute())
    maps = with_base()
    maps["sheet"]["fibre_angle"] = maps["sheet"]["base_thickness"] * 0 + 5.0
    with pytest.raises(InputError, match=words):
        evidence_of(maps, point_um=20, declared=True, beside=("fibre_angle",))
    with pytest.raises(InputError, match=words):
        leading_map(maps["sheet"], "top", "fibre_angle")
    with pytest.raises(InputError, match=words):
        correlate(maps["sheet"]["fibre_angle"], maps["image"]["image"])


def test_two_of_three_parts_may_stand_beside_and_of_labels_maps_of_the_faces_may_lead(layers):
    parts = layers | {"correlate": {"beside": ["base_thickness", "coating_bottom"]}}
    assert preflight.check_request(as_study(parts), Compute()) is None
    parts = layers | {"surface": {"labels": {}}, "properties": {"coating_g_cm3": 1.6}}
    assert (
        preflight.check_request(
            as_study(parts | {"correlate": {"headline": "thickness"}}), Compute()
        )
        is None
    )
    with pytest.raises(InputError, match=r'coat_weight_top"?: there will be no such map'):
        preflight.check_request(
            as_study(parts | {"correlate": {"headline": "coat_weight_top"}}), Compute()
        )


@pytest.mark.ci
def test_a_declared_headline_leads_and_what_stands_beside_it_is_stated(
    planish, specimen_files, linked_run, tmp_path
):
    given = (
        "--headline",
        "coating_bottom",
        "--beside",
        "base_thickness",
        "--beside",
        "topography_top",
    )
    assert planish("link", linked_run, specimen_files[1], "--out", tmp_path / "run", *given)[0] in (
        0,
        4,
    )
    (found,) = Results.read(tmp_path / "run" / "results.json").evidence
    assert (found.a_map, found.declared) == ("coating_bottom", True)
    assert found.partial.given == ("base_thickness", "topography_top")
    assert -1 < found.partial.r < 1
    assert len(found.commonality) == 7
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "declared in the study, before r" in page
    assert "Given base thickness and topography top, r = " in page


def drawn(seed=0, shape=(120, 160)):
    rng = np.random.default_rng(seed)
    coords = {"y": 5.0 * np.arange(shape[0]), "x": 5.0 * np.arange(shape[1])}
    um = {"units": "um", "role": "property"}
    sheet = xr.Dataset(
        {
            "coating_top": (("y", "x"), rng.normal(size=shape), um),
            "thickness": (("y", "x"), rng.normal(size=shape), um),
            "valid": (("y", "x"), np.ones(shape, bool)),
        },
        coords,
    )
    image = xr.Dataset(
        {"image": (("y", "x"), rng.normal(size=shape)), "valid": sheet["valid"]}, coords
    )
    return {"sheet": sheet, "image": image}


def with_base(seed=1, *, shape=(120, 160)):
    """A sheet whose coating and image both follow the base, and beyond it each other with r =
    0.6."""
    maps, rng = drawn(seed, shape), np.random.default_rng(seed + 1)
    base, own, rest = (rng.normal(size=shape) for _ in range(3))
    um = {"units": "um", "role": "property"}
    maps["sheet"]["coating_top"][:] = own + base
    maps["sheet"]["base_thickness"] = (("y", "x"), base, um)
    maps["image"]["image"][:] = 0.6 * own + 0.8 * rest - 2 * base
    return maps


def test_a_partial_r_is_what_the_function_says_of_the_points():
    maps = with_base()
    maps["sheet"]["valid"][20:40, 30:70] = False
    maps["sheet"]["base_thickness"][60:80, 90:120] = np.nan
    names = ("base_thickness", "thickness")
    found = evidence_of(maps, point_um=20, declared=True, beside=names)
    known = maps["sheet"]["valid"].values & np.isfinite(maps["sheet"]["base_thickness"].values)
    top, base, whole, image = (
        area_mean(np.where(known, m.values, np.nan), (4.0, 4.0))
        for m in (*(maps["sheet"][k] for k in ("coating_top", *names)), maps["image"]["image"])
    )
    twin = partial(top, image, [base, whole], pixel_um=20.0)
    assert found.partial.given == names
    assert (found.partial.r, found.partial.n, found.partial.n_eff) == pytest.approx(
        (twin.r, twin.n, twin.n_eff)
    )
    assert found.partial.interval == pytest.approx(twin.interval)
    assert found.partial.r == pytest.approx(0.6, abs=0.08)
    assert correlate(top, image, pixel_um=20.0).r < -0.3
    shares = commonality(image, {"coating_top": top, "base_thickness": base, "thickness": whole})
    assert found.commonality == pytest.approx(shares)


def test_the_page_says_the_partial_r():
    maps = with_base(shape=(60, 80))
    found = evidence_of(maps, point_um=20, declared=True, beside=("base_thickness",))
    (said,) = [s for s in sentences(found, 20.0) if s.startswith("Given base thickness, r = 0.")]
    assert f"{found.commonality['coating_top']:.2f} of the variance" in said
    without = evidence_of(maps, point_um=20, declared=True)
    assert (without.partial, without.commonality) == (None, None)
    assert not any("Given" in s for s in sentences(without, 20.0))


@pytest.mark.parametrize(
    ("a", "b", "shared"),
    [
        ("coating_top", "thickness", ["coating_top"]),
        ("half_thickness_top", "coating_bottom", ["coating_bottom"]),
        ("topography_top", "thickness", ["topography_top"]),
        ("half_thickness_bottom", "thickness", ["half_thickness_bottom"]),
        (
            "half_thickness_top",
            "half_thickness_bottom",
            ["coating_top", "coating_bottom", "base_thickness"],
        ),
        ("half_thickness_top", "topography_top", ["topography_top"]),
        # the thickness cancels in it
        ("half_thickness_difference", "thickness", ["topography_top", "topography_bottom"]),
        (
            "half_thickness_difference",
            "half_thickness_top",
            ["topography_top", "coating_bottom", "base_surface_bottom"],
        ),
        (
            "half_thickness_difference",
            "base_thickness",
            ["base_surface_top", "base_surface_bottom"],
        ),
        ("roughness_top", "topography_top", ["roughness_top"]),
        ("fibre_anisotropy", "fibre_sin2", ["fibre_sin2"]),
        ("fibre_cos2", "fibre_sin2", []),
        ("ink_depth_50", "ink_depth_95", ["ink_depth_50"]),
        ("coating_difference", "coat_weight_bottom", ["coating_bottom"]),
        ("coating_top", "base_thickness", []),
        ("topography_top", "topography_bottom", []),
        ("ash", "thickness", []),  # of one's own
    ],
)
def test_what_two_maps_are_both_made_up_of(a, b, shared):
    names = {*PARTS, *(part for parts in PARTS.values() for part in parts), a, b}
    maps = xr.Dataset(dict.fromkeys(names, (("y", "x"), np.ones((2, 2)))))
    assert sorted(shared_parts(a, b, maps)) == sorted(shared)
    assert sorted(shared_parts(b, a, maps)) == sorted(shared)


@pytest.mark.parametrize(
    ("a", "b", "shared"),
    [
        ("topography_top", "thickness", ["topography_top"]),
        ("half_thickness_top", "half_thickness_bottom", ["base_thickness"]),
        ("topography_top", "base_thickness", []),
        ("half_thickness_top", "coat_weight_bottom", []),
    ],
)
def test_parts_that_a_sheet_lacks_are_not_named(a, b, shared):
    """A sheet without coatings, whose maps of them are empty, and some that were not measured."""
    names = ("thickness", "base_thickness", "topography_top", "topography_bottom")
    maps = xr.Dataset(dict.fromkeys((*names, a, b), (("y", "x"), np.ones((2, 2)))))
    for empty in ("coating_top", "coating_bottom", "base_surface_top", "base_surface_bottom"):
        maps[empty] = maps["thickness"] * np.nan
    assert shared_parts(a, b, maps) == shared_parts(b, a, maps) == tuple(shared)


def test_every_part_is_a_property_and_none_contains_itself():
    names = {*registered()}
    for whole, parts in PARTS.items():
        assert {whole, *parts} <= names
        inner, seen = [*parts], set()
        while inner:
            part = inner.pop()
            assert part != whole
            seen.add(part)
            inner += [p for p in PARTS.get(part, ()) if p not in seen]


def test_maps_that_contain_the_map_are_named_with_what_they_do_to_r():
    maps = with_base(shape=(60, 80))
    sheet = maps["sheet"]
    sheet["thickness"][:] = (
        sheet["coating_top"] + sheet["base_thickness"] + 0.3 * sheet["thickness"]
    )
    given = ("thickness", "base_thickness")
    found = evidence_of(maps, point_um=20, declared=True, beside=given).partial
    assert found.over_control == ("thickness",)
    top, image = (
        area_mean(m.values, (4.0, 4.0)) for m in (sheet["coating_top"], maps["image"]["image"])
    )
    assert found.r_alone == pytest.approx(correlate(top, image, pixel_um=20.0).r)
    text = say_over_control(found, "coating_top")
    assert "Over-control: thickness contains coating top." in text
    assert text.endswith(f"r = {found.r_alone:.2f} becomes {found.r:.2f}.".replace("-", "−"))
    alone = evidence_of(maps, point_um=20, declared=True, beside=("base_thickness",)).partial
    assert alone.over_control == ()
    assert say_over_control(alone, "coating_top") == ""
    sheet["thickness"][:] = sheet["coating_top"] + sheet["base_thickness"]
    lost = evidence_of(maps, point_um=20, declared=True, beside=given).partial
    assert say_over_control(lost, "coating_top").endswith("is lost.")


def test_the_pose_is_a_negative_control_and_counts_in_no_correction():
    maps = drawn()
    rows = [*correlate_layers("sheet", "image", maps, 100.0)]
    for name in ("warp", "tilt"):
        maps["sheet"][name] = maps["sheet"]["thickness"].copy()
    with_pose = [*correlate_layers("sheet", "image", maps, 100.0)]
    properties = [row for row in with_pose if not row.negative_control]
    assert [row.p_of_table for row in properties] == [row.p_of_table for row in rows]
    controls = [row for row in with_pose if row.negative_control]
    assert [row.a_map for row in controls] == ["tilt", "tilt", "warp", "warp"]
    assert all(row.p_of_table == row.p for row in controls)
    # Of a run that was made before.
    stored = controls[0].model_dump(exclude={"negative_control"})
    assert CorrelationRow.model_validate(stored).negative_control


@pytest.mark.parametrize(
    ("beside", "point_um", "words"),
    [
        (("thickness", "rest"), 20, "stand beside their sum"),
        (("flat",), 20, "flat does not vary"),
        (("nothing",), 20, ""),
        (("thickness",), 2, "smaller than a pixel"),
    ],
)
def test_where_nothing_is_left_the_run_stands_and_says_why(beside, point_um, words):
    maps = with_base(shape=(60, 80))
    sheet = maps["sheet"]
    sheet["rest"] = sheet["thickness"] - sheet["coating_top"]
    sheet["flat"] = xr.full_like(sheet["thickness"], 2.0)
    sheet["nothing"] = xr.full_like(sheet["thickness"], np.nan)
    found = evidence_of(maps, point_um=point_um, declared=True, beside=beside)
    assert found.sizes
    assert math.isnan(found.partial.r)
    assert words in found.partial.reason
    assert any(found.partial.reason in s for s in sentences(found, point_um))
    assert (found.partial.n == 0) == (beside == ("nothing",))


def evidence_of(maps, *, declared=False, **options):
    params = CorrelateParams(headline="coating_top" if declared else None, **options)
    return correlation_diagnostics(
        maps, ("sheet", "coating_top"), ("image", "image"), params=params
    )


def sentences(evidence, point_um):
    return [*table.sentences(evidence, "scale", Wording(point_um))]


def test_unrelated_noise_says_nothing_at_any_scale():
    maps = drawn()
    assert all(row.p_of_table > 0.05 for row in correlate_layers("sheet", "image", maps, 100.0))
    found = evidence_of(maps, point_um=50, declared=True)
    assert all(row.band[0] < 0 < row.band[1] for row in found.sizes if row.band)
    assert all(band.p_of_bands > 0.01 for band in found.bands)
    assert found.attenuation_limit is None
    assert found.declared


def test_thin_regions_have_a_difference_with_an_interval():
    maps = drawn()
    maps["sheet"]["coating_top"][:] = 6 + 3 * maps["sheet"]["coating_top"].values
    maps["image"]["image"][:] = (
        100 + maps["image"]["image"].values - 4 * (maps["sheet"]["coating_top"].values < 5)
    )
    found = evidence_of(maps, point_um=50)
    assert [k.thinner_than_um for k in found.thin] == [2, 5, 10]
    assert found.thin[1].interval[0] < -4 < found.thin[1].interval[1]
    assert any("below 5" in s and "differs by" in s for s in sentences(found, 50.0))


def test_a_map_that_is_constant_or_that_the_sheet_lacks_can_neither_lead_nor_stand_beside():
    maps = drawn()
    maps["sheet"]["coating_top"][:] = 3.0
    assert evidence_of(maps, point_um=50) is None
    with pytest.raises(InputError, match="no map gloss to stand beside"):
        evidence_of(with_base(), point_um=20, declared=True, beside=("gloss",))
    with pytest.raises(InputError, match="no map 'gloss'"):
        leading_map(drawn()["sheet"], "top", "gloss")
    assert leading_map(drawn()["image"], "top", "gloss") == "image"
