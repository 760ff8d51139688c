"""What does planish say when something is wrong?

Kinds of wrong input, drawn strengths, some seeds of each.

``python -m benchmarks wrong [--kinds NAME ...] [--seeds 5] [--out FOLDER]``

A stated figure that is wrong by more than twice its stated error and more than 1 um is silent where
the run ends without refusing and no check speaks of that figure. Each kind and seed is one JSON
line in FOLDER/wrong.jsonl: what is there is not done again. Two of five seeds are specimens of a
second maker that shares no code with planish.
"""

from __future__ import annotations

from benchmarks.wrong.table import main

__all__ = ["main"]
