"""The calibration certificate, which states the error of every stage.

Synthetic specimens go through the whole program.

``scenario`` says which specimens and figures, ``certify`` runs them, ``truth`` and ``errors``
compare, ``example`` draws one specimen, ``table`` and ``page`` write; ``specimen_template`` makes
specimens like a real run.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
