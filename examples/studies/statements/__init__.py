"""Give what each study states, from the folder of a series.

One sentence or two with the interval, and one figure.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from . import fig_06, fig_07, fig_09, fig_11, flattening, no_holes

STATEMENTS: dict[str, Callable[[Path, Figure], str]] = {
    "fig-06": fig_06.state,
    "fig-07": fig_07.state,
    "fig-09": fig_09.state,
    "fig-11": fig_11.state,
    "flattening": flattening.state,
    "no-holes": no_holes.state,
}
"""One for each study."""


def statement(study: str, folder: Path, picture: Path) -> str:
    """Statement of a study whose series lies in ``folder``.

    Its figure is written to ``picture``.
    """
    figure = plt.figure(figsize=(9, 4), layout="constrained")
    try:
        text = STATEMENTS[study](folder, figure)
        figure.savefig(picture, dpi=100, metadata={"Software": None})
    finally:
        plt.close(figure)
    return text
