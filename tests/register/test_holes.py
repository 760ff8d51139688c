"""Holes of two planes, from their places and covariances to a registration."""

import numpy as np
import pytest
import xarray as xr

import planish as pl
from folders import refused
from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.register import (
    DesignedHoles,
    RegistrationParams,
    fit_pairs,
    fit_transform,
    register_marks,
)
from register.patterns import covariances, scattered

TURN = Similarity(scale=1.01, rotation_rad=0.4, shift_um=(300.0, -120.0))
PARAMS = RegistrationParams()


def plane(name, places, spread=None, faces="top"):
    data = {
        "x": ("mark", places[:, 0]),
        "y": ("mark", places[:, 1]),
        "diameter": ("mark", np.full(len(places), 200.0)),
    }
    if spread is not None:
        data |= {
            "cov_xx": ("mark", spread[:, 0, 0]),
            "cov_xy": ("mark", spread[:, 0, 1]),
            "cov_yy": ("mark", spread[:, 1, 1]),
        }
    return xr.Dataset(data, attrs={"layer": name, "seen_from": faces})


def sides(seed=0, n=12):
    rng = np.random.default_rng(seed)
    a = scattered(n, rng)
    order = rng.permutation(n)
    b = TURN(a)[order] + rng.normal(0, 2, (n, 2))
    return a, b, order, covariances(n, rng), covariances(n, rng)


def test_holes_are_matched_by_their_covariances():
    a, b, order, of_a, of_b = sides()
    fit, found = register_marks(plane("volume", a, of_a), plane("image", b, of_b), params=PARAMS)
    assert np.array_equal(order[found.pairs[:, 1]], found.pairs[:, 0])
    assert (found.labels[:2], found.second_best) == (("hole 1", "hole 2"), 0)
    turn = fit_transform(a[found.pairs[:, 0]], b[found.pairs[:, 1]]).transform.matrix()
    weights = turn @ of_a[found.pairs[:, 0]] @ turn.T + of_b[found.pairs[:, 1]]
    twin = fit_transform(
        a[found.pairs[:, 0]],
        b[found.pairs[:, 1]],
        model="auto",
        weights=weights,
        lowest="similarity",
    )
    assert (fit(a).tobytes(), fit.sentence) == (twin(a).tobytes(), twin.sentence)


def test_pairs_of_holes_given_back_repeat_their_fit():
    a, b, _, of_a, of_b = sides(1)
    planes = plane("volume", a, of_a), plane("image", b, of_b)
    fit, found = register_marks(*planes, params=PARAMS)
    rows = (holes.isel(mark=found.pairs[:, k]) for k, holes in enumerate(planes))
    again = fit_pairs(*rows, params=PARAMS, mirrored=False)
    assert again(a).tobytes() == fit(a).tobytes()
    assert again.expected_error_um(a).tobytes() == fit.expected_error_um(a).tobytes()


def test_opposite_sides_are_mirrored_and_plain_marks_show_the_top():
    a, b, order, of_a, _ = sides(3)
    b = b * (-1.0, 1.0)
    refused(
        CannotRegister,
        "mirror=True",
        register_marks,
        plane("volume", a),
        plane("image", b),
        params=PARAMS,
    )
    fit, found = register_marks(
        plane("volume", a, of_a), plane("image", b, faces="bottom"), params=PARAMS
    )
    assert fit.mirrored
    assert np.all(fit.weights == 1.0)  # covariances of one side alone count for nothing
    assert np.array_equal(order[found.pairs[:, 1]], found.pairs[:, 0])
    mirrored, _ = register_marks(
        plane("volume", a), plane("image", b), params=RegistrationParams(mirror=True)
    )
    assert mirrored(a).tobytes() == fit(a).tobytes()
    # What :func:`planish.register_marks` documents of marks that are places alone.
    a, b, *_ = sides(3)
    marks, same, behind = (
        xr.Dataset({k: ("mark", xy[:, n]) for n, k in enumerate("xy")})
        for xy in (a, b, b * (-1, 1))
    )
    assert not pl.register_marks(marks, same).fit.mirrored
    assert pl.register_marks(marks, behind.assign_attrs(seen_from="bottom")).fit.mirrored
    with pytest.raises(
        CannotRegister,
        match=r"moving layer and 12 of the fixed layer: .* viewed from the wrong side",
    ):
        pl.register_marks(marks, behind)
    with pytest.raises(
        MarkError, match=r"seen_from of the fixed layer is 'Bottom'\. Set it to 'top' or 'bottom'"
    ):
        pl.register_marks(marks, behind.assign_attrs(seen_from="Bottom"))
    assert "``seen_from``" in str(pl.register_marks.__doc__)


def test_the_design_identifies_the_holes_and_few_pairs_or_a_wrong_scale_are_refused():
    a, b, order, *_ = sides(4)
    design = DesignedHoles(name="coded", places_um=a, labels=tuple(f"H{k}" for k in range(12)))
    _, found = register_marks(
        plane("volume", a[2:]), plane("image", b), params=PARAMS, pattern=design
    )
    assert found.design == "Holes identified by the pattern coded of 12 holes."
    assert [int(label[1:]) for label in found.labels] == order[found.pairs[:, 1]].tolist()
    a, b, *_ = sides(5)
    with pytest.raises(MarkError, match="2 control points given"):
        fit_pairs(plane("volume", a[:2]), plane("image", b[:2]), params=PARAMS, mirrored=False)
    with pytest.raises(CannotRegister, match=r"scale of 1\.0600, which is 6\.0 % off"):
        fit_pairs(plane("volume", a), plane("image", 1.06 * a), params=PARAMS, mirrored=False)
    with pytest.raises(
        CannotRegister, match=r"Only 2 holes found in the image at \(.*100 to 300 um"
    ):
        register_marks(plane("volume", a), plane("image", b[:2]), params=PARAMS)
