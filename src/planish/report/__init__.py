"""Results as one HTML page to pass on, and as a notebook shows them.

``page`` puts the sections of any run together: ``first`` the first page, ``maps``, ``relation``,
``diagnostics``, ``registration``, ``flattening``, ``slices``, ``tables``. ``draw`` and ``colours``
make figures; ``summary``, ``statement`` and ``text`` the words and numbers, ``sentences`` those on
statistics; ``series`` the page of a series.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
