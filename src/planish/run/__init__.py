"""One run: from a study to layers that are mapped, linked, compared and saved; where stages meet.

``pipeline`` is the line, one call for each step: ``reading``, ``mapping`` (a volume in ``sheet``),
``registering`` (by ``marks_registration`` or ``texture_registration``), ``overlay``, ``compare``,
``judging`` and ``save``. ``layers`` holds what goes through it, ``workspace`` where it is made:
``preflight`` refuses what cannot work, ``cached_maps`` keeps maps of a link that is refused.
``study`` and ``compute`` are the parameters; ``build`` makes a study of paths and options,
``array_layers`` of arrays, ``study_template`` one to be filled in. ``run`` opens what was saved.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
