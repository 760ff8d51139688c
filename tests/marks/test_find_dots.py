"""Photographs of dot targets: round, sharp, hundreds of them, and not laser holes."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from planish.marks import find_holes

# Diameters in pixels: the pixel size of the targets is not known.
DIAMETERS = {"02": (10.0, 24.0), "05": (6.5, 14.0)}


@pytest.fixture
def photograph(shared_data):
    """Return a function from the number of a target to its picture."""
    pillow = pytest.importorskip("PIL.Image")
    folder = shared_data("dot_patterns")
    return lambda name: np.asarray(
        pillow.open(folder / f"dot_pattern_{name}.jpg").convert("L"), dtype=np.float32
    )


def dots(image, name):
    found = find_holes(image, pixel_um=1.0, diameter_um=DIAMETERS[name], polarity="dark")
    return np.stack([found.x.values, found.y.values], axis=1)


def lattice(points):
    """Integer places (n, 2) of points of a lattice, walked from the middle; and which points were
    reached."""
    tree = KDTree(points)
    start = int(tree.query(points.mean(axis=0))[1])
    near = points[tree.query(points[start], k=5)[1][1:]] - points[start]
    first = near[np.argmax(near[:, 0])]
    second = near[np.argmax(near[:, 1])]
    steps = {(1, 0): first, (-1, 0): -first, (0, 1): second, (0, -1): -second}
    places, queue = {start: (0, 0)}, [(start, steps)]
    for at, known in queue:
        here = dict(known)
        reached = []
        for way, step in known.items():
            away, other = tree.query(points[at] + step)
            if away < 0.25 * np.hypot(*step):
                # The step changes slowly from one dot to the next.
                here[way] = points[other] - points[at]
                here[-way[0], -way[1]] = -here[way]
                reached.append((int(other), way))
        for other, way in reached:
            if other not in places:
                places[other] = (places[at][0] + way[0], places[at][1] + way[1])
                queue.append((other, dict(here)))
    index = np.array(sorted(places))
    return np.array([places[k] for k in index], dtype=float), index


def projective_residuals(places, points):
    """Distances (n,) of points from the projective image of their places that fits best (linear,
    normalised)."""
    shift, scale = points.mean(axis=0), points.std()
    far = np.abs(places).max()
    (a, b), (x, y) = (places / far).T, ((points - shift) / scale).T
    one, none = np.ones_like(a), np.zeros_like(a)
    rows = np.concatenate(
        [
            np.stack([a, b, one, none, none, none, -x * a, -x * b], axis=1),
            np.stack([none, none, none, a, b, one, -y * a, -y * b], axis=1),
        ]
    )
    h = np.append(np.linalg.lstsq(rows, np.concatenate([x, y]))[0], 1.0).reshape(3, 3)
    w = np.stack([a, b, one], axis=1) @ h.T
    return scale * np.hypot(w[:, 0] / w[:, 2] - x, w[:, 1] / w[:, 2] - y)


@pytest.mark.parametrize(("name", "count"), [("02", 1324), ("05", 4414)])
def test_every_dot_is_found(photograph, name, count):
    """``count`` is that of connected regions darker than 0.72 of the bright background around,
    between half and twice the median area, that do not touch the border.
    """
    assert len(dots(photograph(name), name)) == pytest.approx(count, rel=0.01)


def test_the_published_distortion_straightens_the_lattice(photograph, shared_data):
    """Radius in the picture = radius without distortion times a polynomial in the latter (Vo et al.

    2015).
    """
    points = dots(photograph("05"), "05")
    places, index = lattice(points)
    assert len(set(map(tuple, places))) == len(places)
    assert len(index) >= 0.99 * len(points)
    lines = (
        (shared_data("dot_patterns") / "coef_dot_05.txt").read_text(encoding="utf-8").splitlines()
    )
    values = [float(line.split(":")[1]) for line in lines if ":" in line]
    centre, factors = np.array(values[:2]), values[2:]
    radius = np.hypot(*(points - centre).T)
    true = radius.copy()
    for _ in range(50):
        true = radius / np.polyval(factors[::-1], true)
    straight = centre + (points - centre) * (true / radius)[:, None]
    plain, better = (
        np.sqrt(np.mean(projective_residuals(places, p[index]) ** 2)) for p in (points, straight)
    )
    assert better < 0.2 * plain
    assert better < 0.2


def lit(image, light):
    """The photograph in uneven light, in whole grey values: four times as bright at one end,
    corners, a quarter."""
    y, x = np.linspace(0, 1, image.shape[0])[:, None], np.linspace(0, 1, image.shape[1])[None]
    light = {
        "across": (1 + 3 * x) / 4 + 0 * y,
        "vignette": 1 - 1.5 * ((x - 0.5) ** 2 + (y - 0.5) ** 2),
        "bright quarter": np.where((x < 0.5) & (y < 0.5), 1.0, 0.25),
    }[light]
    return np.round(image * light)


@pytest.mark.parametrize("light", ["across", "vignette", "bright quarter"])
@pytest.mark.parametrize("name", ["02", "05"])
def test_uneven_light_hides_no_dots(photograph, name, light):
    """97 % of what the plain photograph shows, and nothing else but at the border of image or
    quarter."""
    image = photograph(name)
    before, after = dots(image, name), dots(lit(image, light), name)
    away, partner = KDTree(before).query(after)
    same, other = np.unique(partner[away < 2.0]), after[away >= 2.0]
    # Dots that the plain photograph leaves out lie a pitch from the others.
    pitch = np.median(KDTree(before).query(before, k=2)[0][:, 1])
    on_lattice = (
        np.abs(KDTree(before).query(other)[0] - pitch) < 0.1 * pitch
        if len(other)
        else np.empty(0, bool)
    )
    assert len(same) >= 0.97 * len(before)
    assert on_lattice.all()
