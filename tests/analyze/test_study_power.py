import math

import numpy as np
import pytest
from scipy import stats

from folders import refused
from planish.analyze import (
    Fields,
    difference_of_pooled_r,
    expected_n_eff,
    power_of_study,
    sheets_needed,
)
from planish.core.errors import InputError, SizeError


def test_n_eff_is_that_of_the_matrix_of_all_points_also_for_fine_texture():
    shape, length, parts = (5, 6), 2.5, 8
    at = np.stack(
        np.meshgrid(*((np.arange(k * parts) + 0.5) / parts for k in shape), indexing="ij"), axis=-1
    )
    cells = (
        at.reshape(shape[0], parts, shape[1], parts, 2)
        .transpose(0, 2, 1, 3, 4)
        .reshape(30, parts**2, 2)
    )
    matrix = np.array(
        [
            [np.exp(-np.hypot(*(a[:, None] - b).transpose(2, 0, 1)) / length).mean() for b in cells]
            for a in cells
        ]
    )
    matrix = matrix - matrix.mean(axis=0) - matrix.mean(axis=1)[:, None] + matrix.mean()
    found = expected_n_eff(
        (shape[0] * 20.0 + 3, shape[1] * 20.0 + 19), length_um=length * 20, point_um=20.0
    )
    assert found == pytest.approx(1 + np.trace(matrix) ** 2 / np.sum(matrix * matrix), rel=1e-9)
    assert expected_n_eff((2000.0, 3000.0), length_um=(1.0, 1.0), point_um=100.0) == pytest.approx(
        600, rel=0.01
    )
    # Of unlike maps the shorter one counts more.
    mixed = expected_n_eff((2000.0, 3000.0), length_um=(20.0, 300.0), point_um=100.0)
    assert mixed > 2 * expected_n_eff((2000.0, 3000.0), length_um=300.0, point_um=100.0)


@pytest.mark.parametrize("paired", [True, False])
def test_power_is_that_of_the_noncentral_t(paired):
    found = power_of_study(
        (0.21, 0.26),
        sheets=8,
        fields=3,
        n_eff=103,
        between_sheets=0.1,
        paired=paired,
        change_between_sheets=0.05,
        shared=0.5,
    )
    own, (one, two) = 1 / 300, (0.79, 0.74)
    if paired:
        variance = (one - two) ** 2 * 0.01 + two**2 * 0.0025 + (one**2 + two**2 - one * two) * own
        error, free = math.sqrt(variance / 8), 7
    else:
        parts = [s * s * (0.01 + own) / 8 for s in (one, two)]
        error, free = math.sqrt(sum(parts)), sum(parts) ** 2 / sum(v * v / 7 for v in parts)
    shift = (math.sqrt(0.26) - math.sqrt(0.21)) / error
    quantile = stats.t.ppf(0.975, free)
    seen = stats.nct.sf(quantile, free, shift) + stats.nct.cdf(-quantile, free, shift)
    assert found.standard_error == pytest.approx(error, rel=1e-12)
    assert found.power == pytest.approx(seen, abs=1e-7)


@pytest.mark.parametrize("paired", [True, False])
def test_the_fewest_sheets_are_found(paired):
    given = {
        "fields": 3,
        "n_eff": 200.0,
        "between_sheets": 0.1,
        "paired": paired,
        "change_between_sheets": 0.05,
    }
    found = sheets_needed((0.21, 0.26), **given)
    fewer = power_of_study((0.21, 0.26), sheets=found.sheets - 1, **given)
    assert fewer.power < 0.8 <= found.power
    assert sheets_needed((0.1, 0.9), **given).sheets == 3


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"r2": (0.2, 0.2)}, "two different ones"),
        ({"r2": (0.2, 1.0)}, "below 1"),
        ({"fields": 0}, "0 fields"),
        ({"n_eff": 9.0}, "10 or more"),
        ({"shared": 1.5}, "share from 0 to 1"),
        ({"power": 1.0}, "power is 1"),
        ({"r2": (0.2, 0.20001)}, "do not see a difference"),
    ],
)
def test_wrong_designs_are_refused(change, why):
    given = {
        "r2": (0.21, 0.26),
        "fields": 3,
        "n_eff": 100.0,
        "between_sheets": 0.1,
        "paired": True,
    } | change
    refused(InputError, why, sheets_needed, **given)


def test_wrong_fields_are_refused():
    with pytest.raises(InputError, match="2 sheets"):
        power_of_study((0.2, 0.3), sheets=2, fields=1, n_eff=100, between_sheets=0.1, paired=True)
    refused(SizeError, "above 0", expected_n_eff, (0.0, 1.0), length_um=1.0, point_um=1.0)
    refused(SizeError, "holds 1 points", expected_n_eff, (1.0, 1.0), length_um=1.0, point_um=1.0)


@pytest.mark.nightly
@pytest.mark.parametrize("paired", [True, False])
def test_simulated_studies_have_the_power(paired):
    rng, seen, shared = np.random.default_rng(0), [], 0.5
    r2, fields, n_eff, between, change = (0.21, 0.36), 3, 60.0, 0.08, 0.05
    planned = sheets_needed(
        r2,
        fields=fields,
        n_eff=n_eff,
        between_sheets=between,
        paired=paired,
        change_between_sheets=change,
        shared=shared,
    )
    k, own = planned.sheets, math.sqrt(1 / (n_eff - 3))
    names = np.repeat(np.arange(k), fields).astype(str).tolist()
    mean = np.arctanh(np.sqrt(r2))
    for _ in range(1500):
        sheet = between * rng.normal(size=(2, k))
        noise = own * rng.normal(size=(2, k, fields))
        if paired:
            sheet[1] = sheet[0] + change * rng.normal(size=k)
            noise[1] = shared * noise[0] + math.sqrt(1 - shared**2) * noise[1]
        one, two = (
            Fields(np.tanh(m + s[:, None] + e).ravel().tolist(), names)
            for m, s, e in zip(mean, sheet, noise, strict=True)
        )
        seen.append(difference_of_pooled_r(one, two, paired=paired).distinguishable)
    print(planned, np.mean(seen))
    # 1500 studies scatter by .010.
    assert np.mean(seen) == pytest.approx(planned.power, abs=0.03)
