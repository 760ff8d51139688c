"""What a series says: over sheets, equal to textbook formulas; nothing takes part in a mean in
silence."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from folders import refused
from planish.core.errors import InputError
from planish.core.facts import is_known
from planish.series import Declared, gather, summary_of
from planish.series.gather import FigureRow
from planish.series.quantities import quantities_of
from planish.series_results import Member
from series.runs import results_of, series, two_volumes


def said(home, *runs, **declared):
    return summary_of(gather(series(home, *runs), home), Declared(**declared))


def number_of(results, what, name="coating_top"):
    return next(k for k, q in enumerate(results.quantities) if (q.map, q.what) == (name, what))


def test_r_of_the_pose_is_called_a_negative_control():
    rows = [FigureRow("mean", 0.0, "um", specimen="a", map="warp")]
    pair = {"specimen": "a", "map": "warp", "other_map": "image", "at_um": 100.0}
    rows += [FigureRow("points", 50.0, **pair), FigureRow("r", -0.4, **pair)]
    titles = [q.title for q in quantities_of(rows, {}, Declared(headline=("warp",)))]
    assert titles == ["mean warp", "r of warp (negative control) and the image, points of 100 um"]


def of(results, what, **group):
    k = number_of(results, what)
    return next(g for g in results.groups if g.quantity == k and g.group == group)


def rows_of(means, **factors):
    """A sheet of each mean."""
    return [(factors | {"sheet": str(k)}, results_of(mean=mean)) for k, mean in enumerate(means)]


def kinds_of(results):
    k = number_of(results, "mean")
    return [(d.within, d.kind) for d in results.differences if d.quantity == k]


def test_two_papers_are_compared_over_sheets_not_fields(tmp_path):
    rng = np.random.default_rng(3)
    fields = {"A": rng.normal(20, 1, (3, 2)), "B": rng.normal(21, 1, (4, 2))}
    rows = [
        ({"paper": paper, "sheet": str(s), "field": str(f)}, results_of(mean=value))
        for paper, values in fields.items()
        for (s, f), value in np.ndenumerate(values)
    ]
    results = said(tmp_path, *rows)
    a, b = of(results, "mean", paper="A"), of(results, "mean", paper="B")
    assert (a.sheets, a.fields, b.sheets, b.fields) == (3, 6, 4, 8)
    welch = stats.ttest_ind(fields["B"].mean(axis=1), fields["A"].mean(axis=1), equal_var=False)
    d = results.differences[number_of(results, "mean")]
    assert (d.factor, d.levels, d.kind, d.sheets) == ("paper", ("A", "B"), "two groups", (3, 4))
    assert d.p == pytest.approx(welch.pvalue, rel=1e-9)
    assert d.interval == pytest.approx(tuple(welch.confidence_interval()), rel=1e-9)
    # All sheets are alike in the others.
    assert [math.isnan(k.p) for k in results.differences] == [False, True, True, True]
    assert d.p_of_table == pytest.approx(4 * d.p)  # but they were looked at


def test_the_same_sheets_before_and_after_are_paired_and_before_comes_first(tmp_path):
    after, before = np.array([18.0, 19.5, 18.7]), np.array([20.0, 21.0, 20.9, 99.0])
    rows = rows_of(after, treatment="after") + rows_of(before, treatment="before")
    d = said(tmp_path, *rows, margin={"coating_top": 5.0}).differences[0]
    paired = stats.ttest_rel(after, before[:3])
    assert (d.levels, d.kind, d.sheets, d.unpaired) == (
        ("before", "after"),
        "paired",
        (3, 3),
        ("sheet 3",),
    )
    assert d.p == pytest.approx(paired.pvalue, rel=1e-9)
    assert d.interval == pytest.approx(tuple(paired.confidence_interval()), rel=1e-9)
    assert (d.equivalence.verdict, d.difference) == (
        "equivalent",
        pytest.approx((after - before[:3]).mean()),
    )


def test_two_papers_before_and_after_are_compared_within_each_paper(tmp_path):
    rows = []
    for k, (paper, treatment) in enumerate(itertools.product("AB", ("before", "after"))):
        rows += rows_of(20.0 + 3 * k + np.arange(3), paper=paper, treatment=treatment)
    assert kinds_of(said(tmp_path, *rows)) == [
        ({"paper": "A"}, "paired"),
        ({"paper": "B"}, "paired"),
    ]
    assert kinds_of(said(tmp_path / "again", *rows, compare="paper")) == [
        ({"treatment": "before"}, "two groups"),
        ({"treatment": "after"}, "two groups"),
    ]


def test_doubtful_and_withheld_figures_take_part_only_where_that_was_declared(tmp_path):
    rows = [({"sheet": str(k)}, results_of(mean=20.0 + k, r=0.5 + k / 100)) for k in range(3)]
    rows += [
        ({"sheet": "8"}, results_of(mean=90.0, trust="doubtful", state="look")),
        ({"sheet": "9"}, results_of(trust="withheld", state="fail")),
    ]
    results = said(tmp_path, *rows)
    assert of(results, "mean").mean == pytest.approx(21.0)
    for what in ("mean", "sd", "thin_share", "r"):
        assert of(results, what).left_out == ("run-4", "run-5")
    assert results.specimens[3].cells[0].why_not == "doubtful (coverage)"
    assert [one.member.state for one in results.specimens] == ["whole"] * 4 + ["withheld"]
    assert "coverage" in results.specimens[4].member.message
    assert any("Doubtful figures" in c and "run-4" in c for c in results.cautions)
    assert any("Withheld figures" in c and "run-5" in c for c in results.cautions)
    kept = said(tmp_path / "again", *rows, doubtful=True)
    assert of(kept, "mean").mean == pytest.approx((20 + 21 + 22 + 90) / 4)
    assert any("as was declared" in c and "run-4" in c for c in kept.cautions)


def test_r_is_pooled_by_z_over_sheets_with_heterogeneity(tmp_path):
    r = [0.3, 0.5, 0.7]
    results = said(
        tmp_path, *(({"sheet": str(k)}, results_of(r=v, mean=20.0 + k)) for k, v in enumerate(r))
    )
    z, found = np.arctanh(r), of(results, "r")
    assert found.mean == pytest.approx(math.tanh(z.mean()))
    # weights of n_eff 70, less 3, alike
    assert found.between_sheets.q == pytest.approx(67 * float(((z - z.mean()) ** 2).sum()))


def test_r_of_few_points_or_points_of_another_size_takes_part_in_nothing_and_says_so(tmp_path):
    rows = rows_of([20.0, 21.0, 22.0])
    rows += [
        ({"sheet": "5"}, results_of(mean=1, n_eff=3.0)),
        ({"sheet": "6"}, results_of(mean=2, point_um=60.0)),
    ]
    results = said(tmp_path, *rows)
    assert of(results, "r").left_out == ("run-4", "run-5")
    k = number_of(results, "r")
    assert [one.cells[k].why_not for one in results.specimens[3:]] == [
        "too few independent points",
        "points of 60 um, others of 100 um",
    ]
    assert any("too few" in c for c in results.cautions)
    assert any("another size" in c for c in results.cautions)


def test_fewer_than_three_sheets_have_no_interval_and_the_reason(tmp_path):
    one_sheet = [({"sheet": "1", "field": str(k)}, results_of(mean=20.0 + k)) for k in range(4)]
    found = of(said(tmp_path, *one_sheet), "mean")
    assert (found.sheets, found.fields, is_known(found.interval)) == (1, 4, False)
    assert found.reason == "1 of at least 3 sheets"
    assert found.mean == pytest.approx(21.5)


def test_without_sheets_each_specimen_is_one_but_those_of_one_volume_are_one(tmp_path):
    rows = [
        ({"paper": "A"}, results_of(mean=20.0 + k, volume="same" if k < 2 else ""))
        for k in range(4)
    ]
    results = said(tmp_path, *rows)
    assert [one.sheet for one in results.specimens] == [
        "specimen run-1",
        "specimen run-1",
        "specimen run-3",
        "specimen run-4",
    ]
    assert of(results, "mean").sheets == 3
    assert any(
        "names no sheets: each volume counts as a sheet of its own" in c for c in results.cautions
    )
    assert any("same volume and count as one sheet" in c for c in results.cautions)
    wrong = said(
        tmp_path / "wrong",
        *(({"sheet": str(k)}, results_of(volume="same", r=0.1 * k)) for k in range(3)),
    )
    assert any("byte by byte" in c for c in wrong.cautions)


def test_maps_without_an_image_and_links_meet_in_what_both_have(tmp_path):
    rows = [({"sheet": "1"}, results_of()), ({"sheet": "2"}, results_of(mean=21.0, linked=False))]
    results = said(tmp_path, *rows)
    assert [one.kind for one in results.specimens] == ["sheet on image", "map"]
    assert (of(results, "mean").fields, of(results, "r").left_out) == (2, ("run-2",))
    assert results.specimens[1].cells[number_of(results, "r")].why_not == "not linked"
    assert any("different kinds" in c for c in results.cautions)


def test_what_is_not_there_or_damaged_stays_named_has_no_figures_and_stops_nothing(tmp_path):
    members = series(tmp_path, ({}, results_of()), ({}, results_of(mean=3)))
    (tmp_path / "run-1" / "results.json").write_text('{"format": 3,')
    members += [
        Member(name="fünf 5", state="refused", message="The volume shows no sheet."),
        Member(name="moved", run="elsewhere"),
    ]
    found = gather(members, tmp_path)
    assert {row.specimen for row in found.rows} == {"run-2"}
    results = summary_of(found, Declared())
    assert [(m.name, m.state) for m in results.members] == [
        ("run-1", "damaged"),
        ("run-2", "whole"),
        ("fünf 5", "refused"),
        ("moved", "damaged"),
    ]
    assert "cannot be read" in results.members[0].message
    assert "does not exist" in results.members[3].message
    assert str(tmp_path) not in results.members[3].message
    assert results.specimens[3].cells == ()


def test_two_volumes_list_bias_limits_and_the_scale_that_both_share(tmp_path):
    results = said(tmp_path, ({}, two_volumes()), ({}, results_of()))
    [found] = results.instruments
    assert (found.specimen, found.a, found.b, found.map) == (
        "run-1",
        "ct",
        "sections",
        "coating_top",
    )
    assert (found.bias, found.limits, found.shared_um) == (0.5, (-1.46, 2.46), 40.0)
    assert (found.limit_intervals[1], found.slopes) == ((2.2, 2.8), pytest.approx((0.8, 1 / 0.9)))
    rows = {
        (r.quantity, r.at_um): r
        for r in gather(series(tmp_path / "b", ({}, two_volumes())), tmp_path / "b").rows
    }
    assert (rows["bias", 100.0].low, rows["bias", 100.0].high, rows["shared_um", 100.0].value) == (
        0.4,
        0.6,
        40.0,
    )


def test_factors_that_do_not_fit_are_an_error_or_a_caution(tmp_path):
    rows = [({"paper": "A", "load": str(k)}, results_of(mean=20.0 + k)) for k in range(3)]
    rows += [({"paper": "a"}, results_of(mean=30.0)), ({}, results_of(mean=31.0))]
    results = said(tmp_path, *rows)
    assert any("differ in capitals only" in c for c in results.cautions)
    assert any("Groups by load" in c for c in results.cautions)
    assert any("No paper is given for run-5" in c for c in results.cautions)
    found = gather(series(tmp_path / "b", *rows), tmp_path / "b")
    for wrong, words in (
        ({"compare": "papr"}, "Did you mean paper"),
        ({"compare": "sheet"}, "Sheets are the sample"),
        ({"headline": ("coatng_top",)}, "Did you mean coating_top"),
        ({"margin": {"thicknes.sd": 1.0}}, "thickness"),
    ):
        refused(InputError, words, summary_of, found, Declared(**wrong))
    refused(ValueError, "margin", Declared, margin={"coating_top": 0})


def test_more_than_eight_levels_are_not_compared_two_by_two(tmp_path):
    results = said(tmp_path, *(({"paper": str(k)}, results_of(mean=20.0 + k)) for k in range(9)))
    assert results.differences == ()
    assert any("9 levels" in c for c in results.cautions)


def test_sheets_that_pair_by_a_factor_of_ones_own_are_said_to_be_the_same_sheets(tmp_path):
    for factor, kind, are_the_same in (("papier", "paired", True), ("paper", "two groups", False)):
        rows = rows_of([20.0, 21.0, 22.0], **{factor: "A"}) + rows_of(
            [23.0, 24.0, 25.0], **{factor: "B"}
        )
        results = said(tmp_path / factor, *rows, compare=factor)
        assert results.differences[0].kind == kind
        said_same = [
            "count as the same sheets" in c and "call the factor paper" in c
            for c in results.cautions
        ]
        assert any(said_same) == are_the_same


def axis_of(angle, *, is_older):
    """Results with a map of angles of an axis with this mean; an older run states no period."""
    run = results_of(mean=angle)
    properties = run["layers"][0]["sheet"]["properties"]
    axis = properties["coating_top"] | {"units": "deg"}
    if is_older:
        properties["fibre_angle"] = axis
    else:
        properties["coating_top"] = axis | {"period_deg": 180.0}
    return run


@pytest.mark.parametrize("is_older", [False, True])
def test_mean_axes_are_averaged_and_compared_across_90_degrees(tmp_path, is_older):
    """Papers whose axes lie at 85 and at 95 degrees differ by 10, and not by 170."""
    rng = np.random.default_rng(0)
    near = {paper: at + rng.normal(0, 2, 6) for paper, at in (("A", 85.0), ("B", 95.0))}
    rows = [
        ({"paper": paper, "sheet": str(s)}, axis_of((angle + 90) % 180 - 90, is_older=is_older))
        for paper, angles in near.items()
        for s, angle in enumerate(angles)
    ]
    name = "fibre_angle" if is_older else "coating_top"
    results = said(tmp_path, *rows, headline=(name,))
    k = number_of(results, "mean", name)
    for paper, angles in near.items():
        (group,) = (g for g in results.groups if (g.quantity, g.group) == (k, {"paper": paper}))
        assert (group.mean - angles.mean() + 90) % 180 == pytest.approx(90)
        assert group.sd == pytest.approx(angles.std(ddof=1))
    difference = results.differences[k]
    assert difference.difference == pytest.approx(near["B"].mean() - near["A"].mean())
    welch = stats.ttest_ind(near["B"], near["A"], equal_var=False)
    assert difference.p == pytest.approx(welch.pvalue, rel=1e-6)
