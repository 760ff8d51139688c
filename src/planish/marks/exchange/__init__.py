"""Marks in files: planish's own JSON and tables, BigWarp, elastix, 3D Slicer, MATLAB and ImageJ."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
