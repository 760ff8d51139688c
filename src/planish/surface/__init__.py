"""From a volume to the faces, interfaces and centre of its sheet.

``find`` is the entry point: ``survey`` and ``coarse`` find the sheet, ``choose`` takes one of
several, ``sample`` and ``learn`` learn grey levels and blur, ``faces`` fits every column,
``assemble`` and ``centre`` put the result together. ``columns`` is the only module that reads
voxels. ``boundaries`` holds the methods without a profile (labels, slice by slice); ``draw`` and
``corrected`` what a person corrects.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
