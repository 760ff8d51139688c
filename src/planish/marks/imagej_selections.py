"""Selections that ImageJ saves: one, ``.roi``, or those of the ROI Manager, ``.zip``."""

import io
import struct
import zipfile
import zlib

from roifile import ImagejRoi

from planish.core.errors import FileError
from planish.core.tables import refuse_workbook

ROI, ZIP = b"Iout", b"PK"  # first bytes of a selection and of an archive
LARGEST_FILE = 64_000_000


def selections_in(data: bytes, name: str, *, most: int, remedy: str) -> list[tuple[str, bytes]]:
    """Give name and content of each selection of a file; FileError where it is damaged.

    ``most`` selections are allowed, ``remedy`` says what to do where there is none.
    """
    if not data.startswith(ZIP):
        return [(name, data)]
    refuse_workbook(data, name, what="table")
    # Entries of its table of contents, before that is read.
    if data.count(b"PK\1\2") > 2 * most:
        raise FileError(
            f"{name} holds more than {most} entries. Give an archive of the ROI Manager of ImageJ."
        )
    files: list[tuple[str, bytes]] = []
    bytes_left = LARGEST_FILE
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                if entry.is_dir() or entry.filename.startswith("__MACOSX/"):
                    continue
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError("packed in an unusual way")
                # What the archive says of its sizes need not be true.
                with archive.open(entry) as stream:
                    files.append((entry.filename, stream.read(bytes_left + 1)))
                bytes_left -= len(files[-1][1])
                if bytes_left < 0:
                    raise FileError(
                        f"{name} is too large when unpacked. Give an archive of the ROI Manager of"
                        " ImageJ."
                    )
    # One with a password is a RuntimeError.
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        RuntimeError,
        ValueError,
        struct.error,
    ) as error:
        raise FileError(
            f"{name} is a damaged archive ({error}). Save the selections again."
        ) from error
    if not files:
        raise FileError(f"{name} is an empty archive. {remedy}")
    return files


def selection_of(data: bytes) -> ImagejRoi:
    """Read a selection; ValueError, with the reason, where it is none."""
    if not data.startswith(ROI):
        raise ValueError("it is no selection of ImageJ")
    try:
        return ImagejRoi.frombytes(data)
    except (TypeError, ValueError, struct.error) as error:
        raise ValueError("it ends early") from error
