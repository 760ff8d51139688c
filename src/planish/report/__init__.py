"""From results to one HTML page that can be handed on, and to what a notebook shows."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
