import numpy as np
import pytest

from folders import refused
from planish.core.errors import CannotRegister, MarkError
from planish.register import match_by_design
from register.patterns import coded, pose, scattered, seen


def test_labels_of_the_design_travel():
    rng = np.random.default_rng(0)
    design = coded()
    names = [f"H{k}" for k in range(21)]
    holes = design + rng.normal(0, 4, design.shape)
    marks, which = seen(holes, rng, 0.3, 0.3)
    truth = pose(rng)
    found = match_by_design(marks, truth(holes), design, labels=names)
    assert [names[k] for k in which[found.pairs[:, 0]]] == list(found.labels)
    assert [names[k] for k in found.pairs[:, 1]] == list(found.labels)
    assert len(found.labels) >= 14
    assert np.linalg.norm(found.transform(holes) - truth(holes), axis=1).max() < 20


@pytest.mark.parametrize("behind", [False, True])
def test_two_sides_that_share_few_marks_are_matched_by_the_design(behind):
    """Half of 12 holes are missing on each side; both may show the sheet from behind."""
    rng = np.random.default_rng(1)
    for _ in range(8):
        design = scattered(12, rng)
        holes = pose(rng, mirrored=behind)(design + rng.normal(0, 4, design.shape))
        truth = pose(rng)
        (a, of_a), (b, of_b) = seen(holes, rng, 0.5, 0.1), seen(holes, rng, 0.4, 0.1)
        found = match_by_design(a, truth(b), design, scale_tolerance=0.04)
        assert not found.mirrored
        assert np.array_equal(of_a[found.pairs[:, 0]], of_b[found.pairs[:, 1]])
        assert [str(k + 1) for k in of_a[found.pairs[:, 0]]] == list(found.labels)
        assert np.linalg.norm(found.transform(holes) - truth(holes), axis=1).max() < 30


def test_without_common_marks_or_with_a_marker_gap_the_design_gives_the_transformation():
    rng = np.random.default_rng(2)
    design = scattered(16, rng)
    holes = design + rng.normal(0, 4, design.shape)
    truth = pose(rng)
    found = match_by_design(holes[:8], truth(holes[8:]), design)
    assert len(found.pairs) == 0
    assert "through the design" in found.sentence
    assert np.linalg.norm(found.transform(holes) - truth(holes), axis=1).max() < 30
    # Two holes of a two-fold pattern are left out: whether they are missing or never were, only the
    # design tells.
    rng = np.random.default_rng(4)
    half = scattered(8, rng) * (1.0, 0.6) + 300
    design = np.concatenate([half, -half[2:]])
    marks, which = seen(design, rng, 0.0, 0.0)
    found = match_by_design(pose(rng)(marks), design, design)
    assert np.array_equal(which[found.pairs[:, 0]], found.pairs[:, 1])
    rng = np.random.default_rng(5)
    design = scattered(14, rng)
    a, b = design + rng.normal(0, 4, design.shape), pose(rng, mirrored=True)(design)
    refused(CannotRegister, "mirror=True", match_by_design, a, b, design)
    assert match_by_design(a, b, design, mirror=True).mirrored


def test_designs_that_are_symmetric_of_another_sheet_or_faulty_are_refused():
    rng = np.random.default_rng(3)
    half = scattered(8, rng) * (1.0, 0.6) + 300
    design = np.concatenate([half, -half])
    for _ in range(10):
        marks, _ = seen(design + rng.normal(0, 4, design.shape), rng, 0.3, 0.3)
        with pytest.raises(CannotRegister, match=r"symmetric or regular|does not match"):
            match_by_design(pose(rng)(marks), marks, design)
    rng = np.random.default_rng(6)
    for _ in range(10):
        marks, _ = seen(scattered(15, rng), rng, 0.1, 0.1)
        with pytest.raises(
            CannotRegister, match=r"marks of the image and 15 designed holes: .* agree"
        ):
            match_by_design(marks, marks, scattered(15, rng), names=("image", "other"))
    points = scattered(6, np.random.default_rng(7))
    with pytest.raises(MarkError, match="2 labels are given for 6 designed holes"):
        match_by_design(points, points, points, labels=["a", "b"])
    refused(
        CannotRegister,
        "2 marks of the fixed: at least 3",
        match_by_design,
        points,
        points[:2],
        points,
    )
