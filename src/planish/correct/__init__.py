"""Rings and cupping of a micro-CT volume: found, corrected, and reported.

``volume`` is the entry point; ``sums`` looks through the slices, ``rings`` and ``cupping`` find,
``picture`` draws.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
