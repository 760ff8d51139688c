"""A specimen whose every answer is known, for the demo, tests, benchmarks and calibration.

``params`` and ``presets`` say what is ordered; ``sheet`` makes it; ``instruments``, ``camera`` and
``pose`` look at it; ``specimen`` holds it with its truth, ``files`` writes as instruments do, and
``making`` puts all of this together. It needs nothing that measures.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
