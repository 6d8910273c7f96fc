"""Check: which limits a log of joint values breaks, and what is wrong with its rows. The tip's path needs JAX."""

from __future__ import annotations

import numpy as np

from cnclik import errors
from cnclik.diagnosis.recording import columns, spacing
from cnclik.record import ArrayLike, Float, record, replace

ORDERS = {"velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
PUBLISHED: dict[
    str, dict[str, tuple]
] = {  # Franka Control Interface documentation, "Robot and interface specifications"
    "panda": {
        "velocity": (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
        "acceleration": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        "jerk": (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    },
    "fr3": {
        "velocity": (2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
        "acceleration": (10.0,) * 7,
        "jerk": (5000.0,) * 7,
    },
}
ROUNDING = 1e-6  # share of a limit: a motion at its limit is written with some ten digits
TURN = 0.1  # [rad] from a whole turn, within which a jump is a wrap: no joint moves a turn in a sample
APART = 4.0  # times the largest step of the three rows on either side: smooth motion at most doubles its step
QUIET = 0.99  # share of the third differences that may be noise: the others may be jumps
WHITE = (-0.75, 0.3)  # autocorrelation of the third differences of white noise at lags 1 and 2: −15/20, 6/20
NEAR = 0.25  # how far that of a hundred rows may be from it; motion of period 2, 3 or 4 has (−1, 1), (−½, −½), (0, −1)


@record
class Finding:
    """The worst of one kind in a log.

    Attributes:
      what: "velocity", "acceleration", "jerk", "beyond its range", "jump", "wrap by 2π", "half-way between rows",
        "behind its command", or of rows "missing", "repeated", "reversed".
      column: name of the column, or "" of all. value: the largest, in `unit`; of rows and wraps their number.
      at: its time [s]. limit: of this column, or None. noise: the largest that noise alone gives, or None.
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
        """Value over limit."""
        if self.limit is None:
            return None
        return self.value / self.limit if self.limit else np.inf * np.sign(self.value)

    @property
    def broken(self) -> bool:
        """Whether a limit is exceeded, by more than noise alone explains."""
        exceeded = self.share is not None and self.share > 1 + ROUNDING
        return exceeded and (self.noise is None or self.value > self.noise)


@record
class LogCheck:
    """What a log breaks.

    Attributes: findings: each `Finding`. Ts: usual sampling time [s]. rows: their number.
    """

    findings: tuple[Finding, ...]
    Ts: float
    rows: int

    @property
    def broken(self) -> tuple[Finding, ...]:
        """The findings that exceed a limit."""
        return tuple(one for one in self.findings if one.broken)

    def __str__(self):
        table = [("", "column", "largest", "at", "limit", "of limit", "noise alone"), *map(_cells, self.findings)]
        width = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [f"{row[0]:<{width[0]}}  {row[1]:<{width[1]}}" for row in table]
        for i in range(2, len(width)):
            lines = [f"{line}  {row[i]:>{width[i]}}" for line, row in zip(lines, table, strict=True)]
        said = "No limit is broken."
        if self.broken:
            worst = max(self.broken, key=lambda one: one.share)
            said = f"Broken limits: {len(self.broken)}. The worst: {worst.what} of {worst.column} at {worst.at:.4g} s."
        if noisy := sum(not one.broken and (one.share or 0) > 1 + ROUNDING for one in self.findings):
            said += f" Noise alone explains {noisy} more values above a limit."
        return "\n".join([*(line.rstrip() for line in lines), said])


def _cells(one: Finding) -> tuple:
    value = f"{one.value:.4g} {one.unit}".rstrip()
    share = None if one.share is None or not np.isfinite(one.share) else one.share
    limit, share, noise = ("" if v is None else f"{v:.4g}" for v in (one.limit, share, one.noise))
    return one.what, one.column, value, f"{one.at:.4g} s", limit, share, noise


def check_log(
    t: Float[ArrayLike, " N"] | None,
    q: Float[ArrayLike, "N ..."],
    *,
    Ts: float | None = None,
    limits=None,
    chain=None,
    command: Float[ArrayLike, "N ..."] | None = None,
    resolution: float = 0.0,
    names=None,
) -> LogCheck:
    """Check which limits a log of joint values breaks, and where; and whether rows are missing, repeated or reversed.

    Velocity, acceleration and jerk are differences of neighbouring rows over powers of Ts, as a robot's controller
    computes them; none of them goes across a gap or a wrap by 2π. What white noise of the size that is seen gives
    stands beside them: below it a value is not taken for a broken limit.

    Args:
      t: (N,) times [s], or None with a Ts. q: (N,) or (N, k) joint values [rad, m], measured or commanded.
      limits: {"velocity": (k,), "acceleration": …, "jerk": …}, each also a number; or "panda" or "fr3", whose maker
        publishes all three.
      chain: whose limits of position and velocity count where no others are given, and whose tip is looked at half-way
        between rows: how far it strays from the straight line if joints are interpolated linearly.
      command: (N, k) commanded joint values, compared with q and checked against the limits, too.
      resolution: of the encoders [rad, m]; a step of it is no motion.
      names: of the columns of q, and then of those of command.
    Raises: ArgumentError for fewer than four rows, and for what does not fit.
    """
    q = columns("q", q)
    k = q.shape[1]
    names = (
        [f"joint {i + 1}" for i in range(k)] + [f"command {i + 1}" for i in range(k)] if names is None else list(names)
    )
    if len(q) < 4:
        raise errors.fail("q", "have at least 4 rows", f"has {len(q)}")
    if t is None:
        t = float(errors.number("Ts", Ts, positive=True)) * np.arange(len(q))
    t = np.asarray(errors.array("t", t, (len(q),)), float)
    Ts = spacing(t) if Ts is None else float(errors.number("Ts", Ts, positive=True))
    most = _limits(limits, chain, k)
    units = ["rad"] * k if chain is None else list(chain.units)
    noise_of = float(errors.number("resolution", resolution, at_least=0))
    found, t, gaps, kept = _rows(t, q, Ts)
    sent = None if command is None else columns("command", command)
    if sent is not None and sent.shape != q.shape:
        raise errors.fail("command", f"have the shape of q, {q.shape}", f"has {sent.shape}")
    found += _motion(t, q[kept], gaps, Ts, most, names[:k], units, noise_of, measured=True)
    if sent is not None:
        found += _motion(t, sent[kept], gaps, Ts, most, names[k:], units, 0.0, measured=False)
        found += _largest("behind its command", np.abs(sent - q)[kept], t, units, names[:k])
    if chain is not None:
        found += _half_way(chain, t, q[kept], gaps)
    return LogCheck(findings=tuple(found), Ts=Ts, rows=len(q))


def _limits(limits, chain, k) -> dict:
    """{quantity: (k,)} of the limits that are given, or else of the chain."""
    if isinstance(limits, str):
        limits = PUBLISHED[errors.one_of("limits", limits, PUBLISHED)]
    limits = dict(errors.kind("limits", limits or {}, dict))
    for name in limits:
        errors.one_of("limits", name, ORDERS)
    if chain is not None:
        if chain.n != k:
            raise errors.fail("q", f"have a column for each of the chain's {chain.n} joints", f"has {k}")
        limits = {"velocity": np.asarray(chain.velocity_limit)} | limits
    made = {
        name: np.asarray(errors.array(f"limits.{name}", v, (), (k,), finite=False), float) for name, v in limits.items()
    }
    made = {name: np.broadcast_to(v, k) for name, v in made.items()}
    if chain is not None:
        made["lower"], made["upper"] = np.asarray(chain.lower), np.asarray(chain.upper)
    return made


def _rows(t, q, Ts):
    """(findings of rows, times of the rows to keep, whether a gap is before each, their indices)."""
    step = np.diff(t)
    back, same = np.flatnonzero(step < 0), np.flatnonzero(step == 0)
    two = np.concatenate(
        [[np.inf], t[2:] - t[:-2], [np.inf]]
    )  # a single late stamp is jitter: the next one is not late
    late = (step > 1.6 * Ts) & (two[:-1] > 2.6 * Ts) & (two[1:] > 2.6 * Ts)
    moved = np.abs(np.diff(q, axis=0)).sum(1)
    before, after = moved[:-3] + moved[1:-2], moved[3:]  # a stale row: a steady motion stops, and makes up for it
    steady = np.abs(moved[1:-2] - moved[:-3]) < 0.1 * before
    stale = (
        np.flatnonzero(
            (moved[2:-1] == 0) & steady & (before > 0) & (np.abs(after / np.maximum(before, 1e-300) - 1) < 0.2)
        )
        + 2
    )
    found = []
    missing = int(np.sum(np.round(step[late] / Ts) - 1))
    for what, count, at in (
        ("missing", missing, np.flatnonzero(late)),
        ("repeated", len(same) + len(stale), np.union1d(same, stale)),
        ("reversed", len(back), back),
    ):
        if count:
            found.append(Finding(what=what, column="", value=float(count), unit="rows", at=float(t[at[0] + 1])))
    kept = np.concatenate([[0], np.flatnonzero(step != 0) + 1])
    cut = np.zeros(len(t), bool)
    cut[1:] = late | (step < 0)
    return found, t[kept], cut[kept], kept


def _motion(t, q, gaps, Ts, most, names, units, resolution, *, measured) -> list:
    """Findings of joint values (N, k); those of commands have no noise."""
    step, found = np.diff(q, axis=0), []
    wraps = (np.abs(np.abs(step) - 2 * np.pi) < TURN) & ~gaps[1:, None]
    for j in np.flatnonzero(wraps.any(0)):
        count, at = float(wraps[:, j].sum()), float(t[np.argmax(wraps[:, j]) + 1])
        found.append(Finding(what="wrap by 2π", column=names[j], value=count, unit="times", at=at))
    if wraps.any():
        step = step - np.where(wraps, np.sign(step) * 2 * np.pi, 0.0)
        q = q[:1] + np.concatenate([np.zeros_like(q[:1]), np.cumsum(step, axis=0)])
    step = np.where(gaps[1:, None], np.nan, step)
    sizes = [_noise(step[:, j]) if measured else 0.0 for j in range(q.shape[1])]
    around = np.stack([np.roll(step, s, 0) for s in (-3, -2, -1, 1, 2, 3)])
    beyond = np.abs(step) > APART * np.nanmax(np.abs(around), axis=0, initial=0.0) + 6 * np.array(sizes) + resolution
    found += _largest("jump", np.where(beyond, np.abs(step), 0.0), t[1:], units, names, seldom=True)
    if "lower" in most:
        over = np.maximum(np.maximum(q - most["upper"], most["lower"] - q), 0.0)
        found += _largest("beyond its range", over, t, units, names, np.zeros(q.shape[1]), seldom=True)
    value = step
    for order, (name, per) in enumerate(ORDERS.items(), 1):
        value = value if order == 1 else np.diff(value, axis=0)
        # The variance of a difference of white noise, what one log in a hundred exceeds, and a step of the encoder.
        spread, count = np.sqrt((2, 6, 20)[order - 1] * 2 * np.log(100 * len(q))), (1, 2, 3)[order - 1]
        alone = [(spread * size + count * resolution) / Ts**order for size in sizes]
        found += _largest(
            name, np.abs(value) / Ts**order, t[order:], [u + per for u in units], names, most.get(name), alone
        )
    return found


def _largest(what, values, t, units, names, limit=None, noise=None, *, seldom=False) -> list:
    """A finding for each column of values (N, k). seldom: leave out columns of zeros."""
    found = []
    for j, name in enumerate(names):
        if np.isnan(values[:, j]).all() or (seldom and not values[:, j].any()):
            continue
        i = int(np.nanargmax(values[:, j]))
        most = None if limit is None or not np.isfinite(limit[j]) else float(limit[j])
        alone = None if noise is None else float(noise[j])
        one = Finding(what=what, column=name, value=float(values[i, j]), unit=units[j], at=float(t[i]))
        found.append(replace(one, limit=most, noise=alone))
    return found


def _noise(step) -> float:
    """The standard deviation of white noise in a column, from its steps (N,); 0 if its fastest motion is not white."""
    third = np.diff(step, 2)
    third = third[np.isfinite(third)]
    if len(third) < 20 or not third.any():
        return 0.0
    most = np.quantile(np.abs(third), QUIET)
    third = np.clip(third, -most, most)
    power = np.mean(third**2) or 1.0
    each = [np.mean(third[lag:] * third[:-lag]) / power for lag in (1, 2)]
    white = all(abs(seen - wanted) < NEAR for seen, wanted in zip(each, WHITE, strict=True))
    return float(np.sqrt(power / 20)) * white


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
        away = np.where(gaps[1:], np.nan, away)[:, None]
        found += _largest("half-way between rows", 1e3 * away, 0.5 * (t[1:] + t[:-1]), ["mm"], [tip or "tip"])
    return found
