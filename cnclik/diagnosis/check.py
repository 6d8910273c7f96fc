"""Check: which limits a log of joint values breaks, and what is wrong with its rows. The tip's path needs JAX."""

from __future__ import annotations

import typing
from collections.abc import Sequence

import numpy as np

from cnclik import errors
from cnclik.diagnosis.recording import columns, missing, sampling_time, spacing, unwrapped
from cnclik.quantities import plainly
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
    def share(self) -> float | None:
        """Value over limit; None without a limit."""
        return None if self.limit is None else self.value / self.limit if self.limit else np.inf

    @property
    def broken(self) -> bool:
        """Whether a limit is exceeded, by more than noise alone explains."""
        return (self.share or 0.0) > 1 + ROUNDING and self.value > (self.noise or 0.0)


@record
class LogCheck:
    """Answer of `check_log`: its findings, the usual sampling time Ts [s], and the number of rows."""

    findings: tuple[Finding, ...]
    Ts: float
    rows: int

    @property
    def broken(self) -> tuple[Finding, ...]:
        """The findings that exceed a limit."""
        return tuple(finding for finding in self.findings if finding.broken)

    def __str__(self):
        table = [("", "column", "largest", "at", "limit", "of limit", "noise alone")]
        for each in self.findings:
            numbers = (each.value, each.limit, each.share, each.noise)
            size, *rest = ("" if v in (None, np.inf) else plainly(v, 4) for v in numbers)  # no share of a limit of 0
            table.append((each.what, each.column, f"{size} {each.unit}", f"{each.at:.7g} s", *rest))
        width = [max(map(len, cells)) for cells in zip(*table, strict=True)]
        form = f"{{:{width[0]}}}  {{:{width[1]}}}" + "".join(f"  {{:>{wide}}}" for wide in width[2:])
        said = "No limits are given." if all(each.limit is None for each in self.findings) else "No limit is broken."
        if self.broken:
            worst = max(self.broken, key=lambda each: each.share)
            said = f"Broken limits: {len(self.broken)}. The worst: {worst.what} of {worst.column} at {worst.at:.7g} s."
        return "\n".join([*(form.format(*cells).rstrip() for cells in table), said])


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
    units: Sequence[str] | None = None,
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
      units: rad or m of each column of q; default: the chain's, else rad.
    Raises: ArgumentError for fewer than four rows, and for what does not fit.
    """
    q = columns("q", q, "check_log", least=4)
    sent = q[:, :0] if command is None else columns("command", command, "check_log", like=q, least=4)
    k, most = q.shape[1], _limits(limits, chain, q.shape[1])
    if names is None:
        names = [f"{w} {i + 1}" for w in ("joint", "command") for i in range(k)]
    elif isinstance(names, str) or not isinstance(names, Sequence) or len(names) != k + sent.shape[1]:
        raise errors.fail("names", f"be a list of {k + sent.shape[1]} names", f"is {names!r}")
    if t is None:
        t = sampling_time(None, Ts) * np.arange(len(q))
    t = np.asarray(errors.array("t", t, (len(q),)), float)
    Ts = spacing(t) if Ts is None else sampling_time(None, Ts)
    errors.number("resolution", resolution, at_least=0)
    units = (["rad"] * k if chain is None else list(chain.units)) if units is None else list(units)
    if len(units) != k or not {*units} <= {"rad", "m"}:
        raise errors.fail("units", f"be rad or m of each of {k} columns", f"are {', '.join(map(str, units))}")
    findings, kept, gaps = _rows(t, np.abs(np.diff(q, axis=0)).sum(1), Ts)
    rows, t, q, sent = len(q), t[kept], q[kept], sent[kept]
    ways = [unwrapped(column, gaps) for column in (*q.T, *sent.T)]
    of_motion = [
        _motion(t, moved, wraps, gaps, Ts, most[j % k], names[j], units[j % k], resolution if j < k else None)
        for j, (moved, wraps) in enumerate(ways)
    ]
    findings += [finding for kind in zip(*of_motion, strict=True) for finding in kind]
    for j, ((moved, wraps), (wanted, before)) in enumerate(zip(ways, ways[k:], strict=False)):
        behind = wanted - moved
        turns = np.round(behind / (2 * np.pi)) * np.any(wraps | before)  # one of both may wrap before the log
        findings.append(_worst("behind its command", np.abs(behind - turns * 2 * np.pi), t, names[j], units[j]))
    if chain is not None:
        findings += _half_way(chain, t, np.stack([moved for moved, _ in ways[:k]], 1), gaps)
    return LogCheck(findings=tuple(filter(None, findings)), Ts=Ts, rows=rows)


def _limits(limits, chain, k) -> list[dict]:
    """{quantity: limit} of each column, as given, or else of the chain."""
    if isinstance(limits, str):
        limits = PUBLISHED[errors.one_of("limits", limits, PUBLISHED)]
    limits = {} if limits is None else errors.kind("limits", limits, dict)
    limits = {errors.one_of("limits", name, ORDERS): value for name, value in limits.items()}
    if chain is not None and not hasattr(chain, "joint_names"):
        raise errors.fail("chain", "be a Chain, such as load(...) gives", f"is {chain!r}")
    if chain is not None and chain.n != k:
        raise errors.fail("q", f"have a column for each of the chain's {chain.n} joints", f"has {k}")
    if chain is not None:
        limits = {"velocity": chain.velocity_limit, "lower": chain.lower, "upper": chain.upper} | limits
    for name, value in limits.items():
        least = 0 if name in ORDERS else None
        limits[name] = np.broadcast_to(errors.array(f"limits.{name}", value, (), (k,), finite=False, at_least=least), k)
    return [{name: float(values[j]) for name, values in limits.items()} for j in range(k)]


def _rows(t, moved, Ts) -> tuple:
    """(findings of rows, indices of the rows to keep, whether a gap is before each), from how far joints move."""
    step, late = np.diff(t), missing(t, Ts)
    same, back = step == 0, step < 0
    way = np.convolve(moved, [1.0, 0.0, 0.0, 0.0, 1.0], "same")  # a stale row: steady motion stops, and makes up for it
    same[2:-2] |= (moved[2:-2] == 0) & (np.abs(moved[3:-1] / np.maximum(way[2:-2], 1e-300) - 1) < 0.1)
    counts = {"missing": np.where(late, np.round(step / Ts) - 1, 0), "repeated": same, "reversed": back}
    findings = [_worst(what, (n > 0) * n.sum(), t[1:], "", "rows") for what, n in counts.items() if n.any()]
    kept = np.concatenate([[0], np.flatnonzero(step != 0) + 1])
    return findings, kept, (late | back)[kept[1:] - 1]


def around(steps):
    """The largest of the three steps (N,) on either side of each; NaN where all lie across gaps."""
    return np.fmax.reduce([np.roll(steps, s) for s in (-3, -2, -1, 1, 2, 3)])


def _motion(t, q, wraps, gaps, Ts, limit, name, unit, resolution) -> list:
    """Findings of joint values (N,), of each kind one or None. resolution: None of commands, which have no noise."""
    step = np.where(gaps, np.nan, np.diff(q))
    noise = 0.0 if resolution is None else _noise(step)
    jumps = np.abs(step) > APART * around(np.abs(step)) + 6 * noise + (resolution or 0.0)
    over = np.maximum(np.maximum(q - limit.get("upper", np.inf), limit.get("lower", -np.inf) - q), 0.0)
    findings = [
        _worst("wrap by 2π", wraps * wraps.sum(), t[1:], name, "times") if wraps.any() else None,
        _worst("jump", np.where(jumps, np.abs(step), 0.0), t[1:], name, unit) if jumps.any() else None,
        _worst("beyond its range", over, t, name, unit, 0.0) if over.any() else None,
    ]
    value = step
    for order, (what, per) in enumerate(ORDERS.items(), 1):
        # The variance of a difference of white noise, what one log in a hundred exceeds, and steps of the encoder.
        spread, steps = np.sqrt((2, 6, 20)[order - 1] * 2 * np.log(100 * len(q))), (1, 2, 3)[order - 1]
        alone = (spread * noise + steps * (resolution or 0.0)) / Ts**order
        findings.append(_worst(what, np.abs(value) / Ts**order, t[order:], name, unit + per, limit.get(what), alone))
        value = np.diff(value)
    return findings


def _worst(what, values, t, name, unit, limit=None, noise=None) -> Finding | None:
    """The largest of values (N,); None where all lie across gaps. An infinite limit is none."""
    if np.isnan(values).all():
        return None
    i, limit = int(np.nanargmax(values)), limit if limit is not None and limit < np.inf else None
    return Finding(what=what, column=name, value=float(values[i]), unit=unit, at=float(t[i]), limit=limit, noise=noise)


def _noise(step) -> float:
    """The standard deviation of white noise in a column, from its steps (N,); 0 if its fastest motion is not white."""
    third = np.diff(step, 2)
    third = third[np.isfinite(third)]
    if len(third) < 20 or not third.any():
        return 0.0
    third = np.clip(third, *(np.quantile(np.abs(third), QUIET) * np.array([-1, 1])))
    power = np.mean(third**2) or 1.0
    correlation = [np.mean(third[lag:] * third[:-lag]) / power for lag in (1, 2)]
    return float(np.sqrt(power / 20)) * bool(np.all(np.abs(np.subtract(correlation, WHITE)) < NEAR))


def _half_way(chain, t, q, gaps) -> list:
    """How far each tip strays from the line between two rows, half-way."""
    import jax

    from cnclik.robot.model import forward

    def middle(rows):
        return 0.5 * (rows[1:] + rows[:-1])

    findings = []
    for tip in (each.name for each in chain.tips):
        place = jax.vmap(lambda values, tip=tip: forward(chain, values, tip=tip).position)
        with jax.enable_x64(True):
            away = 1e3 * np.linalg.norm(place(middle(q)) - middle(place(q)), axis=1)
        findings.append(_worst("half-way between rows", np.where(gaps, np.nan, away), middle(t), tip or "tip", "mm"))
    return findings
