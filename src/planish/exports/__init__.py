"""A run as files of other programs: one table of formats, and the functions that write them.

``exporting`` is the entry point, ``formats`` the table, ``run_contents`` what a run gives,
``content`` its maps.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
