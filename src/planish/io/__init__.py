"""Files to volumes and images: every format is read here, and every length becomes micrometres."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
