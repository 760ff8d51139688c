"""From the warped centre surface to flat coordinates.

``sheet`` is the stage, ``relax`` the entry point to the solvers: ``multigrid`` on the ``levels`` of
a mesh of springs, ``direct`` for the coarsest, ``relaxation`` as published. ``distortion`` and
``curvature`` judge the result; ``variants`` flattens again with other heights.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
