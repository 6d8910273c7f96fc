"""Quantities: numbers, with a unit or without, as a user writes them. Loads neither JAX nor NumPy.

A number without a unit is in the option's own unit. `34ms`, `0 -90 90 deg` and `300 -300 500 mm` say another.
"""

import math
import re

_NUMBER = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf(?:inity)?\b|nan\b)", re.IGNORECASE)
_FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180},
    "1/s": {"1/s": 1.0, "/s": 1.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
}
SAMPLES = "samples"


def number(text: str) -> float | None:
    """The number that a text is, in ASCII digits with a decimal point; None for anything else, such as 1_0 or 0,25."""
    if "_" in text or not text.isascii():  # which Python takes
        return None
    try:
        return float(text)
    except ValueError:
        return None


def hint(text: str) -> str:
    """Why a text is no number, where that can be told, to stand behind it; else nothing."""
    plain = text.replace(",", ".").replace("_", "")
    return f": write {plain}" if plain != text and number(plain) is not None else ""


def units(unit: str) -> dict:
    """{spelling: (factor, unit)} of what may stand behind a number whose own unit is that of an option.

    "q" is rad or m, "x" the metres of a point, "samples" are also a time, which the sampling time makes samples.
    """
    if unit == SAMPLES:
        return units("s") | {word: (1.0, SAMPLES) for word in ("sample", SAMPLES)}
    found = {}
    for part in unit.split(", "):
        base, slash, _ = (part, "", "") if part in _FACTORS else part.partition("/")
        for one in {"q": ("m", "rad"), "x": ("m",)}.get(base, (base,)):
            per = "/s" * bool(slash)
            found |= {f"{text}{per}": (factor, f"{one}{per}") for text, factor in _FACTORS.get(one, {}).items()}
    return found | ({"Hz": (2 * math.pi, unit)} if unit == "rad/s" else {})


class Quantities(list):
    """Numbers in an option's own unit; `written` has the unit that each was given, or None."""

    def __init__(self, numbers, written):
        super().__init__(numbers)
        self.written = tuple(written)


def read(text: str, unit: str, Ts: float | None = None, *, marked=False) -> Quantities:
    """The numbers of a text, such as "0.25", "34ms" or "0 -90 90 deg": a unit that stands apart is that of all numbers
    before it that have none.

    Args:
      unit: the option's own, as for `units`; "1" where it has none.
      Ts: the sampling time [s], by which times become samples.
      marked: whether there must be a unit.
    Raises: ValueError, in words that follow "but", for what are no such numbers.
    """
    known, values = units(unit), []
    written: list[str | None] = []
    for word in text.split():
        found = None if word in known else _NUMBER.match(word)
        mark = word[found.end() :] if found else word
        if mark and mark not in known:
            usual = f" (units: {', '.join(w for w in known if w.isascii())})" if known and (found or values) else ""
            raise ValueError(f"is {text!r}{hint(text) or usual}")
        if found:
            values.append(float(found[0]))
            written.append(mark or None)
        elif None in written:
            written = [mark if w is None else w for w in written]
        else:
            raise ValueError(f"is {text!r}, with a unit and no number before it")
    if not values or (marked and not any(written)):
        raise ValueError(f"is {text!r}")
    if unit != "x" and any(written) and any(w is None and v for v, w in zip(values, written, strict=True)):
        raise ValueError(f"is {text!r}: write a unit behind each number, or once at the end, apart")
    for k, mark in enumerate(written):
        factor, own = known[mark] if mark else (1.0, None)
        values[k] *= factor
        if own == "s" and unit == SAMPLES:
            if not Ts or not Ts > 0:
                raise ValueError(f"is {text}, a time, and no sampling time is given")
            values[k] = round(values[k] / Ts, 9)  # 34 ms of 2 ms are 17 samples
    return Quantities(values, [known[w][1] if w else None for w in written])


def read_each(values, unit: str, Ts: float | None = None, *, marked=True) -> Quantities:
    """The numbers of a list of texts, each with its unit, as for `read`, and of numbers in the option's own unit."""
    each = [read(v, unit, Ts, marked=marked) if isinstance(v, str) else Quantities([v], [None]) for v in values]
    return Quantities([v for one in each for v in one], [w for one in each for w in one.written])


# --- in words -----------------------------------------------------------------------------------------


def aloud(value: float, unit: str) -> str:
    """A length or an angle as "0.5 mm" or "12 nrad"; what is below a nanometre, or has several units, as it is."""
    value = float(f"{value:.3g}")  # 0.9996 m is no 1e+03 mm
    if value and (unit[:1] in ("", "1") or "," in unit):  # a prefix belongs to one unit
        return f"{value:.3g} {unit}".removesuffix(" 1").strip()
    for prefix, scale in (("", 1.0), ("m", 1e3), ("µ", 1e6), ("n", 1e9)):
        if abs(value) * scale >= 1:
            return f"{value * scale:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}" if value else "zero"


def plainly(value: float, digits=3) -> str:
    """A number as "1.67" or "1,670": up to a million without a power of ten."""
    said = f"{value:.{digits}g}"
    return f"{float(said):,.0f}" if 1000 <= float(said) < 1e6 else said


def in_samples(samples: float, Ts: float) -> str:
    """A time in samples as "8 samples (80 ms)"."""
    count = f"{samples:.4g}"
    return f"{count} sample{'s' * (count != '1')} ({1e3 * samples * Ts:.4g} ms)"
