"""Options of the inputs: a volume and how the sheet lies in it, and an image and what it shows."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from planish.core.frame import Frame
from planish.core.options import Params, option
from planish.core.typing import Entries

HIGHEST_GAMMA = 4.0  # those of cameras and screens are 1.8 to 2.6

Size = Annotated[float, Field(gt=0)]


def _all_alike(count: int) -> BeforeValidator:
    return BeforeValidator(lambda size: (size,) * count if isinstance(size, (int, float)) else size)


Index = Annotated[int, Field(ge=0)]
Channel = Literal["luminance", "red", "green", "blue"]


class VolumeParams(Params):
    """A volume and how the sheet lies in it."""

    path: str = option(help="File or folder of the volume (docs/formats.md).", cli=None)
    voxel_um: Annotated[tuple[Size, Size, Size] | None, _all_alike(3)] = option(
        None,
        metavar="SIZE|Z,Y,X",
        repeat=True,
        help="Voxel size in um, if the file does not state it.",
    )
    through: Literal["z", "y", "x"] = option("z", help="Axis that runs through the sheet.")
    top: Literal["high", "low"] = option(
        "high",
        help="End of that axis at which the top side lies. Maps are displayed as seen from there.",
    )
    override_size: bool = option(False, help="Use these sizes even if a file states others.")
    unusual_size: bool = option(
        False,
        help=(
            "Accept sizes that paper does not have: pixels of 0.1 nm to 1 mm, sheets of 50 nm to"
            " 50 mm."
        ),
    )
    channel: Channel | None = option(
        None,
        cli="--volume-channel",
        help="Channel of slices or sections in colour; default: luminance.",
    )
    column_um: float | None = option(
        None,
        gt=0,
        help=(
            "Width of the measured columns in um; default: single voxels, or wider as memory"
            " demands."
        ),
    )
    fixed_rows: tuple[Index, Index] | None = option(
        None,
        metavar="FIRST,LAST",
        help=(
            "Serial sections: rows of the photographs along which a fixed straight line runs, such"
            " as the edge of the block. It separates slow drift of the sections from a bend of the"
            " sheet."
        ),
    )
    fixed_cols: tuple[Index, Index] | None = option(
        None, metavar="FIRST,LAST", help="The same for a line along the columns."
    )
    md_deg: float | None = option(
        None,
        ge=-180,
        le=180,
        metavar="ANGLE",
        help="Machine direction in the flattened map, degrees clockwise from its x axis.",
    )

    @property
    def frame(self) -> Frame:
        """Lie of the sheet in the volume."""
        return Frame(through=self.through, top=self.top)

    @property
    def how(self) -> Entries:
        """Options that :func:`planish.read_volume` takes."""
        return self.model_dump(include={"voxel_um", "channel", "override_size", "unusual_size"})


class ImageParams(Params):
    """An image, and which side of the sheet it shows."""

    path: str = option(help="File of the image.", cli=None)
    pixel_um: Annotated[tuple[Size, Size] | None, _all_alike(2)] = option(
        None,
        metavar="SIZE|Y,X",
        repeat=True,
        help="Pixel size in um, if the image does not state it.",
    )
    channel: str = option(
        "luminance",
        help="Channel of a colour image: luminance, red, green, blue or a number from 0.",
    )
    override_size: bool = option(
        False, cli=None, help="Use this size even if the file states another."
    )
    unusual_size: bool = option(
        False, cli=None, help="Accept a pixel size that images of paper do not have."
    )
    side: Literal["top", "bottom"] | None = option(
        None,
        cli="--image-side",
        help=(
            "Side of the sheet that the image shows; default: top, which the report then calls"
            " assumed."
        ),
    )
    md_deg: float | None = option(
        None,
        ge=-180,
        le=180,
        cli="--image-md-deg",
        metavar="ANGLE",
        help=(
            "Machine direction in the image, likewise; compared with `md_deg`, which the"
            " registration carries over."
        ),
    )
    dark_grey: float | None = option(
        None,
        metavar="GREY",
        help=(
            "Grey of the image without light, in its own values; with `white_grey` the image"
            " becomes reflectance. Without both, grey values are uncalibrated."
        ),
    )
    white_grey: float | None = option(
        None,
        metavar="GREY",
        help="Grey of a white reference in the same light, likewise; its reflectance counts as 1.",
    )
    white: str | None = option(
        None,
        metavar="FILE",
        help=(
            "Picture of a white sheet in the same light, with the image's pixels or binned; the"
            " image is first divided by it and becomes reflectance."
        ),
    )
    dark: str | None = option(
        None,
        metavar="FILE",
        help="Picture without light, likewise, subtracted from both; default: black is 0.",
    )
    white_exposure: float | None = option(
        None,
        gt=0,
        help=(
            "Exposure of `white` over that of the image, 1 for the same; without it reflectance is"
            " known up to a factor."
        ),
    )
    gamma: Literal["srgb"] | Annotated[float, Field(ge=1, le=HIGHEST_GAMMA)] | None = option(
        None,
        metavar="srgb|EXPONENT",
        help=(
            "Curve that the image and its `white` and `dark` are coded with, undone before"
            " anything else: srgb, an exponent such as 2.2, or 1 for linear grey."
        ),
    )
    screen_um: float | None = option(
        None,
        gt=0,
        help=(
            "Period of a print screen in um (167 for 60 lines per cm): a Gaussian takes it off the"
            " image before it is compared."
        ),
    )

    @property
    def how(self) -> Entries:
        """Options that :func:`planish.read_image` takes."""
        names = {"pixel_um", "channel", "override_size", "unusual_size", "gamma"}
        return self.model_dump(include=names)

    @model_validator(mode="after")
    def _references(self) -> Self:
        if self.white is None and (self.dark or self.white_exposure):
            raise ValueError(
                "dark and white_exposure need white: give the picture of a white sheet"
            )
        if self.white is not None and self.dark_grey is not None:
            raise ValueError(
                "white is given, and so are dark_grey and white_grey: give pictures or single greys"
            )
        if (self.dark_grey is None) != (self.white_grey is None):
            raise ValueError(
                "dark_grey and white_grey belong together: give both, or neither for grey values"
            )
        if self.dark_grey is None or self.white_grey is None:
            return self
        if not self.white_grey > self.dark_grey:
            raise ValueError(
                f"the white reference ({self.white_grey:g}) has to be lighter than the dark one"
                f" ({self.dark_grey:g})"
            )
        return self
