"""A run as files of other programs: one table of formats, and the functions that write them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
