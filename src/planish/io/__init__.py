"""Volumes and images from files, with every length in micrometres, and stores of results.

``formats`` is the table of formats, each read by its ``*_volume`` module; ``sizes`` settles one
voxel or pixel size.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
