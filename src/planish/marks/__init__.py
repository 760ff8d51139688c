"""Image or presence map -> laser holes; CSV -> pairs of marks; a field -> a pattern of holes to burn."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
