"""Every error a user can meet, by what they can do about it.

::

    PlanishError                     exit code 1
    ├── InputError                   exit code 3: what was given cannot be used as it is
    │   ├── FileError                a file or folder cannot be read or written
    │   ├── SizeError                a voxel or pixel size is missing, contradictory or impossible
    │   ├── VolumeError              the volume does not show one sheet
    │   ├── StudyError               parameters that do not fit together, or mean nothing for these files
    │   ├── SurfaceError             a surface is missing or out of order
    │   └── MarkError                marks are missing, malformed or unusable
    ├── CannotMeasure                exit code 3: no property can be measured on this surface
    ├── CannotFlatten                exit code 3: the mesh has no sensible flat state
    ├── CannotRegister               exit code 3: the marks do not fix one transformation
    └── ResourceError                exit code 5: memory or disk is used up

A message says what was found, what is needed, and what to do next. The command line prints it and ends
with the exit code of the class; nothing else in planish decides exit codes.
"""


class PlanishError(Exception):
    """Root of all errors that planish raises on purpose."""

    exit_code = 1


class InputError(PlanishError):
    """What was given cannot be used as it is."""

    exit_code = 3


class FileError(InputError):
    """A file or folder cannot be read or written."""


class SizeError(InputError):
    """A voxel or pixel size is missing, contradictory or impossible."""


class VolumeError(InputError):
    """The volume does not show one sheet."""


class StudyError(InputError):
    """Parameters that do not fit together, or mean nothing for these files; on the command line, wrong usage."""


class SurfaceError(InputError):
    """A surface is missing or out of order."""


class MarkError(InputError):
    """Marks are missing, malformed or unusable."""


class CannotMeasure(PlanishError):
    """No property can be measured on this surface."""

    exit_code = 3


class CannotFlatten(PlanishError):
    """The mesh has no sensible flat state."""

    exit_code = 3


class CannotRegister(PlanishError):
    """The marks do not fix one transformation."""

    exit_code = 3


class ResourceError(PlanishError):
    """Memory or disk is used up."""

    exit_code = 5
