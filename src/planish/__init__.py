"""Links the 3D structure of a paper sheet to a 2D image of the same sheet."""

__version__ = "0.1.0"
