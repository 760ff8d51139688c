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

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

import lazy_loader as lazy

__version__ = "0.3.0"
_attribute, __dir__, __all__ = lazy.attach_stub(__name__, __file__)

_STEPS = {
    "flatten": "flatten_sheet",
    "marks": "find_holes",
    "measure": "measure_properties",
    "register": "register_marks",
    "report": "write_report",
    "resample": "resample_maps",
    "surface": "find_surfaces",
}
"""Package -> the function that is meant where the package is called."""


class _Step(ModuleType):
    def __call__(self, *_args: object, **_options: object) -> None:
        from planish.core.errors import InputError

        name = self.__name__.rpartition(".")[2]
        raise InputError(f"pl.{name} is a package, not a function. Call pl.{_STEPS[name]}(...).")


class _Planish(ModuleType):
    def __setattr__(self, name: str, value: object) -> None:
        if name in _STEPS and not isinstance(value, _Step):
            # Of its own class, which may keep functions from modules of their name.
            value.__class__ = type("_Step", (_Step, type(value)), {})
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Planish


def __getattr__(name: str) -> Any:
    return import_module(f"planish.{name}") if name in _STEPS else _attribute(name)
