"""The transformation between two layers, from their marks.

Which marks belong together, and how far the transformation may be off.

``holes`` is the entry point: ``match`` pairs marks by ``match_search`` and ``match_choose``,
``fit`` fits a model of the table ``models`` and finds wrong marks. ``model`` is the base of all:
``similarity``, ``bent``, ``spline``, and ``field``, what the marks make likely. ``result`` is a fit
with its errors, and a chain of them; ``refinement`` moves a fit by the maps themselves;
``through_scale`` asks the marks for the scale of heights. ``by_texture`` is for layers without
holes.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
