"""From a volume to the faces, interfaces and centre of its sheet, as heights above the volume's own columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_volume
from planish.core.errors import InputError, VolumeError
from planish.core.frame import Axis, End, Frame, other_axis
from planish.core.options import params_of
from planish.core.tiles import Engine
from planish.surface.assemble import assemble
from planish.surface.columns import Columns, make_guide
from planish.surface.corrected import correct_surfaces
from planish.surface.corrections import read_corrections
from planish.surface.faces import find_faces
from planish.surface.labels import surfaces_from_labels
from planish.surface.learn import learn_priors
from planish.surface.params import SurfaceParams
from planish.surface.plausible import check_axis, check_sheet
from planish.surface.regions import doubtful
from planish.surface.slices import find_faces_by_slice
from planish.surface.survey import take_survey

Array = NDArray[np.float64]


def find_surfaces(
    volume: xr.DataArray,
    *,
    through: Axis | None = None,
    top: End | None = None,
    frame: Frame | None = None,
    params: SurfaceParams | None = None,
    step: int = 1,
    engine: Engine | None = None,
    unusual_size: bool = False,
) -> xr.Dataset:
    """Find top, bottom, interfaces and centre surface of the sheet in a volume.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        Grey values, NaN is missing; with ``params.labels``, integer labels.
    through : {"z", "y", "x"}, optional
        Axis that runs through the sheet; as the volume says (:func:`planish.volume`), else z.
    top : {"high", "low"}, optional
        End of that axis at which the top side lies; as the volume says, else the high end.
    frame : Frame, optional
        Both in one piece.
    params : SurfaceParams
    step : int
        Width of a measured column in voxels: 1 measures every column of voxels, 3 the means of 3 x 3.
    engine : Engine
        How the tiles are worked on; local threads where not given. The result does not depend on it.
    unusual_size : bool
        Whether a sheet of 50 nm to 50 mm is taken; one of paper has 2 um to 5 mm.

    Returns
    -------
    Dataset, dims (y, x) = rows and columns of the frame
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre``: heights in um, coordinates along the
        axis through the sheet. NaN where there is no sheet; the interface of a side without a coating is all NaN.
        ``centre`` runs on across holes; where a hole or gap had to be bridged with a wider cut-off than the one stated,
        ``centre_cutoff_um`` gives the cut-off used (attribute ``bridged_share``: share of the columns). ``presence``:
        share of material along the normal below the top face, 0 to 1; ``presence_centre`` and ``presence_bottom``: the
        same around the centre surface and above the bottom face. Their attribute ``layer`` says from where to where, in
        shares of the thickness from the centre towards the top.
        ``status``: 0 measured, 1 no sheet, 2 rim of a hole or gap, 3 face not found, 5 the sheet touches another or
        itself, 6 it leaves the volume, 7 a particle sticks to it; 4 is left to the measurement. With
        ``envelope_um`` also ``top_envelope`` and ``bottom_envelope``.
        Attributes hold the grey levels and what was seen.

    Raises
    ------
    VolumeError
        If the volume holds no sheet, several, or one that fills it from end to end; if the sheet is not as thick as
        sheets are, or too few of its columns are measured for a map; if a label has no meaning or two. The axis that
        looks like the sheet's normal is named where another one was given.
    SizeError
        If the volume has no voxel size, or contradicts itself.
    InputError
        If it is no volume, or there is no such axis or end; if columns of labels are wider than a voxel, or a point of
        a correction lies outside the volume.
    FileError
        If the corrections cannot be read.

    Notes
    -----
    Every column is fitted with a blurred staircase air-coating-base. Levels differ from place to place within a
    spread that is learnt from the same volume, which keeps thin layers from taking the width of the blur.
    """
    check_volume(volume, "pl.find_surfaces({})")
    frame = Frame.asked(volume, frame, through, top)
    try:
        surfaces = _search(
            volume, frame, params_of(SurfaceParams, params, "pl.find_surfaces"), step, engine or Engine()
        )
        check_sheet(surfaces, unusual_size=unusual_size)
    except VolumeError as error:
        if hint := other_axis(volume, frame.through):
            raise VolumeError(f"{error.text} {hint}") from error
        raise
    return surfaces


def _search(volume: xr.DataArray, frame: Frame, params: SurfaceParams, step: int, engine: Engine) -> xr.Dataset:
    if params.labels is not None:
        if params.corrections is not None:
            raise InputError(
                "Faces are corrected in grey values. Correct labels in the program that made them, or leave "
                "--corrections out."
            )
        if step > 1:
            raise InputError(
                f"The labels of {step} x {step} voxels have no mean: labels need columns of one voxel. Give more "
                "memory (--memory), or crop the volume."
            )
        return surfaces_from_labels(volume, frame, params.labels, params, engine)
    columns = Columns(volume=volume, frame=frame, step=step)
    survey = take_survey(columns, params, engine)
    check_axis(columns, survey, params, engine)
    columns = replace(columns, padding=survey.padding)
    guide = make_guide(survey.coarse, columns)
    priors = learn_priors(columns, guide, survey, params)
    air = priors.scale.air
    search = find_faces if params.method == "profile" else find_faces_by_slice
    surfaces = assemble(
        columns, params, search(columns, guide, priors, engine, survey.coarse.specks),
        doubtful(guide, survey.coarse, priors.edge.width, columns.shape[2]),
        (air, priors.scale.polarity * priors.base + air), engine,
    )  # fmt: skip
    surfaces.attrs |= priors.attrs(columns.pitch[2], frame)
    surfaces.attrs |= {"missing_share": survey.missing_share, "empty_share": survey.empty_share}
    if survey.padding is not None:
        surfaces.attrs["padding"] = survey.padding
    if params.corrections is None:
        return surfaces
    corrections = read_corrections(params.corrections)
    return correct_surfaces(surfaces, volume, corrections, params=params, engine=engine)
