"""Runs of made-up figures in folders, for the tests of series: no volume, no link."""

import copy
from functools import cache

from planish.results import Results
from planish.series_results import Member
from report.runs import a_run


@cache
def _results():
    run = a_run()["results"]
    run["layers"][0]["sheet"]["numbers"]["thin"] = {
        "top": {
            "thinner_than_um": [0.0, 2.0, 5.0],
            "share": [0.0, 0.01, 0.02],
            "support_um": 3.0,
            "warning": None,
        }
    }
    return run


def results_of(
    *,
    mean=20.0,
    sd=2.0,
    thin=0.02,
    r=0.6,
    n_eff=70.0,
    trust="ok",
    volume="",
    state="pass",
    point_um=100.0,
    linked=True,
):
    """Return results of a run whose leading map is the coating of the top side."""
    run = copy.deepcopy(_results())
    layer = run["layers"][0]
    layer["source"]["sha256"] = volume or f"{mean!r}{sd!r}{r!r}"
    coating = layer["sheet"]["properties"]["coating_top"]
    coating |= {"mean": mean, "sd": sd, "trust": trust}
    if trust == "withheld":
        coating |= dict.fromkeys(("mean", "sd", "p5", "median", "p95"))
        layer["sheet"]["numbers"] = None
    else:
        layer["sheet"]["numbers"]["thin"]["top"]["share"][2] = thin
    for row in run["correlations"]:
        if row["a_map"] == "coating_top" and row["point_um"] == 100.0:
            row |= {
                "r": r,
                "n_eff": n_eff,
                "n_eff_interval": n_eff,
                "trust": trust,
                "point_um": point_um,
            }
            if trust == "withheld":
                row |= {"r": None, "interval": None, "n_eff": None, "n_eff_interval": None}
    run["checks"][0] |= {"state": state, "figures": ["properties", "correlation"]}
    if not linked:
        layer["registration"] = None
        run |= {"layers": [layer], "correlations": [], "comparison": [], "linked": None}
    return run


def two_volumes(*, bias=0.5):
    """Return results of two volumes of one sheet."""
    run = results_of()
    first, second = run["layers"][0], copy.deepcopy(run["layers"][0])
    first["name"], second["name"], second["registration"] = "ct", "sections", None
    first["registration"]["to"] = "sections"
    row = next(
        r for r in run["correlations"] if r["point_um"] == 100.0 and r["a_map"] == "coating_top"
    )
    row |= {
        "a": "ct",
        "b": "sections",
        "b_map": "coating_top",
        "same_quantity": True,
        "units": "um",
        "slope": 0.8,
        "slope_x_on_y": 0.9,
        "difference_mean": bias,
        "difference_sd": 1.0,
        "limits": [bias - 1.96, bias + 1.96],
    }
    agreement = {
        "point_um": 100.0,
        "bias": bias,
        "bias_interval": [bias - 0.1, bias + 0.1],
        "limits": [bias - 2, bias + 2],
        "limit_intervals": [[bias - 2.3, bias - 1.7], [bias + 1.7, bias + 2.3]],
        "resolution_um": 40.0,
        "sentence": "Both show the same down to waves of 40 um.",
        "units": "um",
    }
    evidence = {
        "a": "ct",
        "a_map": "coating_top",
        "b": "sections",
        "b_map": "coating_top",
        "declared": False,
    }
    return run | {
        "layers": [first, second],
        "correlations": [row],
        "comparison": [],
        "evidence": [evidence | {"agreement": agreement}],
    }


def put(folder, results):
    """Write a run of these results, whose maps are empty."""
    (folder / "maps.zarr").mkdir(parents=True)
    (folder / "run.toml").write_text("", encoding="utf-8")
    text = Results.model_validate(results).to_json()
    (folder / "results.json").write_text(text, encoding="utf-8", newline="\n")
    return folder


def series(home, *runs):
    """Write runs and return them as members, named run-1 and so on."""
    return [
        Member(name=put(home / f"run-{k}", results).name, factors=factors, run=f"run-{k}")
        for k, (factors, results) in enumerate(runs, 1)
    ]
