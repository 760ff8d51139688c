"""Sizes: every unit to micrometres, and what happens when they are missing or disagree."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planish.core.errors import SizeError
from planish.core.units import unit_um
from planish.io import PIXEL, agreed_size
from planish.io.resolution import from_density
from planish.io.sizes import VOXEL, Stated, stated_in

sizes = st.floats(0.02, 90)


@pytest.mark.parametrize(
    ("unit", "um"),
    [
        ("nm", 1e-3),
        ("um", 1),
        ("µm", 1),
        ("μm", 1),
        ("micron", 1),
        ("Microns", 1),
        ("micrometer", 1),
        ("\\u00B5m", 1),
        ("\\u00b5m", 1),
        ("mm", 1e3),
        ("cm", 1e4),
        ("m", 1e6),
        ("inch", 25400),
        (" um ", 1),
    ],
)
def test_every_unit_of_length_is_known(unit, um):
    assert unit_um(unit) == um


@pytest.mark.parametrize("unit", ["", "pixel", "pixels", "voxel", "reference frame", "sec", "M m"])
def test_other_words_are_no_units(unit):
    assert unit_um(unit) is None


@pytest.mark.parametrize(
    ("per_unit", "unit"),
    [
        (72, "inch"),
        (96, "inch"),
        (28.35, "cm"),
        (28, "cm"),
        (37.8, "cm"),
        (2835, "m"),
        (3780, "m"),
        (1, "inch"),
        (1, "cm"),
        (0, "inch"),
        (-300, "inch"),
        (None, "inch"),
        (float("nan"), "cm"),
        (300, ""),
    ],
)
def test_resolutions_of_programs_that_do_not_know_count_as_missing(per_unit, unit):
    assert from_density(per_unit, unit) is None


def test_a_true_resolution_is_a_pixel_size():
    assert (from_density(2540, "inch"), from_density(5000, "cm")) == (10, 2)


@given(size=sizes)
def test_one_given_value_means_all_axes(size):
    assert agreed_size([], float(size), file_name="v.tif", asked=VOXEL) == ((size,) * 3, "given")
    assert agreed_size([], size, file_name="i.tif", asked=PIXEL) == ((size,) * 2, "given")


@given(size=st.floats(0.1, 20), factor=st.floats(0.2, 5))
def test_a_given_size_more_than_one_percent_off_is_refused(size, factor):
    stated = [Stated(source="ImageJ metadata", um=(size, size, size))]
    given_size = size * factor
    if 1 / 1.0099 < factor < 1.0099:
        source = "ImageJ metadata" if given_size == size else "given"
        assert agreed_size(stated, given_size, file_name="v.tif", asked=VOXEL)[1] == source
    elif factor > 1.0101 or factor < 1 / 1.0101:
        with pytest.raises(
            SizeError, match=r"voxel_um= gives .* but ImageJ metadata states .*override_size=True"
        ):
            agreed_size(stated, given_size, file_name="v.tif", asked=VOXEL)
        taken, source = agreed_size(
            stated, given_size, file_name="v.tif", asked=VOXEL, override=True
        )
        assert taken == (given_size,) * 3
        assert source.startswith("given, in place of ImageJ metadata")


def test_refusals_name_the_sizes_and_the_missing_axes():
    stated = [Stated(source="ImageJ metadata", um=(2.0, 1.5, 1.5))]
    with pytest.raises(SizeError) as caught:
        agreed_size(stated, 3, file_name="v.tif", asked=VOXEL)
    assert (
        str(caught.value)
        == "v.tif: voxel_um= gives z 3, y 3, x 3 um, but ImageJ metadata states z 2, y 1.5, x 1.5"
        " um. "
        "Correct one of them, or add override_size=True to take the given size."
    )
    with pytest.raises(SizeError) as caught:
        agreed_size([], None, file_name="v.tif", asked=VOXEL)
    assert (
        str(caught.value)
        == "v.tif states no voxel size. Give it with voxel_um=SIZE (or Z,Y,X), in um."
    )
    stated = [Stated(source="the TIFF resolution", um=(None, 2.0, 2.5))]
    with pytest.raises(SizeError) as caught:
        agreed_size(stated, None, file_name="v.tif", asked=VOXEL)
    assert (
        str(caught.value)
        == "v.tif states no voxel size along z: the TIFF resolution states y 2, x 2.5 um only. "
        "Give all with voxel_um=(Z, 2, 2.5), in um."
    )


def test_two_sources_fill_each_other_up_but_may_not_disagree():
    tags = Stated(source="the TIFF resolution", um=(None, 2.0, 2.0))
    ome = Stated(source="OME metadata", um=(3.0, None, 2.01))
    assert agreed_size([ome, tags], None, file_name="v.tif", asked=VOXEL)[0] == (3.0, 2.0, 2.01)
    other = Stated(source="OME metadata", um=(3.0, 4.0, 4.0))
    with pytest.raises(
        SizeError, match=r"contradicts itself: OME .* z 3, y 4, x 4 um and the TIFF .* y 2, x 2 um"
    ):
        agreed_size([other, tags], None, file_name="v.tif", asked=VOXEL)


@pytest.mark.parametrize(
    ("length", "unit", "words"),
    [
        (3, "mm", r"is 3000 um \(the header states 3 mm\); possible are 0\.0001 to 1000 um"),
        (3, "nm", r"is 0\.003 um \(the header states 3 nm\); usual are 0\.01 to 100 um"),
        (0.0003, "m", r"is 300 um \(the header states 0\.0003 m\); usual are"),
    ],
)
def test_of_a_size_out_of_range_the_number_that_was_read_is_said_and_no_reason(length, unit, words):
    stated = stated_in("the header", [length] * 3, [unit] * 3)
    with pytest.raises(SizeError, match=words) as refused:
        agreed_size([stated], None, file_name="v.tif", asked=VOXEL)
    refused.match(r"Check the number and its unit\..* add override_size=True")
    for guess in ("looks like", "given as um", "probably"):
        assert guess not in refused.value.text
    with pytest.raises(SizeError, match=r"is 3000 um \(voxel_um= gives it\); possible are"):
        agreed_size([], 3000.0, file_name="v.tif", asked=VOXEL)


def test_unusual_sizes_need_a_word_and_impossible_ones_are_refused():
    nm = [Stated(source="OME metadata", um=(0.0046,) * 3)]
    with pytest.raises(
        SizeError, match=r"usual are 0.01 to 100 um.* If it is meant, add unusual_size=True"
    ):
        agreed_size(nm, None, file_name="v.tif", asked=VOXEL)
    assert agreed_size(nm, None, file_name="v.tif", asked=VOXEL, unusual=True)[0] == (0.0046,) * 3
    with pytest.raises(SizeError, match=r"possible are 0.0001 to 1000 um.*in um\.$"):
        agreed_size([], 2000.0, file_name="v.tif", asked=VOXEL, unusual=True)
    with pytest.raises(SizeError, match=r"OME metadata states it.*override_size=True"):
        agreed_size(
            [Stated(source="OME metadata", um=(3e3,) * 3)], None, file_name="v.tif", asked=VOXEL
        )


@pytest.mark.parametrize(
    "bad", [0, -1, float("nan"), float("inf"), (1, 2), (1, 2, 3, 4), (1, 0, 1)]
)
def test_what_is_no_size_is_refused(bad):
    with pytest.raises(SizeError, match="voxel_um"):
        agreed_size([], bad, file_name="v.tif", asked=VOXEL)
