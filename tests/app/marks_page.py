"""What tests of the page's marks share."""

from __future__ import annotations

import numpy as np

VOLUME, IMAGE = "Volume side", "Image side"


def expect(what):
    """Wait until the page shows something."""
    from playwright.sync_api import expect as wait_for

    wait_for.set_options(timeout=15000)
    return wait_for(what)


def message(shown):
    return shown.role("status", "Message")


def ends(rows):
    """Places of the rows, (n, 4)."""
    return np.array([[float(cell) for cell in row[2:6]] for row in rows])


def settled(shown):
    """The rows when the fit of the chosen model has followed."""
    expect(shown.role("table", "Marks")).not_to_contain_text("follows")
    return shown.rows()
