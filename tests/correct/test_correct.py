"""Rings and cupping that are known have to go, and everything else has to stay."""

import json

import numpy as np
import pytest
import tifffile
import zarr

from correct.made import (
    AIR,
    COATING,
    CONTRAST,
    VOXEL,
    as_volume,
    correct,
    radius_um,
    ring,
    sheet,
    volume,
)
from planish.core.errors import InputError, PlanishError, SizeError, VolumeError
from planish.core.threads import limit_threads
from planish.correct import write_picture
from planish.io import read_volume, store, write_store

SHAPE = (60, 100, 200)
RINGS = ((81.0, 0.05), (150.0, -0.035))


def both_rings(shape=SHAPE, **where):
    return sum(ring(shape, at, share, **where) for at, share in RINGS)


@pytest.fixture(scope="module")
def ringed():
    """A volume with two rings, and what becomes of it; no test may change them."""
    given = volume(sheet(), rings=both_rings())
    return given, correct(given, axis="y", cupping=False)


def cup(loss, shape=SHAPE, axis="y"):
    r = radius_um(shape, axis=axis)
    return 1 - loss * (1 - (r / r.max()) ** 2)


@pytest.mark.ci
def test_known_rings_are_found_at_their_radius_and_with_their_height():
    clean = sheet(tilt_deg=5.0)
    given = volume(clean, rings=both_rings())
    found = correct(given, cupping=False, axis="y")
    assert [r.radius_um for r in found.record.rings] == pytest.approx(
        [at for at, _ in RINGS], abs=VOXEL / 2 + 0.01
    )
    # Bins of half a voxel and the line between their middles take 3 % off a crest of one voxel; the
    # rest is noise.
    for got, (_, share) in zip(found.record.rings, RINGS, strict=True):
        assert got.height == pytest.approx(share * CONTRAST, rel=0.12)
        assert abs(got.share_after) < 0.1 * abs(share)
        assert got.height == pytest.approx(got.share * (found.record.sheet - found.record.air))
    # The same noise without rings: what is left of them in the voxels.
    left = (found.volume.values - volume(clean).values.astype(float)) / CONTRAST
    was = both_rings() / CONTRAST
    print(f"rings {np.std(was):.5f} -> {np.std(left):.5f} of the contrast, rms")
    assert np.std(left) < 0.25 * np.std(was)


@pytest.mark.ci
@pytest.mark.parametrize("noise", [0.08, 0.0])
def test_known_cupping_is_taken_off_and_the_mean_grey_stays(noise):
    clean = sheet()
    given = volume(clean * cup(0.06), noise=noise)
    found = correct(given, axis="y")
    # Coating and base both say 6 %, seen from the largest radius at which there is sheet.
    # Without noise every voxel of a row falls on the same side of a border, which is good for 1 %.
    assert found.record.cupping.percent == pytest.approx(6.0, abs=0.4 if noise else 1.0)
    assert not found.record.rings
    for trend in found.record.trends:
        assert trend.before == pytest.approx(6.0, abs=1.0)
        assert abs(trend.after) < (0.5 if noise else 1.3)
    inside = clean > 0.9 * CONTRAST
    assert found.volume.values[inside].mean() == pytest.approx(
        given.values[inside].mean(), rel=0.01
    )
    ratio = (found.volume.values[inside] - AIR).astype(float)
    r = radius_um(SHAPE)[:, 0][:, None] * np.ones((1, SHAPE[1], 1))
    middle, edge = (
        ratio[(r[inside] > a) & (r[inside] < b)].mean() for a, b in ((50, 120), (230, 290))
    )
    assert middle / edge == pytest.approx(1.0, abs=0.006 if noise else 0.012)


@pytest.mark.ci
@pytest.mark.parametrize("noise", [0.08, 0.0])
def test_a_clean_volume_is_given_back_as_it_is(noise):
    given = volume(sheet(), noise=noise)
    found = correct(given, axis="y")
    assert not found.record.changes
    assert found.volume.variable._data is given.variable._data
    assert "no rings above noise" in found.record.sentences[0]
    assert "nothing was corrected" in found.record.sentences[1]


@pytest.mark.ci
@pytest.mark.parametrize(
    "made",
    [
        # Thicker and thinner with the distance from the middle, in steps that a ring would have.
        lambda y, x: {"coat_um": 24 + 9 * np.cos(2 * np.pi * (x - x.mean()) / 60.0) + 0 * y},
        lambda y, x: {"coat_um": 18 + 20 * ((x - x.mean()) / x.max()) ** 2 + 0 * y},
        lambda y, x: {"base_um": 50 + 30 * np.abs(x - x.mean()) / x.max() + 0 * y},
        lambda y, x: {"base_um": 60 + 6 * np.sin(y / 30.0) * np.sin(x / 25.0)},
    ],
    ids=["coating waves", "coating bowl", "base wedge", "base bumps"],
)
def test_true_variation_of_the_sheet_is_not_taken_for_rings_or_cupping(made):
    y, x = (np.arange(n) * VOXEL for n in SHAPE[1:])
    given = volume(sheet(**made(y[:, None], x[None])), noise=0.05)
    found = correct(given, axis="y")
    assert not found.record.rings
    if found.record.cupping is not None:
        assert abs(found.record.cupping.percent) < 1.0
    off = found.volume.values.astype(float) - given.values
    assert np.abs(off).max() < 0.008 * CONTRAST


@pytest.mark.ci
def test_a_denser_edge_of_the_coating_is_its_own_and_a_sheet_across_the_axis_is_corrected():
    """The base does not share the trend, so it is no cupping."""
    coating = AIR + CONTRAST * cup(0.10)
    found = correct(volume(sheet(coating=coating)), axis="y")
    assert {t.material: t.before for t in found.record.trends}["coating"] == pytest.approx(
        10, abs=2
    )
    assert found.record.cupping is None or found.record.cupping.percent < 1.0
    # Each slice then shows one material, or the sheet's face.
    shape = (70, 150, 150)
    given = volume(sheet(shape), rings=both_rings(shape, axis="z"))
    found = correct(given, axis="z", cupping=False)
    assert [r.radius_um for r in found.record.rings] == pytest.approx(
        [at for at, _ in RINGS], abs=VOXEL / 2 + 0.01
    )
    assert [r.height / CONTRAST for r in found.record.rings] == pytest.approx(
        [s for _, s in RINGS], rel=0.12
    )


@pytest.mark.ci
def test_a_ring_that_fades_along_the_axis_is_followed():
    shape = (60, 240, 160)
    fade = np.linspace(0.0, 2.0, shape[1])[None, :, None]
    given = volume(sheet(shape), rings=ring(shape, 120.0, 0.05) * fade)
    found = correct(given, cupping=False, axis="y")
    (got,) = found.record.rings
    assert got.least < 0.35
    assert got.most > 1.65
    left = found.volume.values - volume(sheet(shape)).values.astype(float)
    assert np.std(left) < 0.2 * np.std(ring(shape, 120.0, 0.05) * fade)


@pytest.mark.ci
def test_the_axis_may_be_any_of_the_array():
    """The same scan with its axes in another order: the same rings, the same voxels."""
    given = volume(sheet() * cup(0.05), rings=both_rings())
    moved = ("z", "x", "y")
    turned = as_volume(np.ascontiguousarray(given.transpose(*moved).values))
    a, b = correct(given, axis="y"), correct(turned, axis="x")
    assert a.record.rings == b.record.rings
    np.testing.assert_array_equal(b.volume.values, a.volume.transpose(*moved).values)


@pytest.mark.ci
def test_the_centre_can_be_told_and_may_lie_outside():
    centre = (250.0, 330.0)
    rings = ring(SHAPE, 200.0, 0.05, centre_um=centre)
    given = volume(sheet(), rings=rings)
    assert correct(given, axis="y", cupping=False).record.rings == ()
    found = correct(given, axis="y", centre_um=centre, cupping=False)
    assert [r.radius_um for r in found.record.rings] == pytest.approx([200.0], abs=VOXEL / 2 + 0.01)
    assert found.record.centre_um == centre


@pytest.mark.ci
def test_neither_memory_nor_threads_nor_blocks_change_a_byte():
    given = volume(sheet() * cup(0.05), rings=both_rings(), dtype=np.uint16)
    with limit_threads(1):
        a = correct(given, axis="y")
    with limit_threads(3):
        b = correct(given, axis="y", memory_bytes=2**19)
    assert a.record == b.record
    whole = a.volume.values
    assert whole.dtype == given.dtype
    for where in (
        {"z": slice(7, 31)},
        {"y": slice(3, 50), "x": slice(90, 140)},
        {"x": 17},
        {"z": 2, "y": slice(1, 9)},
    ):
        np.testing.assert_array_equal(
            b.volume.isel(where).values, a.volume.copy(data=whole).isel(where).values
        )
    np.testing.assert_array_equal(b.volume.isel(y=slice(None, None, -7)).values, whole[:, ::-7])


@pytest.mark.ci
def test_only_the_part_that_is_asked_for_is_read(ringed, monkeypatch):
    _, found = ringed
    seen = []
    apply = type(found.change).apply
    monkeypatch.setattr(
        type(found.change),
        "apply",
        lambda self, v, *places: seen.append(v.size) or apply(self, v, *places),
    )
    _ = found.volume.isel(z=slice(0, 8), y=slice(0, 16)).values
    assert seen == [8 * 16 * SHAPE[2]]


@pytest.mark.ci
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_the_type_stays_and_what_leaves_its_range_is_counted(dtype):
    scale = 255.0 / COATING  # the coating lies at the end of the byte
    given = volume(sheet() * cup(0.06), rings=both_rings(), noise=0.03, dtype=np.float32)
    given = given.copy(data=np.clip(np.rint(given.values * scale), 0, 255).astype(dtype))
    found = correct(given, axis="y")
    assert (found.volume.dtype, found.volume.values.dtype) == (dtype, dtype)
    values = found.volume.values
    if dtype == np.uint8:
        assert 0.001 < found.record.clipped < 0.2
        assert values.max() == 255
        assert found.record.to_json()["clipped"] == pytest.approx(found.record.clipped, rel=1e-5)
    else:
        assert found.record.clipped == 0.0


@pytest.mark.ci
def test_the_corners_outside_the_scanners_circle_stay_as_they_are():
    shape = (150, 60, 150)
    given = volume(sheet(shape), rings=ring(shape, 120.0, 0.05))
    outside = np.broadcast_to(radius_um(shape) > 0.5 * 149 * VOXEL, shape)
    given.values[outside] = 0
    found = correct(given, axis="y", cupping=False)
    assert (len(found.record.rings), found.record.air) == (1, pytest.approx(AIR, rel=0.05))
    assert not found.volume.values[outside].any()


@pytest.mark.ci
def test_missing_voxels_stay_missing_and_without_a_sheet_nothing_is_done():
    given = volume(sheet(), rings=both_rings(), dtype=np.float32)
    given.values[10:20, 30:40, 50:60] = np.nan
    found = correct(given, axis="y", cupping=False)
    assert len(found.record.rings) == 2
    np.testing.assert_array_equal(np.isnan(found.volume.values), np.isnan(given.values))
    given = volume(np.zeros(SHAPE), rings=both_rings())
    found = correct(given, axis="y")
    assert found.record.sentences == ("No sheet stands out from the air: nothing was corrected.",)
    np.testing.assert_array_equal(found.volume.values, given.values)


@pytest.mark.parametrize(
    ("made", "options", "kind", "words"),
    [
        (lambda: volume(sheet()).isel(y=slice(0, 1)), {}, VolumeError, r"1 voxel\(s\) along y"),
        (
            lambda: volume(sheet()).isel(x=slice(0, 10)),
            {},
            VolumeError,
            "60 x 10 voxels along z and x",
        ),
        (
            lambda: volume(sheet()),
            {"centre_um": (80.0, -2000.0)},
            InputError,
            "x = -2000 um; the field runs from 0",
        ),
        (
            lambda: volume(sheet()),
            {"rings": False, "cupping": False},
            InputError,
            "Neither rings nor cupping",
        ),
        (
            lambda: volume(sheet()).assign_attrs(sections={}),
            {},
            InputError,
            "photographs of sections",
        ),
        (lambda: volume(sheet()).drop_attrs(), {}, SizeError, "no voxel size"),
    ],
)
def test_what_cannot_be_corrected_is_refused(made, options, kind, words):
    with pytest.raises(kind, match=words) as told:
        correct(made(), axis="y", **options)
    assert isinstance(told.value, PlanishError)


@pytest.mark.ci
def test_the_store_says_what_was_corrected_and_does_not_go_on_with_other_options(ringed, tmp_path):
    given, found = ringed
    write_store(found.volume, tmp_path / "a.zarr")
    told = zarr.open_group(tmp_path / "a.zarr", mode="r").attrs["planish"]["corrections"]
    assert told == found.record.to_json()
    assert [round(r["radius_um"]) for r in told["rings"]] == pytest.approx([81, 150], abs=2)
    partial = tmp_path / ".b.zarr.partial"
    partial.mkdir()
    (partial / "source.json").write_text(json.dumps(store._identity(given)))
    with pytest.raises(InputError, match="another volume stopped half-way"):
        write_store(found.volume, tmp_path / "b.zarr")
    write_store(given, tmp_path / "c.zarr")  # what is not corrected says nothing
    assert "corrections" not in zarr.open_group(tmp_path / "c.zarr", mode="r").attrs["planish"]


@pytest.fixture
def tiff(tmp_path):
    path = tmp_path / "scan.tif"
    given = volume(sheet() * cup(0.06), rings=both_rings())
    tifffile.imwrite(path, given.values)
    return path


@pytest.mark.ci
def test_import_corrects_on_the_way(passes, tmp_path, tiff):
    out = tmp_path / "sheet.zarr"
    told, _ = passes(
        "import",
        tiff,
        "-o",
        out,
        "--voxel-um",
        VOXEL,
        "--correct-rings",
        "--correct-cupping",
        "--rotation-axis",
        "y",
    )
    assert "Rings: 2 corrected" in told
    assert "Cupping: " in told
    record = json.loads((tmp_path / "sheet.corrections.json").read_text())
    assert record["asked"] == ["rings", "cupping"]
    scan = read_volume(tiff, voxel_um=VOXEL)
    straight = correct(scan, axis="y")
    assert straight.record.cupping.percent == pytest.approx(6.0, abs=0.5)
    write_picture(straight, scan, tmp_path / "again.png")
    assert (tmp_path / "sheet.corrections.png").read_bytes() == (
        tmp_path / "again.png"
    ).read_bytes()
    np.testing.assert_array_equal(read_volume(out).values, straight.volume.values)


def test_import_refuses_what_it_cannot_do(refuses, tmp_path, tiff):
    common = ("import", tiff, "-o", tmp_path / "sheet.zarr", "--voxel-um", VOXEL)
    refuses(*common, "--rotation-axis", "y", words="belong to --correct-rings", code=2, out=False)
    refuses(
        *common,
        "--correct-rings",
        "--rotation-centre-um",
        "1e5,3",
        words="the field runs from 0 to",
        out=False,
    )
    assert not list(tmp_path.glob("*.zarr"))
    (tmp_path / "sheet.corrections.png").touch()
    refuses(*common, "--correct-rings", words="exists already", out=False)
