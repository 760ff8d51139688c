import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planish.core.transform import Similarity

PLACES_UM = st.floats(-1e4, 1e4)


@given(
    scale=st.floats(0.1, 10),
    angle=st.floats(-4, 4),
    x=PLACES_UM,
    y=PLACES_UM,
    mirrored=st.booleans(),
)
def test_inverse_undoes(scale, angle, x, y, mirrored):
    there = Similarity(scale=scale, rotation_rad=angle, shift_um=(x, y), mirrored=mirrored)
    points = np.array([[0.0, 0.0], [100.0, -3.0], [5.0, 2000.0]])
    # 1e-9 relative to coordinates of up to 1e4 um
    np.testing.assert_allclose(
        there.inverse(there(points)), points, atol=1e-5 * max(1, 1 / scale) * 1e-3
    )
    assert np.sign(np.linalg.det(there.matrix())) == (-1 if mirrored else 1)


def test_rotation_turns_x_towards_y():
    np.testing.assert_allclose(
        Similarity(rotation_rad=np.pi / 2)([[1.0, 0.0]]), [[0.0, 1.0]], atol=1e-15
    )
