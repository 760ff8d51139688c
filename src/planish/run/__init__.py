"""The whole line, from files to linked maps; the only place where stages meet."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
