"""Relations of maps on one grid: how close they are, at which scales, and with what certainty.

``compare`` correlates layers, ``correlation`` is r with its interval, from covariances by lag.
``correlation_evidence`` holds QUESTIONS, a row a statistic beside r: ``curve_of_sizes`` and
``octaves`` (at which scale), ``robustness``, ``conley_interval``, ``curve``, ``thin_regions``,
``light_field`` (uneven light), ``attenuation`` and ``split_half`` (what could be seen),
``variograms`` and ``correlograms`` (by distance), ``agreement`` and ``rings`` (one quantity twice),
``kubelka_munk`` and ``light_spread`` (light over a coating). ``compared_maps`` and
``sheet_columns`` are what these are given. ``sides`` and ``lag`` check the registration by what the
maps share, ``refinement`` improves it.
``explain`` is about a map and several others: ``cells``, ``multiple_regression``,
``generalised_least_squares``, ``shared_errors``, ``explain_sheets``.
``scales`` is a map by octaves of wavelength, ``formation`` the random sheet beside it.
``image_values`` and ``mottle`` are about images. ``sheets``, ``between_sheets``, ``pooled``
and ``differences`` are about many sheets; ``distributions`` is what they need.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
