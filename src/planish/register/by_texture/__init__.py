"""Registration by the texture of both layers, where no holes show the place.

``planes`` holds what of two layers may look alike, ``find`` finds one in the other by ``search``,
the place of the whole among all rotations and shifts, and ``place``, which tunes it and finds those
of tiles; a model is fitted to these.
"""
