"""Laser holes in images and in flattened sheets; marks and regions in files.

``find`` is the entry point for images and maps: ``candidates`` says where a hole may be,
``hole_criteria`` which are, ``mask`` which pixels lie in them. ``sheet_holes`` finds the holes of a
flattened sheet, ``hole_files`` writes them. ``exchange`` reads and writes marks of other programs,
``regions`` declared artefacts.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
