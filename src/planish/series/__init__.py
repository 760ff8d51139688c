"""Series of specimens: many links as one piece of work, and what they say together."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
