"""Find the faces, interfaces and centre of the sheet in a volume.

They are heights above the volume's own columns.
"""

from dataclasses import replace

import numpy as np
import xarray as xr

from planish.core.arrays import check_volume
from planish.core.errors import InputError, VolumeError
from planish.core.frame import Axis, End, Frame, likely_through, other_axis
from planish.core.options import params_of
from planish.core.tiles import Engine
from planish.surface.assemble import assemble
from planish.surface.boundaries import find_faces_by_slice, surfaces_from_labels
from planish.surface.coarse import CoarseSheet, to_columns
from planish.surface.columns import Columns, make_guide
from planish.surface.corrected import correct_surfaces
from planish.surface.faces import find_faces
from planish.surface.fit_errors import fit_errors
from planish.surface.learn import learn_priors
from planish.surface.params import SurfaceParams, read_corrections
from planish.surface.regions import doubtful
from planish.surface.survey import Survey, take_survey


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
        Width of a measured column in voxels: 1 measures every column of voxels, 3 the means of 3 x
        3.
    engine : Engine
        How the tiles are worked on; local threads where not given. The result does not depend on
        it.
    unusual_size : bool
        Whether a sheet of 50 nm to 50 mm is taken; one of paper has 2 um to 5 mm.

    Returns
    -------
    Dataset, dims (y, x) = rows and columns of the frame
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre``: heights in um,
        coordinates along the
        axis through the sheet. NaN where there is no sheet; the interface of a side without a
        coating is all NaN.
        ``centre`` runs on across holes; where a hole or gap had to be bridged with a wider cut-off
        than the one stated,
        ``centre_cutoff_um`` gives the cut-off used (attribute ``bridged_share``: share of the
        columns). ``presence``:
        share of material along the normal below the top face, 0 to 1; ``presence_centre`` and
        ``presence_bottom``: the
        same around the centre surface and above the bottom face. Their attribute ``layer`` says
        from where to where, in
        shares of the thickness from the centre towards the top. ``presence_faces``: 1 in columns
        with both faces of a coated sheet, 0 in openings. ``centre_shorter``: how far the
        centre surface of a shorter cut-off lies over it; ``base_middle``: how far the middle of the
        base does, where both interfaces were found at half of the columns or more. Both in um, NaN
        beyond the outline; they say how far the place of a column depends on that choice.
        ``status``: 0 measured, 1 no sheet, 2 rim of a hole or gap, 3 face not found, 5 the sheet
        touches another or
        itself, 6 it leaves the volume, 7 a particle sticks to it; 4 is left to the measurement.
        With
        ``envelope_um`` also ``top_envelope`` and ``bottom_envelope``.
        Attributes hold the grey levels and what was seen.
        Attributes ``beside`` and ``beside_gap_um``: what air parts from the sheet and was left out,
        such as a film, and
        the narrowest gap; only where there is such a thing.

    Raises
    ------
    VolumeError
        If the volume holds no sheet, several, or one that fills it from end to end; if the sheet is
        not as thick as sheets are, or too few of its columns are measured for a map; if a label has
        no meaning or two. The axis that looks like the sheet's normal is named where another one
        was given.
    SizeError
        If the volume has no voxel size, or contradicts itself.
    InputError
        If it is no volume, or there is no such axis or end; if columns of labels are wider than a
        voxel, or a point of a correction lies outside the volume.
    FileError
        If the corrections cannot be read.

    Notes
    -----
    Every column is fitted with a blurred staircase air-coating-base. Levels differ from place to
    place within a spread that is learnt from the same volume, which keeps thin layers from taking
    the width of the blur.
    """
    check_volume(volume, "pl.find_surfaces({})")
    frame = Frame.asked(volume, frame, through, top)
    params = params_of(SurfaceParams, params, "pl.find_surfaces")
    try:
        surfaces = _search(volume, frame, params, step, engine or Engine())
        check_sheet(surfaces, unusual_size=unusual_size)
    except VolumeError as error:
        if axis_hint := other_axis(volume, frame.through):
            raise VolumeError(f"{error.text} {axis_hint}") from error
        raise
    return surfaces


def _search(
    volume: xr.DataArray, frame: Frame, params: SurfaceParams, step: int, engine: Engine
) -> xr.Dataset:
    """Search for the surfaces, of grey or of labels, and correct them.

    First a look at the whole volume, then priors from some columns, then the fit of all columns;
    what was seen on the way goes into the attributes.
    """
    if params.labels is not None:
        if params.corrections is not None:
            raise InputError(
                "Faces are corrected in grey values. Correct labels in the program that made them."
            )
        if step > 1:
            raise InputError(
                f"The labels of {step} x {step} voxels have no mean. Give more memory (`memory`),"
                " or crop the volume."
            )
        return surfaces_from_labels(volume, frame, params.labels, params, engine)
    columns = Columns(volume=volume, frame=frame, step=step)
    survey = take_survey(columns, params, engine)
    check_axis(columns, survey, params, engine)
    columns = replace(columns, padding=survey.padding)
    guide = make_guide(survey.coarse, columns)
    priors = learn_priors(columns, guide, survey, params)
    air_grey = priors.scale.air_grey
    find_by_method = find_faces if params.method == "profile" else find_faces_by_slice
    faces = find_by_method(columns, guide, priors, engine, survey.coarse.specks)
    depth = columns.shape[2]
    doubt = doubtful(guide, survey.coarse, priors.edge.width, depth)
    base_grey = priors.scale.polarity * priors.base_level + air_grey
    surfaces = assemble(columns, params, faces, doubt, (air_grey, base_grey), engine)
    attrs = surfaces.attrs
    attrs |= priors.attrs(columns.pitch[2], frame)
    attrs["missing_share"] = survey.missing_share
    attrs["empty_share"] = survey.empty_share
    if params.method == "profile":
        for from_high, errors_px in fit_errors(columns, guide, priors).items():
            side = frame.side_at(from_high=from_high)
            errors_um = errors_px * columns.pitch[2]
            attrs[f"fit_errors_{side}_um"] = errors_um.ravel().tolist()
    if survey.padding is not None:
        attrs["padding"] = survey.padding
    attrs |= _attrs_of_companions(survey.coarse, columns, surfaces)
    if params.corrections is None:
        return surfaces
    corrections = read_corrections(params.corrections)
    return correct_surfaces(surfaces, volume, corrections, params=params, engine=engine)


def _attrs_of_companions(
    coarse: CoarseSheet, columns: Columns, surfaces: xr.Dataset
) -> dict[str, str | float]:
    """Describe the objects left out beside the sheet, and give the narrowest gap to one of them.

    A gap is the median air between the face of the sheet and that of the object.
    """
    if not coarse.companions:
        return {}
    voxel_um = columns.pitch[2]
    texts: list[str] = []
    gaps_um: list[float] = []
    for companion in coarse.companions:
        side = columns.frame.side_at(from_high=companion.end == "high")
        face_um = surfaces[side].values
        facing_px = to_columns(companion.facing, coarse.block, face_um.shape)
        facing_um = float(columns.depth_um[0]) + voxel_um * facing_px
        gap_um = float(np.nanmedian(np.abs(face_um - facing_um)))
        gaps_um.append(gap_um)
        texts.append(
            f"{companion.thickness_px * voxel_um:.0f} um thick, some {gap_um:.0f} um from the"
            f" {side} side, in {100 * companion.share:.0f} % of the columns"
        )
    return {"beside": "; ".join(texts), "beside_gap_um": min(gaps_um)}


_LEAST_SHARE = 0.15  # of the columns with more than air: with less there is no map
# Of the columns: where the sheet leaves the volume in fewer, its axis is not questioned.
_LEAVES = 0.2


def check_sheet(surfaces: xr.Dataset, *, unusual_size: bool) -> None:
    """Raise VolumeError if a sheet is too thin or thick, or too few columns are measured."""
    thickness_um = float(surfaces.attrs["thickness_um"])
    # From a thin tissue to a thick board, with room on both sides.
    min_um, max_um = (0.05, 50_000.0) if unusual_size else (2.0, 5000.0)
    if not min_um <= thickness_um <= max_um:
        voxel_text = ", ".join(f"{v:g}" for v in surfaces.attrs["voxel_um"])
        raise VolumeError(
            f"The sheet would be {thickness_um:.3g} um thick; sheets of {min_um:g} to {max_um:g} um"
            f" are mapped. The voxel size of {voxel_text} um (z, y, x) is probably in another unit."
            " Give the right one with `voxel_um` and `override_size=True`, or add"
            " `unusual_size=True` if it is no paper."
        )
    measured_share = float((surfaces["status"].values == 0).mean())
    measured_share /= max(1.0 - float(surfaces.attrs.get("empty_share", 0.0)), measured_share)
    if measured_share < _LEAST_SHARE:
        raise VolumeError(
            f"Both faces of the sheet were found in {100 * measured_share:.1f} % of the columns"
            f" that are not all air; {100 * _LEAST_SHARE:.0f} % are needed. Check `through` and"
            " `sheet_grey`, and that the sheet stays in the volume."
        )


def check_axis(columns: Columns, survey: Survey, params: SurfaceParams, engine: Engine) -> None:
    """Raise VolumeError where the sheet is seen edge on along the axis of the search.

    It is raised before every column is searched.

    Only a sheet that leaves the volume in many columns is looked at along the axis of its likely
    normal, too. There it has to stay inside, and to be a sixth as thick or less: its normal is more
    than 80 degrees off the axis given.
    """
    coarse_sheet = survey.coarse
    if coarse_sheet.is_leaving.mean() < _LEAVES:
        return
    likely_axis = likely_through(columns.volume.variable)
    if likely_axis is None or likely_axis == columns.frame.through:
        return
    turned_columns = replace(columns, frame=Frame(through=likely_axis), padding=None)
    try:
        turned_sheet = take_survey(turned_columns, params, replace(engine, folder=None)).coarse
    except VolumeError:
        return
    thickness_um = _extent_um(coarse_sheet, columns)
    turned_um = _extent_um(turned_sheet, turned_columns)
    # A sheet that is seen edge on measures a sixth of its run, or less, along its normal.
    if turned_sheet.is_leaving.mean() < _LEAVES and turned_um < 1 / 6 * thickness_um:
        raise VolumeError(
            f"The sheet is seen edge on: along {columns.frame.through} it leaves the volume in"
            f" {100 * coarse_sheet.is_leaving.mean():.0f} % of the columns, and is"
            f" {thickness_um:.0f} um thick in the others."
        )


def _extent_um(sheet: CoarseSheet, columns: Columns) -> float:
    return float(np.nanmedian((sheet.high - sheet.low) * columns.pitch[2]))
