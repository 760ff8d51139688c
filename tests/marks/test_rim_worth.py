"""What an edge of a rim is worth."""

import numpy as np

from planish.marks._rim_kernels import edge_worth


def test_an_edge_is_worth_as_much_where_the_rim_has_no_contrast():
    """On paper that is saturated the rim may rise by nothing at all, which ended the search with a fault."""
    rises = np.array([[0.0, 0.0, 2.0, 0.0, 0.0]])
    for step in (0.0, 1.0):
        assert edge_worth(rises, step).tolist() == [[0.0, 1.0, 1.0, 1.0, 0.0]]
    assert edge_worth(rises, 4.0).tolist() == [[0.0, 0.5, 0.5, 0.5, 0.0]]
