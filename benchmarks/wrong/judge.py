"""What a run states against what is true, figure by figure, and which of its checks speak of a
figure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from benchmarks.wrong.case import traced
from benchmarks.wrong.truth import NAMES
from planish.analyze import correlate
from planish.core.checks import CORRELATION, POSITION, PROPERTIES
from planish.core.facts import is_known
from planish.core.frame import Frame
from planish.core.grid import pitch

LEAST_UM, TIMES = 1.0, 2.0
LEAST_R = 0.15
_RIM_UM = 15.0  # rough, burnt
_KEPT = 0.99
_MOST = 25_000  # places that are traced


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One stated figure: its error and what was stated of it, in um or as r."""

    name: str
    error: float
    stated: float

    @property
    def wrong(self):
        """Wrong by more than twice the stated error and more than 1 um."""
        least = LEAST_R if self.name == "correlation" else LEAST_UM
        return not self.error <= max(TIMES * self.stated, least)


def covers(named, figure):
    """Whether a check that names some figures speaks of one, as the run itself marks figures."""
    name = figure.split()[0]
    about = {name, *((PROPERTIES,) if name in NAMES else ())}
    if name == CORRELATION:  # made of a map and its place
        about |= {POSITION, PROPERTIES, *NAMES[:1]}
    return not about.isdisjoint(named)


def figures(case, run):
    """Every figure of the run with its error."""
    found = _thicknesses(case, run)
    if "linked" in run.groups and "position" not in case.by_nature:
        found += _position(case, run)
    found += [Figure(name=name, error=np.inf, stated=0.0) for name in case.by_nature]
    if "correlation" not in case.by_nature:
        found += _correlation(case, run)
    return found


def _material(case, places_um, run):
    """True (u, v, s) of places (n, 3), x, y, z in um of the file as the run read it."""
    volume = run.study.layers[0].volume
    if case.files is not None:
        return case.right.material(case.files.to_physical(places_um, run.groups.get("sections")))
    voxels = traced(case.back, places_um[:, ::-1] / np.array(volume.voxel_um))
    return case.right.material(np.ascontiguousarray(voxels[:, ::-1] * case.right.voxel_um))


def _some(mask):
    """Rows and columns of the true ones, or of some of them where they are too many to be
    traced."""
    rows, cols = np.nonzero(mask)
    step = max(1, rows.size // _MOST)
    return rows[::step], cols[::step]


def _thicknesses(case, run):
    surfaces = run.groups["surfaces"]
    facts = run.results.layers[0].sheet
    frame = Frame.of(surfaces)
    rows, cols = _some(surfaces["status"].values == 0)
    along = {
        frame.rows: surfaces["y"].values[rows],
        frame.cols: surfaces["x"].values[cols],
        frame.through: surfaces["centre"].values[rows, cols].astype(np.float64),
    }
    material = _material(case, np.stack([along[a] for a in "xyz"], axis=-1), run)
    # In a hole there is no true thickness, whatever is left there.
    away = [np.hypot(material[:, 0] - u, material[:, 1] - v) for u, v in case.right.holes]
    sheet = (
        np.min(away, axis=0) > case.right.radius_um + _RIM_UM
        if away
        else np.ones(rows.size, dtype=bool)
    )
    rows, cols, material = rows[sheet], cols[sheet], material[sheet]
    found = []
    for name in NAMES:
        if name not in surfaces or facts is None or name not in facts.properties:
            continue
        off = surfaces[name].values[rows, cols] - case.right.thickness(
            name, material[:, 0], material[:, 1]
        )
        off = off[np.isfinite(off)]
        if not off.size:
            continue
        own = facts.properties[name]
        single = own.standard_error or 0.5
        if f"{name}_se" in surfaces:
            errors = surfaces[f"{name}_se"].values[rows, cols]
            single = _rms(errors) if np.isfinite(errors).any() else single
        mean = own.mean_standard_error or 0.0
        found.append(Figure(name=name, error=abs(float(off.mean())), stated=mean))
        most = np.quantile(np.abs(off), _KEPT)  # a few columns at an edge do not make a map wrong
        found.append(
            Figure(name=f"{name} map", error=_rms(off[np.abs(off) <= most]), stated=single)
        )
    return found


def _pixels(case, run):
    """Rows and columns of some valid pixels, and the true (u, v) that they show."""
    rows, cols = _some(run.linked["valid"].values.astype(bool))
    shown = case.shown or case.right
    at = traced(case.image_back, np.stack([rows, cols], axis=-1).astype(np.float64))
    inside = np.all((at >= 0) & (at <= np.array(shown.uv.shape[:2]) - 1), axis=1)
    u, v = (ndimage.map_coordinates(shown.uv[..., k], at[inside].T, order=1) for k in (0, 1))
    return rows[inside], cols[inside], np.stack([u, v], axis=-1)


def _position(case, run):
    linked = run.linked
    rows, cols, uv = _pixels(case, run)
    if not rows.size:
        return []
    places = np.stack([linked[f"volume_{a}"].values[rows, cols] for a in "xyz"], axis=-1).astype(
        np.float64
    )
    away = np.linalg.norm(_material(case, places, run)[:, :2] - uv, axis=1)
    stated = linked["expected_error"].values[rows, cols].astype(np.float64)
    return [Figure(name="position", error=_rms(away), stated=_rms(stated))]


def _rms(values):
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.inf


def _correlation(case, run):
    """r of the headline, coating of the side that the image truly shows, against r of the true
    map."""
    headline = run.results.layers[0].headline
    rows = [
        row
        for row in run.results.correlations
        if row.a_map == headline and row.n and is_known(row.r)
    ]
    if not rows:
        return []
    row = max(rows, key=lambda k: k.point_um)
    name = f"coating_{case.side}" if headline.startswith("coating") else headline
    if name not in NAMES:
        return []
    linked = run.linked
    valid = linked["valid"].values.astype(bool)
    shown = case.shown or case.right
    at = traced(case.image_back, np.argwhere(valid).astype(np.float64))
    near = np.clip(np.rint(at).astype(int), 0, np.array(shown.uv.shape[:2]) - 1)
    uv = shown.uv[near[:, 0], near[:, 1]]
    true = np.full(valid.shape, np.nan)
    true[valid] = shown.thickness(name, uv[:, 0], uv[:, 1])
    image = np.where(valid, linked["image"].values.astype(np.float64), np.nan)
    best = correlate(true, image, pixel_um=pitch(linked), point_um=row.point_um).r
    if not np.isfinite(best):
        return []
    return [Figure(name="correlation", error=abs(float(row.r or 0.0) - float(best)), stated=0.05)]
