"""The app in the browser: check, correct and explore a run, and apply the changes to a new one.

``server`` answers, by ``view_routes`` and ``marks_routes``. ``session`` is a run and what was
changed, ``changes`` one change, ``journal`` all of them on the disk. ``live`` and ``fits`` fit
marks as they move, ``snap`` finds the hole under one. ``picture``, ``pictures``, ``slices`` and
``strain`` are what is seen. ``order`` is what a new run is made of, ``apply`` has it made and
follows it, ``apply_worker`` is the process that makes it. ``static`` is the page, ES modules
without a build step; ``exploring`` a page for readers without planish.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
