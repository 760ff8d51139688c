"""planish links the 3D structure of a paper sheet to a 2D image of the same sheet, pixel by pixel.

The line by hand::

    import planish as pl

    volume, image = pl.read_volume("volume.tif"), pl.read_image("image.tif")
    surfaces = pl.find_surfaces(volume)
    measured = pl.measure_properties(surfaces, volume=volume)
    flat = pl.flatten_sheet(surfaces).flat
    maps = pl.resample_maps(measured, flat)
    registration = pl.register_marks(pl.find_holes(maps), pl.find_holes(image))
    linked = pl.resample_maps(measured, flat, onto=image, registration=registration)
    rows = pl.correlate_maps(linked)

or at once: ``run = pl.link("volume.tif", "image.tif", out="run")``. Lengths are um, missing is NaN.
"""

import lazy_loader as lazy

__version__ = "0.3.0"
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
