"""Late: the loops with dead time, and perhaps a lag, that may cause an oscillation, and their probabilities.

A loop of gain z = alpha·Ts has the factor λ if z = −Ts/G(λ), with G the sampled drive from commanded velocity to
motion. For dead time alone z = λ^d (1 − λ), and the phase of λ gives d. With a lag, each shorter dead time has a lag
and a gain with which λ is a factor: only the rest of the recording, or a known gain, decides.
"""

from typing import NamedTuple

import numpy as np

from cnclik.diagnosis.blocks import triangle
from cnclik.diagnosis.modes import columns_of
from cnclik.integrate.drive import MOST, Drive, sampled
from cnclik.record import Float
from cnclik.stability.driven import driven_factors
from cnclik.stability.linear import late_monotone, late_stable

NEIGHBOURS = 2  # dead times to be tried on either side of the phase's
PERIODS = 12  # periods of a recording, at most
SHORT = 150  # rows; in a shorter recording more dead times are tried if none of these explains it:
WIDE = 12  # up to this, and up to twice the phase's
LAGS = 8  # dead times with a lag to be tried
COARSE = 0.5  # likelihood of the second, relative to the likeliest, below which those half way to its neighbours follow
NO_LAG = 0.2  # samples; a shorter lag counts as none
TEMPER = 0.25  # instead of 1/2, as no real loop is exactly one of these
SIMPLE = 0.03  # share of the likeliest loop's probability above which dead time alone is reported
USUAL = 0.05  # [s] typical largest lag of robot drives
FOLDS = -20, 5  # logarithms of a lag that a fit may try: far steps of it overflow
SHORTEST = 1e-2  # samples of a lag, at least
LONGEST = 0.2  # [s] of a lag, at most, of a robot's drive
WORSE = 4.0  # residual power, at most, as a multiple of the noise power
PART = 1e-3  # or as a share of the recording's power
UNMODELLED = 3e-4  # share of a recording that a linear loop cannot explain
KNOWN = 0.1  # relative deviation of the loop's gain from a known alpha·Ts
OTHER_GAIN = 9.0  # largest penalty in the criterion for a gain other than the known one


class LateLoop(NamedTuple):
    """A loop that may cause an oscillation."""

    delay: float  # [samples]
    lag: float  # [s], 0 for none
    z: float
    score: float = np.inf  # -2 log of its likelihood
    share: float = 0.0  # probability among all tried loops
    power: Float[np.ndarray, " k"] | tuple[()] = ()  # residual power of each column

    @property
    def drive(self) -> Drive:
        return Drive(delay=float(self.delay), lag=float(self.lag))

    @property
    def usual(self) -> float:
        """A weight for how common its lag is among robots."""
        return 1.0 / (1.0 + (self.lag / USUAL) ** 2)

    def as_known(self, z) -> float:
        """How well its gain fits the known one, at most 1; 1 if none is known."""
        return 1.0 if z is None else float(np.exp(-0.5 * min((np.log(self.z / z) / KNOWN) ** 2, OTHER_GAIN)))

    def factors(self, Ts):
        if self.lag or self.delay != round(self.delay):
            return driven_factors([-self.z], self.drive, Ts)
        rule = np.zeros(round(self.delay) + 2)
        rule[:2] = 1.0, -1.0
        rule[-1] += self.z
        return np.roots(rule)

    def slowest(self, Ts) -> complex:
        """The largest factor, above the real axis."""
        found = self.factors(Ts)
        found = found[found.imag >= 0]
        return complex(found[np.argmax(np.abs(found))])

    def calm(self, Ts) -> float:
        """The largest z without overshoot with one more sample of dead time: where two real factors meet."""
        if not self.lag:
            return late_monotone(self.delay + 1)
        fast = np.exp(-Ts / self.lag)
        at = fast + (1 - fast) * np.linspace(0, 1, 402)[1:-1]
        return float(np.max(-Ts / sampled(self._replace(delay=self.delay + 1).drive, Ts).transfer(at)))


def by_share(loops, of_lags: float, z=None) -> list:
    """Loops with their shares of the probability, the likeliest first.

    Args: of_lags: weight of a loop with a lag relative to one without. z: the loop's gain if known.
    """
    best = min(loop.score for loop in loops)
    odds = [
        np.exp(TEMPER * (best - loop.score)) * loop.usual * loop.as_known(z) * (of_lags if loop.lag else 1.0)
        for loop in loops
    ]
    found = [loop._replace(share=float(o)) for loop, o in zip(loops, odds / np.sum(odds), strict=True)]
    return sorted(found, key=lambda loop: -loop.share)


def phase_delay(factor) -> float:
    """The smallest dead time [samples] for which z is positive: −arg(1 − λ)/arg λ."""
    return float(-np.angle(1 - factor) / np.angle(factor))


def gain_of(factor, delay) -> float:
    """|z| = |λ|^d |1 − λ|."""
    return float(np.abs(factor) ** delay * np.abs(1 - factor))


def loops_of(factor, y, basis, noise, Ts, z=None) -> tuple:
    """(loops, whether they explain the recording) of a dominant factor, complex or negative.

    The first is the likeliest, or one without a lag that is not much less likely.

    Whole numbers of samples next to the phase's are tried over z, and shorter dead times with a lag. All motions of
    each loop are fitted to the recording. If none explains it, only the factor counts.

    Args:
      y: (N, k) recording. basis: (N, t) of its offset and path. noise: (k,) residual of the modes.
      Ts: [s]. z: the loop's gain if known.
    """
    phase = phase_delay(factor)
    period = 2 * np.pi / np.angle(factor)
    N = min(len(y), int(PERIODS * period + 4 * (phase + 1)) + 24)
    fit = _Fit(y[:N], basis[:N], Ts, z)
    near = range(max(round(phase) - NEIGHBOURS, 0), round(phase) + NEIGHBOURS + 1)
    if not factor.imag:  # with dead time, no negative factor is dominant
        near = (0,)
    tried = [fit.whole(delay, factor, phase) for delay in near if fit.has_room(delay)]
    if factor.imag and 0.2 < phase < MOST:
        tried += _with_lags(fit, factor, phase)
    if not _explained(tried, fit, noise) and factor.imag and N <= SHORT:
        wide = [d for d in range(min(2 * round(phase) + WIDE, N // 4)) if d not in near and fit.has_room(d)]
        tried += [fit.whole(d, factor, phase) for d in wide]
    if _explained(tried, fit, noise):
        found = by_share(tried, 1 / max(sum(loop.lag > 0 for loop in tried), 1))
        hardly = found[0].lag < NO_LAG * Ts
        simple = [loop for loop in found if not loop.lag and (loop.share > SIMPLE * found[0].share or hardly)]
        return [*simple[:1], *(loop for loop in found if not simple or loop is not simple[0])], True
    alone = LateLoop(round(phase), 0.0, gain_of(factor, round(phase)), share=1.0 - 2.0 * abs(phase - round(phase)))
    lagging = _family(factor, phase, np.arange(LAGS) / LAGS, Ts)
    return [alone, *(loop._replace(share=loop.as_known(z) * loop.usual / len(lagging)) for loop in lagging)], False


def _explained(loops, fit, noise) -> bool:
    """Whether the likeliest loop leaves only noise, or a small part."""
    if not loops:
        return False
    left = min(loops, key=lambda loop: loop.score).power
    return bool(np.all(left <= WORSE * noise**2 + PART * np.var(fit.y, axis=0)))


class _Fit(NamedTuple):
    y: np.ndarray
    basis: np.ndarray
    Ts: float
    z: float | None

    def has_room(self, delay) -> bool:
        return delay + 1 + self.basis.shape[1] < len(self.y) // 2

    def scored(self, loop: LateLoop) -> LateLoop:
        """A loop with its criterion, from the residual of all its motions and from its gain."""
        N, k = self.y.shape
        factors = loop.factors(self.Ts)
        r = triangle(np.hstack([columns_of(factors[factors.imag >= 0], N)[0], self.basis, self.y]))
        power = np.sum(r[-k:, -k:] ** 2, axis=0) / max(N - (len(r) - k), 1)
        floor = UNMODELLED**2 * np.var(self.y, axis=0) + np.finfo(float).tiny
        off = -2 * np.log(loop.as_known(self.z))
        return loop._replace(score=float(N * np.sum(np.log(power + floor))) + off, power=power)

    def whole(self, delay, factor, phase) -> LateLoop:
        """The best gain for a whole number of samples of dead time."""
        from scipy.optimize import minimize_scalar

        low, high = 0.65 * gain_of(factor, delay), 1.35 * gain_of(factor, delay)
        if abs(delay - phase) > 1 + NEIGHBOURS:  # then the factor is not its own
            low, high = late_monotone(delay), 1.2 * late_stable(delay)
        for share in (1e-3, 1e-7):
            made = minimize_scalar(
                lambda z: self.scored(LateLoop(delay, 0.0, z)).score,
                bounds=(low, high),
                method="bounded",
                options={"xatol": share * high},
            )
            low, high = 0.97 * made.x, 1.03 * made.x
        return self.scored(LateLoop(delay, 0.0, float(made.x)))


# --- with a lag ---------------------------------------------------------------------------------------


def _with_lags(fit, factor, phase) -> list:
    """Loops with a lag for a factor, which is then refitted with the best of them."""
    from scipy.optimize import minimize

    shares = np.arange(LAGS) / LAGS
    tried = [fit.scored(loop) for loop in _family(factor, phase, shares, fit.Ts) if fit.has_room(loop.delay + 1)]
    if not tried:
        return []
    best = min(tried, key=lambda loop: loop.score)

    def at(values):
        lag = max(best.lag * np.exp(np.clip(values[0], *FOLDS)), SHORTEST * fit.Ts)
        return best._replace(lag=lag, z=best.z * np.exp(values[1]))

    made = minimize(
        lambda values: fit.scored(at(values)).score,
        np.zeros(2),
        method="Nelder-Mead",
        options={"initial_simplex": 0.02 * np.array([[0, 0], [1, 0], [0, 1]]), "maxfev": 40, "fatol": 0.1},
    )
    factor = at(made.x).slowest(fit.Ts)
    if not factor.imag:
        return tried
    phase = phase_delay(factor)
    found = [*map(fit.scored, _family(factor, phase, shares, fit.Ts))]
    best, *others = sorted(found, key=lambda loop: loop.score) or [None]
    if others and np.exp(TEMPER * (best.score - others[0].score)) < COARSE:
        between = best.delay / phase + np.array([-0.5, 0.5]) / LAGS
        found += [*map(fit.scored, _family(factor, phase, between[between > 0], fit.Ts))]
    exact = None if fit.z is None else lag_of(factor, fit.z, fit.Ts)
    return found if exact is None else [*found, fit.scored(exact)]


def _family(factor, phase, shares, Ts) -> list:
    """Loops with a lag that have this factor as their largest, one per dead time, a share of the phase's."""
    from scipy.optimize import brentq

    def gain(delay, lag):
        return -Ts / sampled(Drive(delay=delay, lag=lag), Ts).transfer(factor)

    found = []
    for delay in phase * shares if factor.imag and 0.2 < phase < MOST else ():
        low, high = np.log(SHORTEST * Ts), np.log(1e3 * max(phase, 1) * Ts)
        turn = [np.angle(gain(delay, np.exp(at))) for at in (low, high)]
        if turn[0] * turn[1] < 0:
            lag = float(np.exp(brentq(lambda at, d=delay: np.angle(gain(d, np.exp(at))), low, high, xtol=1e-6)))
            loop = LateLoop(float(delay), lag, float(np.abs(gain(delay, lag))))
            if lag < LONGEST and np.abs(loop.slowest(Ts)) < np.abs(factor) + 1e-3:
                found.append(loop)
    return found


def lag_of(factor, z, Ts):
    """The loop of gain z, with dead time and a lag, that has this factor as its largest, or None."""
    from scipy.optimize import least_squares

    phase = max(phase_delay(factor), 0.1)

    def loop_of(values):
        delay, lag = min(abs(values[0]), 2 * phase + 2, MOST - 1), np.exp(np.clip(values[1], *FOLDS))
        return LateLoop(float(delay), float(lag), z)

    def off(values):
        value = 1.0 + z / Ts * sampled(loop_of(values).drive, Ts).transfer(factor)
        return [value.real, value.imag]

    for share in (0.5, 0.2, 0.8):
        made = least_squares(off, [share * phase, np.log((1 - share) * phase * Ts)], method="lm", max_nfev=200)
        if made.cost < 1e-16:
            loop = loop_of(made.x)
            if abs(np.abs(driven_factors([-z], loop.drive, Ts)).max() - np.abs(factor)) < 1e-3:
                return loop
    return None
