"""Small files in exactly the layouts that other programs write, made by hand, and the marks that
they hold."""

import json

import numpy as np

# What every file below says, in um: moving on a map of 2.5 um pixels, fixed in an image of 4 um
# pixels.
MOVING = np.array([[250.0, 500.0], [1250.0, 312.5], [800.0, 1500.0], [2000.0, 1800.0]])
FIXED = np.array([[402.0, 806.0], [2006.0, 510.0], [1282.0, 2410.0], [3208.0, 2886.0]])
MOVING_PIXEL, FIXED_PIXEL = 2.5, 4.0
LABELS = ["Pt-0", "Pt-1", "Pt-2", "Pt-3"]


def bigwarp_2d(moving=MOVING, fixed=FIXED):
    rows = zip(LABELS, moving.tolist(), fixed.tolist(), strict=True)
    return "".join(f'"{n}","true","{a[0]}","{a[1]}","{b[0]}","{b[1]}"\n' for n, a, b in rows)


def bigwarp_3d(z=(40.0, 41.0, 42.5, 39.0), target_z=0.0):
    rows = zip(LABELS, MOVING.tolist(), z, FIXED.tolist(), strict=True)
    return "".join(
        f'"{n}","true","{a[0]}","{a[1]}","{c}","{b[0]}","{b[1]}","{target_z}"\n'
        for n, a, c, b in rows
    )


PAIRS = "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\n" + "".join(
    f"{n},{a[0]},{a[1]},{b[0]},{b[1]}\n"
    for n, a, b in zip(LABELS, MOVING.tolist(), FIXED.tolist(), strict=True)
)


def bigwarp_json():
    inner = {
        "type": "BigWarpLandmarks",
        "numDimensions": 2,
        "movingPoints": MOVING.tolist(),
        "fixedPoints": FIXED.tolist(),
        "active": [True] * 4,
        "names": LABELS,
    }
    return json.dumps({"landmarks": inner})


def elastix(points, word="point"):
    return (
        f"{word}\n{len(points)}\n"
        + "\n".join(" ".join(str(v) for v in row) for row in points.tolist())
        + "\n"
    )


def slicer_list(points_mm, name, system="LPS", units="mm", labels=LABELS):
    controls = [
        {
            "id": str(k + 1),
            "label": label,
            "description": "",
            "associatedNodeID": "vtkMRMLScalarVolumeNode1",
            "position": [float(v) for v in p] + [0.0] * (3 - len(p)),
            "orientation": [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0],
            "selected": True,
            "locked": False,
            "visibility": True,
            "positionStatus": "defined",
        }
        for k, (label, p) in enumerate(zip(labels, points_mm, strict=True))
    ]
    return {
        "type": "Fiducial",
        "name": name,
        "coordinateSystem": system,
        "coordinateUnits": units,
        "locked": False,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(controls),
        "controlPoints": controls,
        "measurements": [],
        "display": {"visibility": True, "opacity": 1.0},
    }


def slicer(*lists):
    schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    return json.dumps(
        {"@schema": schema + "markups-schema-v1.0.3.json#", "markups": list(lists)}, indent=4
    )


def imagej(points):
    rows = [f"{k},0,{112 + k},112,112,{x},{y},1" for k, (x, y) in enumerate(points.tolist(), 1)]
    return " ,Area,Mean,Min,Max,X,Y,Slice\n" + "\n".join(rows) + "\n"


def native():
    return """{
 "format": "planish-marks",
 "version": 1,
 "units": "um",
 "axes": {"x": "right", "y": "down"},
 "layers": [
  {"name": "moving", "title": "map of coating", "pixel_um": {"x": 2.5, "y": 2.5},
   "origin_um": {"x": -10, "y": 4}, "size_px": {"x": 1200, "y": 1000},
   "side": "top", "machine_direction_deg": 90.0},
  {"name": "fixed", "pixel_um": {"x": 4.0, "y": 4.0}}
 ],
 "marks": [
  {"label": "A", "used": true, "at": {
    "moving": {"x": 250.0, "y": 500.0, "covariance_um2": [[4.0, 0.5], [0.5, 2.0]],
               "diameter_um": 151.5, "axis_ratio": 1.02, "arc_coverage": 0.98,
               "source": "detected"},
    "fixed": {"x": 402.0, "y": 806.0, "source": "clicked"}}},
  {"label": "B", "used": false, "at": {
    "moving": {"x": 1250.0, "y": 312.5, "source": "detected"},
    "fixed": {"x": 2006.0, "y": 510.0, "source": "predicted"}}, "residual_um": 3.25},
  {"label": "C, ü", "at": {"moving": {"x": 800.0, "y": 1500.0, "source": "imported"}}}
 ]
}
"""
