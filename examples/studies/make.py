"""Make the specimens of a study of the paper, run it, and print what it says, with its interval.

``python examples/studies/make.py [STUDY ...] [--size small|full] [--out FOLDER]``

Studies are fig-06, fig-07, fig-09, fig-11, flattening and no-holes.

Your own data: copy a ``.toml``, change its paths, ``planish study copy.toml --out copy``, and then
``python examples/studies/make.py fig-07 --of copy``. ``large`` is a sheet of 20 x 15 mm without
voxels.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import matplotlib as mpl  # noqa: E402

mpl.use("agg")

import large  # noqa: E402
import specimens  # noqa: E402
import statements  # noqa: E402

from planish.cli import main as planish  # noqa: E402

DEFAULT = ("fig-06", "fig-07", "fig-09", "fig-11", "flattening", "no-holes")
"""A study that has no specimens of its own, and the one whose series it reads."""


def main(given: list[str] | None = None) -> int:
    """Do the studies that are named, all where none is; 1 where one said nothing."""
    asked = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    asked.add_argument(
        "studies", nargs="*", choices=(*DEFAULT, "large", []), help="All but large where not given."
    )
    asked.add_argument(
        "--size", choices=("small", "full"), default="small", help="Of the specimens."
    )
    asked.add_argument(
        "--out",
        type=Path,
        default=Path("studies"),
        help="Folder for specimens, series and figures.",
    )
    asked.add_argument(
        "--of", type=Path, help="Series of your own that 'planish study' made; of one study."
    )
    options = asked.parse_args(given)
    studies = options.studies or DEFAULT
    if options.of is not None and len(studies) != 1:
        asked.error("--of needs one study")
    options.out.mkdir(parents=True, exist_ok=True)
    failed = False
    for study in studies:
        began = cpu_s()
        if study == "large":
            statement = large.said(options.size, options.out / "large.png")
        else:
            folder = options.of or series_of(study, options.size, options.out)
            if not (folder / "results.json").is_file():
                failed = True
                continue
            statement = statements.statement(study, folder, options.out / f"{study}.png")
        print(f"\n{study} ({cpu_s() - began:.0f} s of CPU time): {statement}", flush=True)
    return int(failed)


def series_of(study: str, size: specimens.Size, out: Path) -> Path:
    """Folder of the series of a study, after its specimens are made and linked.

    What is done is kept.
    """
    specimens.make(study, size, out / "specimens" / study)
    copy = out / f"{study}.toml"
    copy.write_text(
        shortened((HERE / f"{study}.toml").read_text(encoding="utf-8"), out), encoding="utf-8"
    )
    with contextlib.suppress(SystemExit):  # what was refused is named; the rest is there
        planish(["study", str(copy), "--out", str(out / study)])
    return out / study


def cpu_s() -> float:
    """CPU time of this process and of those that it waited for."""
    return sum(os.times()[:4])


def shortened(text: str, home: Path) -> str:
    """Return a study file without the specimens that were not made.

    At the small size there are fewer of some.
    """
    head, *blocks = text.split("\n[[specimens]]\n")
    files = [
        line.split('"')[1].partition("=")[2] or line.split('"')[1]
        for b in blocks
        for line in b.splitlines()
        if line.startswith(("volume", "layers"))
    ]
    made = [block for block, file in zip(blocks, files, strict=True) if (home / file).exists()]
    return "\n[[specimens]]\n".join([head, *made])


if __name__ == "__main__":
    sys.exit(main())
