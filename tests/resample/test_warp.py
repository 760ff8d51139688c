import numpy as np
import pytest

from flatten.meshes import middles
from folders import refused
from planish.core.errors import CannotRegister, InputError, ResourceError, SizeError
from planish.core.grid import Grid
from planish.core.threads import limit_threads
from planish.core.tiles import Tile
from planish.core.transform import Affine, Projective, Similarity
from planish.resample import warp, warp_image
from planish.resample.warp import TOLERANCE, find_patches, places

IDENTITY = Similarity()


def warped(source, source_um, to_source, shape, pixel, *, origin_um=(0.0, 0.0), **more):
    pitch = (source_um, source_um) if isinstance(source_um, float) else source_um
    return warp_image(
        source, Grid.regular(shape, pixel, origin_um), to_source, pixel_um=pitch, **more
    )


def ramp(rows, cols):
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    return 3.0 * x - 2.0 * y + 1000.0


def noise(rows, cols, dtype=np.float64, seed=0):
    values = np.random.default_rng(seed).uniform(0, 250, (rows, cols))
    return values.astype(dtype)


def places_of(shape, pixel=1.0, origin=(0.0, 0.0)):
    return middles(Grid.regular(shape, pixel, origin))


def bent(points):
    """Not affine anywhere: waves of up to 8 um over some 1000 um."""
    x, y = points[..., 0], points[..., 1]
    return np.stack(
        [0.98 * x + 0.1 * y + 8 * np.sin(y / 150), y - 0.08 * x + 6 * np.cos(x / 170)], axis=-1
    )


def clipped(polygon, axis, limit, sign):
    """The part of a polygon on one side of a line along an axis (Sutherland and Hodgman)."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        da, db = sign * (a[axis] - limit), sign * (b[axis] - limit)
        if da >= 0:
            out.append(a)
        if da * db < 0:
            out.append(a + (b - a) * da / (da - db))
    return np.array(out)


def area(polygon):
    if len(polygon) < 3:
        return 0.0
    return 0.5 * abs(np.linalg.det(np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)).sum())


def area_twin(source, known, to_source, shape, pixel, origin):
    """Mean over the image of each pixel's outline, source pixel by source pixel; and the share that
    is known."""
    corners = to_source(
        places_of(
            (shape[0] + 1, shape[1] + 1),
            pixel,
            (origin[0] - pixel[1] / 2, origin[1] - pixel[0] / 2),
        )
    )
    out, share = np.full(shape, np.nan), np.zeros(shape)
    for r, c in np.ndindex(shape):
        outline = corners[[r, r, r + 1, r + 1], [c, c + 1, c + 1, c]]
        total = weight = 0.0
        low, high = (
            np.floor(outline.min(axis=0) + 0.5).astype(int),
            np.floor(outline.max(axis=0) + 0.5).astype(int),
        )
        for i in range(max(low[1], 0), min(high[1] + 1, source.shape[0])):
            for j in range(max(low[0], 0), min(high[0] + 1, source.shape[1])):
                part = outline
                for axis, limit, sign in (
                    (0, j - 0.5, 1),
                    (0, j + 0.5, -1),
                    (1, i - 0.5, 1),
                    (1, i + 0.5, -1),
                ):
                    part = clipped(part, axis, limit, sign) if len(part) else part
                if known[i, j] and len(part):
                    total += area(part) * source[i, j]
                    weight += area(part)
        share[r, c] = weight / area(outline)
        if share[r, c] >= 0.5:
            out[r, c] = total / weight
    return out, share


def bilinear_twin(source, known, places):
    """Value between the four pixels around each place; NaN where one with weight is missing."""
    out = np.full(places.shape[:-1], np.nan)
    for at in np.ndindex(out.shape):
        x, y = places[at]
        m, n = int(np.floor(y)), int(np.floor(x))
        total = 0.0
        for i, j in ((m, n), (m, n + 1), (m + 1, n), (m + 1, n + 1)):
            weight = (1 - abs(y - i)) * (1 - abs(x - j))
            if weight > 1e-9:
                inside = 0 <= i < source.shape[0] and 0 <= j < source.shape[1]
                total += weight * source[i, j] if inside and known[i, j] else np.nan
        out[at] = total
    return out


def test_sizes_of_pixels_and_the_origin_enter():
    """The same place in um has the same value, whatever the pixels."""
    to_source = Similarity(rotation_rad=0.1, shift_um=(20.0, 10.0))
    source, source_um, target_um, origin = ramp(90, 80), (2.0, 3.0), (1.5, 0.8), (40.0, 25.0)
    out = warped(source, source_um, to_source, (60, 70), target_um, origin_um=origin)
    at = to_source(places_of((60, 70), target_um, origin)) / (3.0, 2.0)
    np.testing.assert_allclose(out, 3 * at[..., 0] - 2 * at[..., 1] + 1000, atol=1e-8)


@pytest.mark.parametrize(
    ("dtype", "rtol", "to_source"),
    [
        (np.float32, 1e-6, Similarity(scale=0.8, rotation_rad=0.5, shift_um=(12.0, -8.0))),
        (
            np.float64,
            1e-9,
            Similarity(scale=0.9, rotation_rad=2.0, shift_um=(50.0, 20.0), mirrored=True),
        ),
        (np.float64, 1e-9, Affine(linear=((0.8, 0.3), (-0.2, 0.5)), target=(10.0, 20.0))),
    ],
)
def test_bilinear_equals_the_twin(dtype, rtol, to_source):
    source = noise(50, 60, dtype)
    known = noise(50, 60, seed=1) > 5
    out = warped(np.where(known, source, np.nan), 1.0, to_source, (64, 66), 1.0)
    truth = bilinear_twin(source.astype(float), known, to_source(places_of((64, 66))))
    assert np.isfinite(truth).mean() > 0.1
    assert out.dtype == dtype
    np.testing.assert_allclose(out, truth, rtol=rtol)


@pytest.mark.parametrize(
    "to_source",
    [
        Similarity(scale=1.7, rotation_rad=0.7, shift_um=(8.0, -20.0)),
        Similarity(scale=2.0, rotation_rad=-2.5, shift_um=(10.0, 20.0), mirrored=True),
        Similarity(scale=3.0),
        Affine(linear=((2.5, 0.4), (0.1, 0.6))),
    ],
)
def test_area_means_equal_exact_clipping(to_source):
    source = noise(40, 50)
    known = noise(40, 50, seed=1) > 40
    out = warped(np.where(known, source, np.inf), 1.0, to_source, (18, 22), 1.0)
    truth, share = area_twin(source, known, to_source, (18, 22), (1.0, 1.0), (0.0, 0.0))
    assert np.abs(share - 0.5).min() > 1e-6  # no pixel is a matter of rounding
    np.testing.assert_allclose(out, truth, rtol=1e-9)


def test_area_means_without_a_mask_equal_exact_clipping_where_the_map_bends():
    source, shape = noise(60, 60), (14, 15)

    def to_source(points):
        return bent(2.2 * points + 8) * (0.9, 0.9)

    out = warped(source, 1.0, to_source, shape, 1.0)
    truth, share = area_twin(
        source, np.ones((60, 60), bool), to_source, shape, (1.0, 1.0), (0.0, 0.0)
    )
    inside = (share > 1 - 1e-9) & np.isfinite(out)
    assert inside.mean() > 0.4
    # A side that is wrong by 0.01 of a pixel moves 0.03 of 5 square pixels at most, of values up to
    # 250.
    assert np.abs(out - truth)[inside].max() < 4 * TOLERANCE * 2.2 / 4 * 250


def test_large_pixels_only_are_averaged():
    source, known = noise(80, 90), np.ones((80, 90), bool)
    for scale in (0.5, 1.0, 1.09, 1.2):
        to_source = Similarity(scale=scale, rotation_rad=0.2, shift_um=(20.0, 3.0))
        out = warped(source, 1.0, to_source, (20, 20), 1.0)
        if scale < 1.1:
            truth = bilinear_twin(source, known, to_source(places_of((20, 20))))
        else:
            truth = area_twin(source, known, to_source, (20, 20), (1.0, 1.0), (0.0, 0.0))[0]
        np.testing.assert_allclose(out, truth, rtol=1e-9)


def test_the_identity_keeps_every_bit_and_nothing_lies_beyond_the_horizon():
    source = noise(70, 65, np.float32)
    np.testing.assert_array_equal(warped(source, 0.37, IDENTITY, (70, 65), 0.37), source)
    source = np.array([[4.0, np.nan, 8.0, np.nan, np.nan, np.nan]])
    out = warped(source, 1.0, IDENTITY, (1, 3), (1.0, 2.0), origin_um=(0.5, 0.0))
    np.testing.assert_array_equal(out, [[4.0, 8.0, np.nan]])

    def half(points):
        return np.where(points[..., :1] > 40.3, np.nan, points)

    out = warped(ramp(80, 80), 1.0, half, (80, 80), 1.0)
    assert np.isfinite(out[:, :40]).all()
    assert np.isnan(out[:, 41:]).all()


def test_places_are_right_to_a_hundredth_of_a_pixel_and_affine_maps_are_asked_once():
    asked = []

    def counted(points):
        asked.append(points[..., 0].size)
        return bent(points)

    bounds, nodes = find_patches(counted, Tile(0, 400, 0, 450), (600, 600))
    covered, worst = np.zeros((400, 450), dtype=int), 0.0
    for (y0, y1, x0, x1), at in zip(bounds, nodes, strict=True):
        covered[y0:y1, x0:x1] += 1
        made = places(at, *((np.arange(n) + 0.5) / n for n in (y1 - y0, x1 - x0)))
        truth = bent(places_of((y1 - y0, x1 - x0), origin=(x0, y0)))
        worst = max(worst, np.hypot(*np.moveaxis(made - truth, -1, 0)).max())
    assert covered.max() == 1
    # Only pixels that the bend takes out of the source may be left out.
    assert np.any((bent(places_of((400, 450))) < 1) | (bent(places_of((400, 450))) > 598), axis=-1)[
        covered == 0
    ].all()
    assert 0.001 < worst < TOLERANCE
    assert sum(asked) < 0.05 * 400 * 450
    asked.clear()
    find_patches(
        lambda p: (asked.append(p[..., 0].size), IDENTITY(p))[1], Tile(0, 400, 0, 450), (600, 600)
    )
    assert sum(asked) == 4 * 25  # blocks of 256 pixels


def test_a_view_from_aslant_equals_the_twin_of_its_true_places():
    oblique = Projective(
        homography=((1.0, 0.05, 0.0), (0.0, 0.9, 0.0), (0.2, 0.3, 1.0)),
        source=(40.0, 40.0),
        target=(30.0, 30.0),
        source_size=40.0,
        target_size=30.0,
    )
    # Nowhere more than 1.1 pixels of the source.
    out = warped(ramp(70, 70), 1.0, oblique, (110, 110), 0.7)
    truth = bilinear_twin(
        ramp(70, 70), np.ones((70, 70), bool), oblique(places_of((110, 110), (0.7, 0.7)))
    )
    assert (np.isfinite(out) != np.isfinite(truth)).mean() < 0.01
    assert np.nanmax(np.abs(out - truth)) < np.hypot(3, 2) * TOLERANCE


@pytest.mark.parametrize("scale", [0.9, 2.2])
def test_same_bytes_on_any_number_of_threads_and_any_tiles(scale, monkeypatch):
    rows, cols = (700, 600) if scale < 1 else (1250, 1150)
    source = noise(rows, cols, np.float32)
    source[300:310, 200:240] = np.nan

    def to_source(points):
        return bent(scale * points)

    results = []
    for threads, tile in ((1, (512, 4096)), (2, (512, 512)), (3, (1024, 512))):
        monkeypatch.setattr(warp, "_TILE", tile)
        with limit_threads(threads):
            results.append(warped(source, 1.0, to_source, (600, 560), 1.0))
    assert np.isfinite(results[0]).mean() > 0.5
    assert {other.tobytes() for other in results} == {results[0].tobytes()}


@pytest.mark.parametrize(
    ("to_source", "words"),
    [
        (
            Similarity(shift_um=(5000.0, 0.0)),
            r"x 5000 to 5030, y 0 to 30 um.*50 um wide and 40 um high.*inverse",
        ),
        (Similarity(shift_um=(51.0, 0.0)), "overlaps"),  # one pixel beside it
        (lambda p: np.full(p.shape, np.nan), "nowhere"),
        (Affine(linear=((1.0, 2.0), (0.5, 1.0))), "nothing overlaps"),
        (lambda p: 0 * p + 30.0, "nothing overlaps"),
        (lambda p: p[..., :1] * [0.5, 0.5], "nothing overlaps"),
    ],
)
def test_nothing_in_common_and_singular_maps_are_refused_with_what_to_check(to_source, words):
    refused(CannotRegister, words, warped, ramp(40, 50), 1.0, to_source, (30, 30), 1.0)


def test_images_that_cannot_be_warped_or_do_not_fit_are_refused_before_the_work():
    for image in (ramp(4, 5) * 1j, noise(4, 5, np.uint8), ramp(4, 5)[..., None], ramp(0, 5)):
        refused(InputError, r"\(rows, cols\) of floats", warped, image, 1.0, IDENTITY, (4, 5), 1.0)
    for pixel in (0.0, float("nan"), (1.0, np.inf)):
        refused(SizeError, "positive", warped, ramp(4, 5), pixel, IDENTITY, (4, 5), 1.0)
    refused(SizeError, "grid", warped, ramp(4, 5), 1.0, IDENTITY, (0, 5), 1.0)
    allowed = {"memory_bytes": 2 * 10**8 + 10**7}
    words = r"0\.2. GB are allowed.*coarser"
    refused(
        ResourceError, words, warped, noise(10, 10), 1.0, IDENTITY, (10**5, 10**5), 1.0, **allowed
    )
    big = np.broadcast_to(np.float32(1), (20000, 20000))
    middle = {"origin_um": (5000.0, 5000.0)}
    refused(ResourceError, "under one pixel", warped, big, 1.0, IDENTITY, (1, 2), 10000.0, **middle)
