"""Options of the measurement, and the table of the modules with properties: an import, and a base.

Every module declares properties, as :mod:`~planish.measure.registry` says, and its own options as a
``Params`` model; :class:`MeasureParams` inherits these, for the study file, the command line and
the documents. No numba or scipy here.
"""

from planish.measure import lengths, masses, phases, structure
from planish.measure.options import Common


# Fields of the last base come first.
class MeasureParams(
    lengths.RoughnessOptions,
    lengths.ThicknessOptions,
    structure.Options,
    lengths.InkOptions,
    phases.Options,
    masses.Options,
    Common,
):
    """Options of the properties; lengths in um, grey levels in the volume's own values."""
