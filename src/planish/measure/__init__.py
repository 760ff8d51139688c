"""Properties along the normals of the centre surface, from surfaces and the volume between them.

``registry`` says what a property is, ``params`` is the table of their modules: ``lengths``,
``phases``, ``masses``, ``structure``; ``options`` are those that all share. ``properties`` is the
step of a run, ``rays`` meet faces and voxels along the normals, ``greys`` are the levels of the
sheet. ``uncertainty`` gives standard errors, ``numbers`` and ``depth_profiles`` what is no map,
``straighten`` the volume in which the sheet lies flat.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
