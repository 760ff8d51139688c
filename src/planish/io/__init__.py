"""Files to volumes and images: every format is read here, and every length becomes micrometres.

``formats`` is the table of formats, each read by its ``*_volume`` module; ``image`` and ``picture`` read the 2D side,
``topography`` height maps, ``sections`` photographs of sections, ``arrays`` what is in memory already. ``sizes``
settles one voxel or pixel size, ``guard`` the border to the decoders, ``inspection`` and ``info`` what looks wrong.
``store`` is the working store of a volume, ``map_store`` that of maps, ``run_folder`` the folder of a run, written
whole or not at all; ``hashes`` tells two inputs apart.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
