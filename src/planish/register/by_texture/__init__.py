"""Registration by the texture of both layers, where no holes show the place.

``planes`` holds what of two layers may look alike, ``search`` finds one in the other: ``rotations``
among all rotations and shifts, and ``place`` tunes the place of the whole and finds those of tiles;
a model is fitted to these.
"""
