"""The app in the browser: check, correct and explore a run, and apply that to a new one."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
