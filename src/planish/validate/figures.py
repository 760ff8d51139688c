"""Every figure of the error ledger: its name, its stage, its unit, and a sentence that says what it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One number of the ledger.

    Attributes
    ----------
    name : str
        Key in files and in a scenario's limits.
    stage : str
        Key of :data:`STAGES`.
    unit : str
        ``um``, ``%``, ``deg``, ``pitch``, ``s``, or ``1`` for a plain number.
    title : str
        For a table, under the title of its stage.
    sentence : str
        What is compared with what.
    small : bool
        Whether smaller is better; False for a recall, and for what is only told.
    """

    name: str
    stage: str
    unit: str
    title: str
    sentence: str
    small: bool = True


# In the order in which the line passes them: an error that arises in one is carried into all that follow.
STAGES = {
    "mesh": "Spring mesh alone",
    "sections": "Poses of the sections",
    "surfaces": "Surfaces",
    "centre": "Centre surface",
    "thickness": "Thickness",
    "flattening": "Flattening",
    "holes": "Holes",
    "registration": "Registration",
    "resampling": "Resampling",
    "statistic": "Statistic",
    "pair": "Two instruments",
}

FACES = {
    "top": "top face",
    "interface_top": "interface under the top coating",
    "interface_bottom": "interface over the bottom coating",
    "bottom": "bottom face",
}
THICKNESSES = {"coating_top": "top coating", "base_thickness": "base paper", "thickness": "sheet"}

# The figure that speaks for a stage; the next one where a run does not have it (a paper without coating).
KEYS: dict[str, tuple[str, ...]] = {
    "sections": ("sections_x_rms",),
    "surfaces": ("surfaces_rmse",),
    "centre": ("centre_rms",),
    "thickness": ("column_coating_top_rmse", "column_thickness_rmse"),
    "flattening": ("node_rms",),
    "holes": ("fle_pair",),
    "registration": ("tre_rms",),
    "resampling": ("resampling_rmse",),
    "statistic": ("r_difference_pixel",),
}


def _three(stem: str, stage: str, what: str, sentence: str) -> list[Figure]:
    kinds = {
        "bias": ("mean error", "mean of"),
        "rmse": ("rms error", "root mean square of"),
        "p95": ("95 % error", "95th percentile of the absolute value of"),
    }
    return [
        Figure(name=f"{stem}_{key}", stage=stage, unit="um", title=f"{what}, {title}", sentence=f"{word} {sentence}")
        for key, (title, word) in kinds.items()
    ]


def _all() -> list[Figure]:
    found: list[Figure] = []

    def add(name: str, stage: str, unit: str, title: str, sentence: str, *, small: bool = True) -> None:
        found.append(Figure(name=name, stage=stage, unit=unit, title=title, sentence=sentence, small=small))

    def three(stem: str, stage: str, what: str, sentence: str) -> None:
        found.extend(_three(stem, stage, what, sentence))

    _mesh(add)
    for axis, what in (("x", "along the section"), ("z", "through the sheet")):
        sentence = f"rms distance {what} that aligning leaves between a section and its true place"
        add(f"sections_{axis}_rms", "sections", "um", f"pose {what}, rms", sentence)
        sentence = f"what varies of that distance {what} within 50 sections"
        add(f"sections_{axis}_jitter", "sections", "um", f"jitter {what}, rms", sentence)
    sentence = "rms distance across the sections between a section's true position and the one it was given"
    add("sections_place_rms", "sections", "um", "position, rms", sentence)
    for face, what in FACES.items():
        sentence = f"found minus true height of the {what}, along the true normal, at the measured columns"
        three(face, "surfaces", what, sentence)
    add("surfaces_rmse", "surfaces", "um", "all faces, rms error", "root mean square over all faces of the sheet")
    sentence = "share of the columns with a sheet, away from holes and their rims, in which all faces were found"
    add("found_share", "surfaces", "%", "columns found", sentence, small=False)
    sentence = (
        "the same, and the normals of the centre surface meet all of them: those that lean out of the volume do not"
    )
    add("measured_share", "surfaces", "%", "columns measured", sentence, small=False)
    sentence = "mean height of the found centre surface over the true one, along the true normal"
    add("centre_mean", "centre", "um", "height, mean", sentence)
    add("centre_rms", "centre", "um", "height, rms about the mean", "what varies of that height")
    sentence = "of the angle between the normal of the found centre surface and the true one"
    add("angle_rms", "centre", "deg", "angle of the normals, rms", f"root mean square {sentence}")
    add("angle_p95", "centre", "deg", "angle of the normals, 95 %", f"95th percentile {sentence}")
    for name, what in THICKNESSES.items():
        sentence = f"measured minus true thickness of the {what} at the material that the column shows"
        three(f"column_{name}", "thickness", f"{what} at the column", sentence)
    for name, what in THICKNESSES.items():
        sentence = f"linked minus true thickness of the {what} at the material that the image's pixel shows"
        three(f"pixel_{name}", "thickness", f"{what} at the pixel", sentence)
    sentence = "overlap of the found and the true region of thin top coating: twice the common area over the sum"
    add("thin_dice", "thickness", "1", "thin coating, overlap (Dice)", sentence, small=False)
    sentence = "median distance between the outlines of the found and the true region of thin top coating"
    add("thin_lag", "thickness", "um", "thin coating, lag of the outline", sentence)
    sentence = "distance of a column's flat place from its true one, after the best turn and shift"
    add("node_rms", "flattening", "um", "place of a column, rms", f"root mean square {sentence}")
    add("node_p95", "flattening", "um", "place of a column, 95 %", f"95th percentile of the {sentence}")
    add("flat_scale", "flattening", "%", "scale", "scale of the flat map against the true sheet, minus 1")
    sentence = "rms relative error of lengths of some 100 um in the flat map"
    add("strain_rms", "flattening", "%", "strain, rms", sentence)
    for side, what in (("image", "image"), ("volume", "flat map")):
        sentence = f"share of the holes that lie wholly in the {what} and were found there"
        add(f"recall_{side}", "holes", "1", f"found in the {what}", sentence, small=False)
        sentence = f"holes found in the {what} where there is none"
        add(f"false_{side}", "holes", "1", f"false in the {what}", sentence)
        sentence = f"rms distance in the sheet of a hole found in the {what} from its true centre"
        add(f"fle_{side}", "holes", "um", f"localisation in the {what}, rms", sentence)
    add("fle_pair", "holes", "um", "localisation of a pair, rms", "both of them, added as squares")
    sentence = (
        "distance in the sheet between the material that a pixel shows and the material at the place in the volume "
        "that the run gives for it"
    )
    for key, title, word in (
        ("median", "median", "median"),
        ("p95", "95 %", "95th percentile"),
        ("max", "99.9 %", "99.9th percentile"),
        ("rms", "rms", "root mean square"),
    ):
        add(f"tre_{key}", "registration", "um", f"error of a pixel, {title}", f"{word} over the pixels: {sentence}")
    add("fre_rms", "registration", "um", "residual of the marks, rms", "what the fit leaves between the marks")
    sentence = "distance by which the fit to the others misses a mark"
    add("loo_rms", "registration", "um", "leave-one-out, rms", f"root mean square {sentence}")
    sentence = "error of a pixel that the run itself expects from its marks, rms over the same pixels"
    add("predicted_rms", "registration", "um", "expected error, rms", sentence, small=False)
    sentence = "true over expected error: 1 where the run knows how good it is, larger where it is too sure"
    add("predicted_ratio", "registration", "1", "true over expected error", sentence, small=False)
    sentence = "scale of the fitted transformation against that of the true pose, minus 1"
    add("scale_deviation", "registration", "%", "scale", sentence)
    sentence = "95th percentile of the error of a pixel, had the sheet been projected and not flattened (similarity)"
    add("tre_projection_p95", "registration", "um", "without flattening, 95 %", sentence, small=False)
    sentence = "true map brought to the pixels by the run's own resampling, against the truth there"
    add("resampling_rmse", "resampling", "um", "rms error", f"root mean square error of the {sentence}")
    add("resampling_p95", "resampling", "um", "95 % error", f"95th percentile of the error of the {sentence}")
    for key, what in (("pixel", "pixel"), ("point", "larger point")):
        sentence = f"correlation with the image at the {what}"
        add(f"r_{key}", "statistic", "1", f"r at the {what}, measured", f"{sentence}, of the measured map", small=False)
        add(f"r_true_{key}", "statistic", "1", f"r at the {what}, true", f"{sentence}, of the true map", small=False)
        add(f"r_difference_{key}", "statistic", "1", f"r at the {what}, difference", "measured minus true")
    _pair(add)
    return found


def _pair(add: Callable[..., None]) -> None:
    sentence = "distance in the sheet between the materials that the two volumes show at one pixel"
    for key, title, word in (("median", "median", "median"), ("p95", "95 %", "95th percentile"), ("rms", "rms", "rms")):
        add(f"pair_{key}", "pair", "um", f"error of a pixel, {title}", f"{word} over the pixels: {sentence}")
    sentence = "error of a pixel that the run itself expects from its marks, rms over the same pixels"
    add("pair_predicted_rms", "pair", "um", "expected error, rms", sentence, small=False)
    for key, what in (("first", "first"), ("second", "second")):
        sentence = f"mean of measured minus true thickness of the top coating in the {what} volume"
        add(f"pair_coating_{key}_bias", "pair", "um", f"top coating, {what} volume, mean error", sentence)
    sentence = "correlation of the two measured maps of the top coating at the pixel"
    add("pair_r", "pair", "1", "r of the coating at the pixel", sentence, small=False)
    sentence = "correlation of the two measured maps of the top coating at the larger point"
    add("pair_r_point", "pair", "1", "r of the coating at the larger point", sentence, small=False)
    sentence = "standard deviation of the second coating map minus the first, at the pixel"
    add("pair_difference_sd", "pair", "um", "difference of the coatings, sd", sentence)


def _mesh(add: Callable[..., None]) -> None:
    for name in ("width", "height", "aspect"):
        sentence = f"relative error of the {name} of the relaxed mesh of Fig. 5, 32 x 24 nodes"
        add(f"mesh_{name}", "mesh", "%", f"{name}, sustained stop", f"{sentence}; mean speed below 1e-3 for a period")
        add(f"mesh_{name}_fine", "mesh", "%", f"{name}, stop at 1e-4", f"{sentence}; mean speed below 1e-4")
    sentence = "largest of the three errors when the motion is stopped at its first slow moment"
    add("mesh_first", "mesh", "%", "stopped at the first slow moment", sentence, small=False)
    add("mesh_inverted", "mesh", "1", "inverted cells", "cells that are turned over at rest")
    add("mesh_seconds", "mesh", "s", "time", "seconds to the sustained stop", small=False)
    sentence = "largest distance of a node of a cylinder, 128 x 96 nodes, from its place in the unrolled one"
    add("mesh_cylinder", "mesh", "pitch", "cylinder, node error", sentence)
    sentence = "seconds to the sustained stop on that cylinder"
    add("mesh_cylinder_seconds", "mesh", "s", "cylinder, time", sentence, small=False)
    sentence = "1 where the mesh comes to no rest with the time step fed back as Eq. (4) reads"
    add("mesh_feedback_fails", "mesh", "1", "feedback reading fails", sentence, small=False)
    sentence = "1 where forward Euler with the paper's largest time step comes to no rest"
    add("mesh_euler_fails", "mesh", "1", "forward Euler fails", sentence, small=False)
    sentence = "largest distance of a node between the direct minimum of the energy and the state of rest of the motion"
    add("mesh_minimum", "mesh", "pitch", "minimum against motion", sentence)


FIGURES: dict[str, Figure] = {figure.name: figure for figure in _all()}
