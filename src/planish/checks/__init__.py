"""Checks of a run: all of a scan, a sheet, a registration and a link, in one table."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
