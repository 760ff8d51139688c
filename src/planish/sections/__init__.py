"""Photographs of serial sections -> one volume: neighbours aligned, grey levels made equal, gaps bridged."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
