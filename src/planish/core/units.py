"""Units of length, by the words that files have for them."""

PREFIXES = (
    ("p", "pico", 1e-6),
    ("n", "nano", 1e-3),
    ("u", "micro", 1.0),
    ("m", "milli", 1e3),
    ("c", "centi", 1e4),
)
# Length of each unit in um. Keys are case-folded, which also makes the micro sign a Greek mu.
UNITS_UM = {
    "å": 1e-4,
    "angstrom": 1e-4,
    "ångström": 1e-4,
    "μm": 1.0,
    "micron": 1.0,
    "microns": 1.0,
    "in": 25400.0,
    "inch": 25400.0,
    "inches": 25400.0,
} | {
    f"{prefix}{metre}": um
    for symbol, name, um in (*PREFIXES, ("", "", 1e6))
    for prefix, metre in (
        (symbol, "m"),
        (name, "meter"),
        (name, "metre"),
        (name, "meters"),
        (name, "metres"),
    )
}


def unit_um(unit: str) -> float | None:
    r"""Length of a unit in um, or None if the word is no unit of length.

    >>> unit_um("mm"), unit_um("µm"), unit_um("pixel")
    (1000.0, 1.0, None)
    """
    word = unit.strip().strip('"').casefold().replace("\\u00b5", "μ").replace("\\u03bc", "μ")
    # Files of electron microscopes write [n_m] for nanometres.
    return UNITS_UM.get(word.strip("[]").replace("_", ""))
