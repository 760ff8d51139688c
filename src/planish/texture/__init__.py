"""Textures of maps, and how closely two of them agree.

``textures`` takes what is no texture off and averages; ``detrend`` parts waves by their length, and
makes unrelated maps; ``ncc`` is the correlation at every lag; ``lag_field`` and ``lag_search`` find
the lag of tiles; ``white_noise`` takes off noise that no neighbour shares; ``covariance`` counts
the independent points of maps and of their products.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
