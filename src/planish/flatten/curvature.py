"""Give the Gaussian curvature of the warped sheet, and whether paper can carry it.

Paper bends freely in one direction only.
"""

import numpy as np
from pydantic import Field
from scipy import ndimage

from planish.core.facts import DescribedModel, Value
from planish.core.grid import corners_of
from planish.core.typing import Floats
from planish.flatten.distortion import edge_lengths, node_blocks

_HALVES = ((0, 1, 2), (0, 2, 3))  # corners of the triangles of a cell
_LIMIT = 0.005  # in-plane strain beyond which paper cockles or yields


class CurvatureVerdict(DescribedModel):
    """Whether the surface can be flat at all."""

    patch_um: float
    """Half the side of the patch over which the curvature is averaged."""
    limit: float
    """Strain that paper carries."""
    share: Value
    """Share of the surface on which a patch needs more strain than that to be flat."""
    largest: Value
    """Largest strain that a patch needs."""
    verdict: str
    """The same in a sentence."""


class CurvatureCheck(CurvatureVerdict):
    """The strain by which a surface differs from one paper can have, at each node (rows, cols)."""

    curvature: Floats = Field(exclude=True)
    """Gaussian curvature averaged over a patch about each node, 1/um2; NaN where less than half of
    the patch is known.
    """
    strain: Floats = Field(exclude=True)
    """In-plane strain by which a patch of that curvature has to be stretched and squeezed to be
    flat, abs(curvature) patch_um^2 / 16.
    """


def curvature_check(points: Floats, *, patch_um: float = 1000.0) -> CurvatureCheck:
    """Compare the strain that flattening asks of patches of the sheet with what paper carries.

    Parameters
    ----------
    points : (rows, cols, 3); nodes in space, um; NaN where there is no sheet
    patch_um : float
        Half the side of a patch. A millimetre or more: below that, paper may have curvature from
        forming.

    Returns
    -------
    CurvatureCheck

    Notes
    -----
    A square patch of half-side a and curvature K that is made flat keeps strains of about K a^2 /
    16. K is the integral of curvature over the patch divided by its area. By the theorem of Gauss
    and Bonnet the integral over the surroundings of a node is what its triangles' angles lack of a
    full turn, and it depends on the patch's rim alone: roughness inside it cancels, where the mean
    of a curvature by finite differences would take up its square. The patch is a Gaussian with the
    second moment of the square; it fades towards outline and holes, so that its rim is soft.

    Slices shifted along the sheet's thickness imitate Gaussian curvature only where the sheet is
    bent within the slices too; a shift that grows evenly shears the stack, leaves a cylinder a
    cylinder and is not found here.
    """
    angle_deficit, area = _deficit_and_area(points)
    inside = np.isfinite(angle_deficit)
    curvature = np.full(inside.shape, np.nan)
    if inside.any():
        pitch = [_median_pitch(points, axis) for axis in (0, 1)]
        # Weights rise smoothly from 0 beside the nodes without a full turn to 1 a third of the
        # half-side from them.
        padded_um = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=pitch)
        from_rim = padded_um[1:-1, 1:-1] / (patch_um * (1 / 3))
        ramp = np.minimum(from_rim, 1.0)
        weight = ramp * ramp * (3 - 2 * ramp)
        sigma_px = [patch_um / np.sqrt(3) / p for p in pitch]

        def over_patch(values: Floats) -> Floats:
            weighted = np.where(inside, weight * values, 0.0)
            return ndimage.gaussian_filter(weighted, sigma_px, mode="constant", truncate=3.0)

        is_covered = inside & (over_patch(np.ones(inside.shape)) >= 0.5)
        patch_deficit = over_patch(angle_deficit)[is_covered]
        patch_area = over_patch(area)[is_covered]
        curvature[is_covered] = patch_deficit / patch_area
    strain = np.abs(curvature) * patch_um**2 / 16
    has_strain = np.isfinite(strain)
    share_above = largest = np.nan
    if has_strain.any():
        area_above = area[strain > _LIMIT].sum()
        share_above = float(area_above / area[has_strain].sum())
        largest = float(strain[has_strain].max())
    return CurvatureCheck(
        curvature=curvature,
        strain=strain,
        patch_um=patch_um,
        limit=_LIMIT,
        share=share_above,
        largest=largest,
        verdict=_verdict(patch_um, share_above, largest),
    )


def _median_pitch(points: Floats, axis: int) -> float:
    """Median distance of neighbours along an axis; infinite where none has a neighbour."""
    lengths = edge_lengths(points, axis)
    finite = lengths[np.isfinite(lengths)]
    return float(np.median(finite)) if finite.size else np.inf


def _verdict(patch_um: float, share_above: float, largest: float) -> str:
    patch = f"a patch of {2 * patch_um / 1000:.3g} mm"
    strain, limit = (f"{100 * max(k, 1e-4):.2g} %" for k in (largest, _LIMIT))
    if np.isnan(share_above):
        return f"The curvature cannot be judged: the surface is smaller than {patch}."
    if share_above == 0:
        return (
            f"The surface can be a sheet of paper: to be flat, {patch} has to be strained by"
            f" {strain} or less, and paper carries {limit}."
        )
    return (
        f"On {100 * share_above:.3g} % of the surface {patch} would have to be strained by more"
        f" than {limit}, by up to {strain}, to be flat, and paper does not carry that: look for"
        " slices that drift or jitter, and for errors of the segmentation."
    )


def _deficit_and_area(points: Floats) -> tuple[Floats, Floats]:
    """Give the angle deficit to a full turn about each node, and a third of its triangles' area.

    Both (rows, cols); NaN unless the node has four whole cells, cut along their first diagonal,
    about it. ``points`` (rows, cols, 3) in um.
    """
    angles = np.zeros(points.shape[:2])
    area = np.zeros_like(angles)
    for nodes in node_blocks(points):
        # Views: what is added to a corner of all cells is added to its nodes.
        corners = corners_of(points[nodes])
        corner_angles = corners_of(angles[nodes])
        corner_areas = corners_of(area[nodes])
        for half in _HALVES:
            p, q, r = (corners[k] for k in half)
            pq = q - p
            pr = r - p
            normal = np.cross(pq, pr)
            twice_area = np.sqrt(_dot(normal, normal))
            pq_dot_pr = _dot(pq, pr)
            at_p = np.arctan2(twice_area, pq_dot_pr)
            at_q = np.arctan2(twice_area, _dot(pq, pq) - pq_dot_pr)
            at_r = np.pi - at_p - at_q
            for k, angle in zip(half, (at_p, at_q, at_r), strict=True):
                corner_angles[k][:] += angle
                corner_areas[k][:] += twice_area / 6
    angle_deficit = 2 * np.pi - angles
    # Nodes of the outline have no full turn.
    angle_deficit[[0, -1]] = np.nan
    angle_deficit[:, [0, -1]] = np.nan
    area[np.isnan(angle_deficit)] = np.nan
    return angle_deficit, area


def _dot(p: Floats, q: Floats) -> Floats:
    return np.einsum("ijk,ijk->ij", p, q)
