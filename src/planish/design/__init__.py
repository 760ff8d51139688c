"""Patterns of laser holes, planned for a field and a size of hole.

The pattern is checked, drawn, and written as a program for the stage.

``plan`` makes a ``pattern`` that keeps the ``rules``, ``draw`` its pages, ``gcode`` the program of
the stage.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
