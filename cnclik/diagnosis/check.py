"""Check: which limits a log of joint values breaks, and what is wrong with its rows. The tip's path needs JAX."""

from __future__ import annotations

import typing
from collections.abc import Sequence

import numpy as np

from cnclik import errors
from cnclik.diagnosis.recording import columns, spacing
from cnclik.record import ArrayLike, Float, record

if typing.TYPE_CHECKING:
    from cnclik.robot.chain import Chain

ORDERS = {"velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
PUBLISHED: dict[str, dict] = {  # Franka Control Interface documentation, "Robot and interface specifications"
    "panda": {
        "velocity": [2.175] * 4 + [2.61] * 3,
        "acceleration": [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
        "jerk": [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0],
    },
    "fr3": {"velocity": [2.62] * 4 + [5.26, 4.18, 5.26], "acceleration": [10.0] * 7, "jerk": [5000.0] * 7},
}
ROUNDING = 1e-6  # share of a limit: a motion at its limit is written with some ten digits
TURN = 0.1  # [rad] from a whole turn, within which a jump is a wrap: no joint moves a turn in a sample
APART = 4.0  # times the largest step of the three rows on either side: smooth motion at most doubles its step
QUIET = 0.99  # share of the third differences that may be noise: the others may be jumps
WHITE = (-0.75, 0.3)  # autocorrelation of the third differences of white noise at lags 1 and 2: −15/20, 6/20
NEAR = 0.25  # how far that of a hundred rows may be from it; motion of period 2, 3 or 4 has (−1, 1), (−½, −½), (0, −1)


@record
class Finding:
    """The largest value of one kind in a log, or its number of bad rows.

    Attributes:
      what: "velocity", "acceleration", "jerk", "beyond its range", "jump", "wrap by 2π", "half-way between rows",
        "behind its command", or of rows "missing", "repeated", "reversed".
      column: its name, "" of all. value: the largest, or a number of rows, in `unit`. at: its time [s].
      limit: of this column, or None. noise: the largest that noise alone gives, or None.
    """

    what: str
    column: str
    value: float
    unit: str
    at: float
    limit: float | None = None
    noise: float | None = None

    @property
    def share(self) -> float:
        """Value over limit; 0 without a limit."""
        return 0.0 if self.limit is None else self.value / self.limit if self.limit else np.inf * self.value

    @property
    def broken(self) -> bool:
        """Whether a limit is exceeded, by more than noise alone explains."""
        return self.share > 1 + ROUNDING and self.value > (self.noise or 0.0)


@record
class LogCheck:
    """Answer of `check_log`: each `Finding`, the usual sampling time Ts [s], and the number of rows."""

    findings: tuple[Finding, ...]
    Ts: float
    rows: int

    @property
    def broken(self) -> tuple[Finding, ...]:
        """The findings that exceed a limit."""
        return tuple(one for one in self.findings if one.broken)

    def __str__(self):
        table = [("", "column", "largest", "at", "limit", "of limit", "noise alone")]
        for one in self.findings:
            numbers = (
                "" if v is None else f"{v:.4g}" for v in (one.limit, one.share if one.limit else None, one.noise)
            )
            table.append((one.what, one.column, f"{one.value:.4g} {one.unit}", f"{one.at:.4g} s", *numbers))
        width = [max(map(len, column)) for column in zip(*table, strict=True)]
        aligned = ["<", "<", *">>>>>"]
        lines = [
            "  ".join(f"{cell:{side}{wide}}" for cell, side, wide in zip(row, aligned, width, strict=True)).rstrip()
            for row in table
        ]
        said = "No limit is broken." if any(one.limit is not None for one in self.findings) else "No limits are given."
        if self.broken:
            worst = max(self.broken, key=lambda one: one.share)
            said = f"Broken limits: {len(self.broken)}. The worst: {worst.what} of {worst.column} at {worst.at:.4g} s."
        if noisy := sum(one.share > 1 + ROUNDING and not one.broken for one in self.findings):
            said += f" Noise alone explains {noisy} more values above a limit."
        return "\n".join([*lines, said])


def check_log(
    t: Float[ArrayLike, " N"] | None,
    q: Float[ArrayLike, "N ..."],
    *,
    Ts: float | None = None,
    limits: dict[str, ArrayLike] | str | None = None,
    chain: Chain | None = None,
    command: Float[ArrayLike, "N ..."] | None = None,
    resolution: float = 0.0,
    names: Sequence[str] | None = None,
) -> LogCheck:
    """Check which limits a log of joint values breaks, and where; and whether rows are missing, repeated or reversed.

    Velocity, acceleration and jerk are differences of neighbouring rows over powers of Ts, as a robot's controller
    computes them; none of them goes across a gap or a wrap by 2π. What white noise of the size that is seen gives
    stands beside them: below it a value is not taken for a broken limit.

    Args:
      t: (N,) times [s], or None with a Ts. q: (N,) or (N, k) joint values [rad, m], measured or commanded.
      limits: {"velocity": (k,), "acceleration": …, "jerk": …}, each also a number; or "panda" or "fr3", whose maker
        publishes all three.
      chain: whose limits of position and velocity count where no others are given, and whose tips are looked at
        half-way between rows: how far they stray from the straight line if joints are interpolated linearly.
      command: (N, k) commanded joint values, compared with q and checked against the limits, too.
      resolution: of the encoders [rad, m]. names: of the columns of q, and then of those of command.
    Raises: ArgumentError for fewer than four rows, and for what does not fit.
    """
    q = columns("q", q, "check_log")
    k, most = q.shape[1], _limits(limits, chain, q.shape[1])
    names = [f"{w} {i + 1}" for w in ("joint", "command") for i in range(k)] if names is None else list(names)
    if len(q) < 4:
        raise errors.fail("q", "have at least 4 rows", f"has {len(q)}")
    if t is None:
        t = float(errors.number("Ts", Ts, positive=True)) * np.arange(len(q))
    t = np.asarray(errors.array("t", t, (len(q),)), float)
    Ts = spacing(t) if Ts is None else float(errors.number("Ts", Ts, positive=True))
    resolution = float(errors.number("resolution", resolution, at_least=0))
    units = ["rad"] * k if chain is None else list(chain.units)
    found, t, gaps, kept = _rows(t, np.abs(np.diff(q, axis=0)).sum(1), Ts)
    found += _motion(t, q[kept], gaps, Ts, most, names[:k], units, resolution, measured=True)
    if command is not None:
        sent = columns("command", command, "check_log")
        if sent.shape != q.shape:
            raise errors.fail("command", f"have the shape of q, {q.shape}", f"has {sent.shape}")
        found += _motion(t, sent[kept], gaps, Ts, most, names[k:], units, 0.0, measured=False)
        found += _largest("behind its command", np.abs(sent - q)[kept], t, units, names[:k])
    if chain is not None:
        found += _half_way(chain, t, q[kept], gaps)
    return LogCheck(findings=tuple(found), Ts=Ts, rows=len(q))


def _limits(limits, chain, k) -> dict:
    """{quantity: (k,)} of the limits that are given, or else of the chain."""
    if isinstance(limits, str):
        limits = PUBLISHED[errors.one_of("limits", limits, PUBLISHED)]
    limits = {errors.one_of("limits", n, ORDERS): v for n, v in errors.kind("limits", limits or {}, dict).items()}
    if chain is not None:
        if chain.n != k:
            raise errors.fail("q", f"have a column for each of the chain's {chain.n} joints", f"has {k}")
        limits = {"velocity": chain.velocity_limit, "lower": chain.lower, "upper": chain.upper} | limits
    arrays = {n: np.asarray(errors.array(f"limits.{n}", v, (), (k,), finite=False), float) for n, v in limits.items()}
    return {name: np.broadcast_to(values, k) for name, values in arrays.items()}


def _rows(t, moved, Ts):
    """(findings of rows, times of the rows to keep, whether a gap is before each, their indices)."""
    step = np.diff(t)
    two = np.concatenate([[np.inf], t[2:] - t[:-2], [np.inf]])  # a single late stamp is jitter: the next is not late
    late = (step > 1.6 * Ts) & (two[:-1] > 2.6 * Ts) & (two[1:] > 2.6 * Ts)
    missing = np.sum(np.round(step[late] / Ts) - 1)
    same = step == 0
    way = np.convolve(moved, [1.0, 0.0, 0.0, 0.0, 1.0], "same")  # a stale row: steady motion stops, and makes up for it
    same[2:-2] |= (moved[2:-2] == 0) & (np.abs(moved[3:-1] / np.maximum(way[2:-2], 1e-300) - 1) < 0.1)
    back = step < 0
    each = (("missing", missing, late), ("repeated", np.sum(same), same), ("reversed", np.sum(back), back))
    found = [
        Finding(what=what, column="", value=float(count), unit="rows", at=float(t[np.argmax(at) + 1]))
        for what, count, at in each
        if count
    ]
    kept = np.concatenate([[0], np.flatnonzero(step != 0) + 1])
    return found, t[kept], np.concatenate([[False], late | back])[kept], kept


def _motion(t, q, gaps, Ts, most, names, units, resolution, *, measured) -> list:
    """Findings of joint values (N, k); those of commands have no noise."""
    step = np.diff(q, axis=0)
    wraps = (np.abs(np.abs(step) - 2 * np.pi) < TURN) & ~gaps[1:, None]
    found = _largest("wrap by 2π", wraps * wraps.sum(0), t[1:], ["times"] * len(names), names, seldom=True)
    step = step - np.where(wraps, np.sign(step) * 2 * np.pi, 0.0)
    q = q[:1] + np.concatenate([0.0 * q[:1], np.cumsum(step, axis=0)])
    step = np.where(gaps[1:, None], np.nan, step)
    size = np.array([_noise(column) for column in step.T]) * measured
    around = np.nanmax([np.abs(np.roll(step, s, 0)) for s in (-3, -2, -1, 1, 2, 3)], axis=0, initial=0.0)
    beyond = np.abs(step) > APART * around + 6 * size + resolution
    found += _largest("jump", np.where(beyond, np.abs(step), 0.0), t[1:], units, names, seldom=True)
    if "lower" in most:
        over = np.maximum(np.maximum(q - most["upper"], most["lower"] - q), 0.0)
        found += _largest("beyond its range", over, t, units, names, 0.0 * size, seldom=True)
    value = step
    for order, (name, per) in enumerate(ORDERS.items(), 1):
        value = value if order == 1 else np.diff(value, axis=0)
        # The variance of a difference of white noise, what one log in a hundred exceeds, and a step of the encoder.
        spread, count = np.sqrt((2, 6, 20)[order - 1] * 2 * np.log(100 * len(q))), (1, 2, 3)[order - 1]
        noise = (spread * size + count * resolution) / Ts**order
        per_time = [unit + per for unit in units]
        found += _largest(name, np.abs(value) / Ts**order, t[order:], per_time, names, most.get(name), noise)
    return found


def _largest(what, values, t, units, names, limit=None, noise=None, *, seldom=False) -> list:
    """A finding for each column of values (N, k). seldom: leave out columns of zeros."""
    found = []
    for j, name in enumerate(names):
        if np.isnan(values[:, j]).all() or (seldom and not np.nan_to_num(values[:, j]).any()):
            continue
        i = int(np.nanargmax(values[:, j]))
        most = None if limit is None or not np.isfinite(limit[j]) else float(limit[j])
        alone = None if noise is None else float(noise[j])
        value, at = float(values[i, j]), float(t[i])
        found.append(Finding(what=what, column=name, value=value, unit=units[j], at=at, limit=most, noise=alone))
    return found


def _noise(step) -> float:
    """The standard deviation of white noise in a column, from its steps (N,); 0 if its fastest motion is not white."""
    third = np.diff(step, 2)
    third = third[np.isfinite(third)]
    if len(third) < 20 or not third.any():
        return 0.0
    third = np.clip(third, *(np.quantile(np.abs(third), QUIET) * np.array([-1, 1])))
    power = np.mean(third**2) or 1.0
    each = [np.mean(third[lag:] * third[:-lag]) / power for lag in (1, 2)]
    return float(np.sqrt(power / 20)) * bool(np.all(np.abs(np.subtract(each, WHITE)) < NEAR))


def _half_way(chain, t, q, gaps) -> list:
    """How far each tip strays from the line between two rows, half-way."""
    import jax

    from cnclik.robot.model import forward

    found = []
    for tip in (one.name for one in chain.tips):
        place = jax.vmap(lambda values, tip=tip: forward(chain, values, tip=tip).position)
        with jax.enable_x64(True):
            at, half = (np.asarray(place(rows)) for rows in (q, 0.5 * (q[1:] + q[:-1])))
        away = np.linalg.norm(half - 0.5 * (at[1:] + at[:-1]), axis=1)
        away = np.where(gaps[1:], np.nan, 1e3 * away)[:, None]
        found += _largest("half-way between rows", away, 0.5 * (t[1:] + t[:-1]), ["mm"], [tip or "tip"])
    return found
