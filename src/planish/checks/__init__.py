"""Checks of a scan, a sheet, a registration and a link, in one table.

``registry`` holds CHECKS, a row a check, and what they leave of the figures. ``scan`` and
``windows`` read parts of a volume once; ``greys``, ``slices``, ``sheets``, ``through_scale`` and
``registration`` hold the functions.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
