"""Turn photographs of serial sections into one volume.

Neighbours are aligned, grey levels made equal, and gaps bridged.

``band`` finds the sheet in the stack, ``pairs`` the offsets between two sections, ``network`` one
place for every section, ``align`` the whole alignment, ``volume`` the volume.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
