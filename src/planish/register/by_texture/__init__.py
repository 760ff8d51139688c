"""Registration by the texture of both layers, where no holes show the place.

``search`` finds the place of the whole, ``place`` those of its tiles, which a model is fitted to.
"""
