"""Series of specimens: many links in one command, and what they show together.

``plan`` reads the table of specimens, ``jobs`` does one and knows what is done, ``workers`` does
all, ``watch`` takes scans as they come. ``gather`` reads the runs, ``quantities`` and ``summary``
compare them, ``cautions`` warns, ``pages`` writes, ``open`` gives arrays.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
