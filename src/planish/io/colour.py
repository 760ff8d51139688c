"""Colour to grey, in the type of the file: the luminance, or one of the colours."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import InputError
from planish.io.image import COLOURS, LUMINANCE

CHANNELS = ("luminance", *COLOURS)


def check_channel(channel: str | None) -> str | None:
    """Return the name of a channel in small letters."""
    if channel is None:
        return None
    word = channel.strip().casefold()
    if word not in CHANNELS:
        raise InputError(
            f"{channel!r} is no channel of a volume. Choose one of {', '.join(CHANNELS)} with --volume-channel."
        )
    return word


def grey_of(colour: NDArray[Any], *, channel: str) -> NDArray[Any]:
    """Turn the last axis, red, green and blue, into grey; luminance is rounded in integers."""
    if channel != "luminance":
        return colour[..., COLOURS[channel]]
    # In double precision 16-bit values come out exact, so that grey stored as colour stays what it was.
    grey = colour[..., :3].astype(np.float64) @ np.array(LUMINANCE)
    return (np.rint(grey) if colour.dtype.kind in "ui" else grey).astype(colour.dtype)


def to_grey(channel: str | None) -> partial[NDArray[Any]]:
    """Function from colour to grey that can be sent to another process."""
    return partial(grey_of, channel=channel or "luminance")


def colour_attrs(channel: str | None) -> dict[str, str]:
    """Attributes of a volume whose files are in colour."""
    if channel is None:
        return {"channel": "luminance", "colour": "The files are in colour; no channel was chosen, so luminance is."}
    return {"channel": channel, "colour": f"The files are in colour; the channel chosen is {channel}."}


def refuse_channel(channel: str | None, path: Path) -> None:
    """Refuse a choice of colours where there are none."""
    if channel is not None and channel != "luminance":
        raise InputError(f"{path.name} is grey, so it has no {channel}. Leave --volume-channel out.")
