"""One run: from a study to layers that are mapped, linked, compared and saved; where stages meet.

A study goes from top to bottom: ``study`` and ``compute`` are its parameters, ``build`` makes one
of paths and options, ``array_layers`` of arrays, ``study_template`` one to be filled in. ``save``
does it: ``preflight`` refuses what cannot work, ``volume`` and ``sheet`` map a volume,
``cached_maps`` keeps maps of a link that is refused, ``layers`` holds what is linked, ``linking``
is the way of a link, by ``registration`` and ``overlay`` (with ``regions`` masked and
``position_error`` mapped); ``gathering`` and ``facts`` put its numbers together, ``compare``
correlates on request. ``run`` opens what was saved.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
