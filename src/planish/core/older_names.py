"""What older results call things, and what the same is called today.

Of results, figures and stores of maps alike; ``docs/words.md`` and the changelog list them.
"""

from __future__ import annotations

import re
from typing import Any

FORMAT = 4
"""Version of what a run writes; planish 0.1.0 wrote none, 0.2.0 wrote 2."""

_KEYS = {
    "ceiling": "attenuation_limit",
    "ceiling_noise": "attenuation_limit_noise",
    "ceiling_both": "attenuation_limit_both",
    "second_opinion": "conley_interval",
    "silence": "reason",
    "twice": "agreement",
}

_VALUES = {"relative grey": "grey value, uncalibrated"}  # values that are words

_TITLES = {"Relative grey": "Grey value, uncalibrated"}  # how titles begin

_TITLE = re.compile("|".join(_TITLES) or "$^")


def todays_names(stored: Any) -> Any:
    """Give JSON, or the attributes of maps, of an older format the names of today."""
    if isinstance(stored, dict):
        return {_KEYS.get(key, key): todays_names(part) for key, part in stored.items()}  # type: ignore[reportUnknownVariableType]
    if isinstance(stored, list):
        return [todays_names(part) for part in stored]  # type: ignore[reportUnknownVariableType]
    if not isinstance(stored, str):
        return stored
    return _VALUES.get(stored) or _TITLE.sub(lambda found: _TITLES[found[0]], stored, count=1)
