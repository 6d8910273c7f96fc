"""Driven: the linear loop through its drives, exactly: its factors, limits, responses and margins.

A controller's step at rest is Δ = Σⱼ Dⱼ y[k−j] of the joint values y that it uses, measured from their target; explicit
Euler has D₀ = −z. The sampled drive turns steps into motion (see `cnclik.integrate.drive`), and both together are one
matrix. With one drive for all joints each eigenvector of Dⱼ is a loop of its own, a "mode".
"""

import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, sampled
from cnclik.integrate.method import DEFAULT
from cnclik.precision import in_float64
from cnclik.record import record
from cnclik.robot.rotations import library
from cnclik.stability.drives import longer, own_drives, several, side_by_side
from cnclik.stability.linear import EPS, FEW, REACH, checked, coefficients, first_above, least_on

SLACK = 2**22 * EPS  # a radius above 1 by more is unstable; eigenvalues of 1 have rounding
_ZERO = 1e-9  # smaller factors count as 0
SWING = 1e-4  # relative imaginary part that counts as 0; rounding separates equal factors
OVERSHOOT = 0.01  # largest overshoot of a step that counts as none
WORK = 1e6  # work of one batch of eigenvalues: their number times the cube of the matrix's size
POINTS = 128  # largest number of values of z in a batch
FAR = 1e12  # a response larger than this many times the input is not continued
LONGEST = 20_000  # samples of a response
INPUTS = 4  # of a loop: noise, target, by how much that moves, and what is fed forward


# --- a loop as a matrix -------------------------------------------------------------------------------


def increments(method, stage, z):
    """D (..., p) of a method: R(z) − 1 of a one-step one, of a multistep formula aⱼ − δ₀ⱼ − z bⱼ."""
    a, b = coefficients(*checked(method, stage), z)
    return a - (np.arange(len(a)) == 0) + b


def loop_matrix(steps, drive: Drive, Ts: float, inputs: bool = False):
    """The matrix (..., S, S) of a loop whose step is Σⱼ Dⱼ y[k−j], D (..., p, n, n): what its own code makes of unit
    vectors. Pure: D may be traced.

    The state is the drives' (n, s), the sum of the steps where the loop depends on it, the commands under way, and
    the joint values that the method remembers. With inputs they come after it: noise of this measurement alone, the
    target, by how much it moves, a step that is fed forward; and a last row is the controller's step.
    """
    model, (p, n, _), xp = sampled(drive, Ts), steps.shape[-3:], library(steps)
    if several(drive):  # modes along the first axes, then unit vectors and joints
        model = model.beside()
    count = model.size + drive.adds_up + model.remembered + p - 1 + INPUTS * inputs
    units = np.eye(n * count)
    x = units[:, : n * model.size].reshape(-1, n, model.size)
    rest = list(np.moveaxis(units[:, n * model.size :].reshape(n * count, -1, n), 1, 0))
    noise, target, moves, fed = [rest.pop() for _ in range(INPUTS)][::-1] if inputs else [0.0] * INPUTS
    sent = rest.pop(0) if drive.adds_up else 0.0
    line, older = tuple(rest[: model.remembered]), rest[model.remembered :]
    seen = sent if drive.feedback == "commanded" else x[..., 0] + noise
    past = [seen - target, *older]
    step = sum(v @ xp.swapaxes(steps[..., j, :, :], -1, -2) for j, v in enumerate(past)) + fed
    sent = (seen if drive.feedback == "rebased" else sent) + step
    u = sent if drive.steps_positions else step / Ts
    x, line = model.moved(x, line, u), (u, *line)[: model.remembered]
    parts = [x.reshape(*x.shape[:-2], -1), *[sent] * drive.adds_up, *line, *past[: p - 1]]
    parts += [0.0 * noise, target + moves, moves, fed, step] if inputs else []
    shape = np.broadcast_shapes(*(v.shape[:-1] for v in parts))
    return xp.swapaxes(xp.concatenate([xp.broadcast_to(v, (*shape, v.shape[-1])) for v in parts], -1), -1, -2)


def looked_at_drive(drive) -> Drive:
    """The drive as seen by the loop; a loop that uses its own commands sees none."""
    return Drive() if drive.feedback == "commanded" else drive.lumped


def driven_factors(steps, drive: Drive, Ts: float):
    """All factors (..., S) of modes whose step is Σⱼ Dⱼ y[k−j], D (..., p), one drive for all joints; (..., d, r, S) of
    modes (..., r, p) through each of several, see `side_by_side`."""
    steps = np.asarray(steps)
    steps = steps[..., None, :, :] if several(drive) else steps
    return np.linalg.eigvals(loop_matrix(steps[..., None, None], looked_at_drive(drive), Ts))


def modes_of(moved, basis, drive):
    """Steps D of maps of the joints (k, p·n, p·n), see `spectrum.one_step`, on the directions of a basis (n, r).

    Returns: (k, r, p) modes; or, where joints differ in their drives, (k, p, n, n): such directions do not part.
    """
    n, r = basis.shape
    p = moved.shape[-1] // n
    steps = np.moveaxis(moved[:, :n].reshape(len(moved), n, p, n), 2, 1)
    steps = steps - np.eye(n) * (np.arange(p) == 0)[:, None, None]
    if own_drives(drive):
        across = basis @ basis.T
        return across @ steps @ across
    steps = basis.T @ steps @ basis
    finite = np.isfinite(steps).all((1, 2, 3))
    newest = np.where(finite[:, None, None], steps[:, 0], np.eye(r))
    if p == 1:
        found = np.linalg.eigvals(newest)[..., None]
    else:
        _, vectors = np.linalg.eig(newest)
        found = np.linalg.solve(vectors[:, None], steps @ vectors[:, None])
        found = np.moveaxis(np.diagonal(found, axis1=-2, axis2=-1), 1, 2)
    return alike(np.where(finite[:, None, None], found, np.nan))


def alike(modes):
    """Modes (k, r, p), or one for all where they are alike, as with exact J# and one gain."""
    return modes[:, :1] if np.nanmax(np.abs(modes - modes[:, :1]), initial=0.0) < _ZERO else modes


def radius(steps, drive, Ts):
    """Spectral radius (...) of modes (..., r, p), or of matrices (..., p, n, n) where joints have drives of their own;
    inf where not finite, 0 of no mode."""
    return np.abs(_all_factors(steps, drive, Ts)).max(-1, initial=0.0)


def _all_factors(steps, drive, Ts):
    axes = (-3, -2, -1) if own_drives(drive) else (-2, -1)
    finite = np.isfinite(steps).all(axes)
    steps = np.where(np.expand_dims(finite, axes), steps, 0.0)
    if own_drives(drive):
        found = np.linalg.eigvals(loop_matrix(steps, looked_at_drive(drive), Ts))
        still = np.argsort(np.abs(found - 1.0), -1)[..., : _idle(steps)]  # unmoved directions
        np.put_along_axis(found, still, 0.0, -1)
    else:
        found = driven_factors(steps, drive, Ts)
        found, finite = found.reshape(*found.shape[:-2], -1), finite[..., None] if several(drive) else finite
    return np.where(finite[..., None], found, np.inf)


def _idle(steps) -> int:
    """Number of joint directions that matrices (..., p, n, n) do not move."""
    newest = steps.reshape(-1, *steps.shape[-3:])[:, 0]
    size = np.linalg.svd(newest, compute_uv=False)
    return int(np.sum(size <= 1e-9 * np.maximum(size[:, :1], _ZERO), -1).min(initial=newest.shape[-1]))


def swings(steps, drive, Ts):
    """How far the slowest factor is from one of an error that keeps its sign: |Im λ|/|λ|, or 2 for a negative λ; of
    several drives the worst."""
    found = _all_factors(_outermost_of_each(steps), drive, Ts)
    size = np.abs(found)
    slowest = size >= size.max(-1, keepdims=True) * (1 - 1e-6)
    with np.errstate(all="ignore"):
        off = np.where(found.real < 0, 2.0, np.abs(found.imag)) / np.where(found.real < 0, 1.0, np.maximum(size, EPS))
    off = np.where(np.isfinite(found) & (size > _ZERO), off, np.where(np.isfinite(found), 0.0, np.inf))
    return np.where(slowest, off, 0.0).max((-2, -1) if several(drive) else -1)


def damping_ratio(steps, drive, Ts) -> float:
    """ζ of the slowest factor of the modes (r, p): −ln|λ|/|ln λ|, 1 of a real positive one, 0 at the edge; of several
    drives the least."""
    found = _all_factors(steps[None], drive, Ts)
    least = 1.0
    for one in found.reshape(-1, found.shape[-1]):
        slowest = one[np.abs(one) >= np.abs(one).max() * (1 - 1e-6)]
        turn, fall = np.abs(np.angle(slowest)).max(), -np.log(max(np.abs(slowest).max(), _ZERO))
        least = min(least, float(fall / np.hypot(fall, turn)) if turn > SWING else 1.0)
    return least


# --- limits -------------------------------------------------------------------------------------------


@record
class DrivenLimits:
    """Limits of z = alpha·Ts for a loop through its drives; inf where there is no limit.

    Attributes:
      stable: largest z that is stable.
      monotone: largest z without overshoot: the slowest factor is real, and a step overshoots by at most 1 %.
      recommended: largest z without overshoot with one more sample of dead time.
      fastest, rate: z with the least spectral radius, and that radius.
    """

    stable: float
    monotone: float
    recommended: float
    fastest: float
    rate: float


def looked_at(drive, size: float) -> int:
    """Number of values of z per batch, for the size of the matrices and the dead time."""
    return int(np.clip(WORK / (size + drive.lumped.delay) ** 3, 16, POINTS))


def monotone_limit(modes, drive, Ts, stable, reach, points):
    """Largest z up to `stable` without overshoot, see `DrivenLimits`, through one drive for all joints, or the least
    through each of several.

    Args:
      modes: modes(z) for z (k,) are the loop's (k, r, p), see `driven_factors`.
      reach: z up to which is looked. points: of them together.
    """
    points = FEW if several(drive) else points
    found = first_above(lambda z: swings(modes(z), drive, Ts), SWING, min(stable, reach), points)
    found = min(stable, found)
    if not np.isfinite(found) or overshoot(modes(np.array([found]))[0], drive, Ts) <= OVERSHOOT:
        return found
    low, high = 0.0, found
    for _ in range(12):
        middle = 0.5 * (low + high)
        kept = overshoot(modes(np.array([middle]))[0], drive, Ts) <= OVERSHOOT
        low, high = (middle, high) if kept else (low, middle)
    return low


@in_float64
def driven_limits(method=DEFAULT, stage=None, *, Ts: float, drive: Drive = Drive()) -> DrivenLimits:
    """Largest stable, monotone, recommended and fastest z of a method through a drive, exact J#. In float64.

    Pure dead time of d samples and explicit Euler: stable to 2 sin(π/(2(2d + 1))), monotone to d^d/(d + 1)^(d + 1).
    A second-order drive, measured joints and a fast loop: stable to alpha = 2ζω₀, which is k_v/m.

    Args:
      method, stage: as for `amplification`. Ts: sampling time [s]. drive: one for all joints.
    """
    method, stage = checked(method, stage)
    errors.number("Ts", Ts, positive=True)
    if own_drives(drive):
        raise errors.fail("drive", "be one for all joints (`advise` takes one for each)", "has several numbers")
    return least_limits(method, stage, float(Ts), drive)


def least_limits(method, stage, Ts: float, drive: Drive) -> DrivenLimits:
    """The least of `driven_limits` of the joints' drives, each as one for all."""
    (method, stage), drive = checked(method, stage), side_by_side(drive)
    points = looked_at(drive, 2)

    def modes(z):
        return increments(method, stage, z)[..., None, :]

    def size(z):
        found = radius(modes(z), drive, Ts)
        return found.max(-1) if several(drive) else found

    stable = first_above(size, 1 + SLACK, REACH, points)
    fastest, rate = least_on(size, min(stable, REACH), points)
    monotone, late = (monotone_limit(modes, one, Ts, stable, REACH, points) for one in (drive, longer(drive)))
    return DrivenLimits(
        stable=stable,
        monotone=monotone,
        recommended=min(monotone, late),
        fastest=np.inf if fastest >= REACH else fastest,
        rate=rate,
    )


# --- responses ----------------------------------------------------------------------------------------


def respond(steps, drive: Drive, Ts: float, N: int, *, target=0.0, speed=0.0, forward=0.0, noise=0.0):
    """Modes (r, p) in time, from rest at 0: motion (N + 1, r) and steps (N, r); through several drives (N + 1, d, r).

    Args:
      target: where they are to be, at first. speed: of the target. forward: velocity that is fed forward, a number or
        (r,). noise: of the first measurement.
    """
    steps = np.asarray(steps, float)
    matrix = loop_matrix(steps[..., None, None], drive.lumped, Ts, inputs=True)
    power, rows = matrix[..., :-1, :], matrix[..., [0, -1], :]
    x = np.zeros((*power.shape[:-1], 1))
    x[..., -INPUTS - steps.shape[-1] + 1 : -INPUTS, 0] = -target
    for i, value in enumerate((noise, target, speed * Ts, np.multiply(forward, Ts))):
        x[..., i - INPUTS, 0] = value
    with np.errstate(all="ignore"):  # what grows ends as inf
        while rows.shape[-2] ** 2 < 4 * N:  # rows of two for each of so many samples
            rows, power = np.concatenate([rows, rows @ power], -2), power @ power
        while rows.shape[-2] * x.shape[-1] < 2 * N:
            x, power = np.concatenate([x, power @ x], -1), power @ power
        found = (rows @ x).reshape(*rows.shape[:-2], -1, 2, x.shape[-1])
    found = np.moveaxis(found, (-1, -3, -2), (1, 2, 0)).reshape(2, -1, *rows.shape[:-2])[:, :N]
    q, asked = np.where(np.abs(found) < FAR, found, np.inf)
    return np.concatenate([np.zeros_like(q[:1]), q]), asked


def until_settled(steps, drive, Ts, share=1e-3) -> int:
    """Samples until a mode (p,), or the slowest of some (r, p), has settled to a share."""
    own = np.abs(np.linalg.eigvals(sampled(drive, Ts).phi)).ravel()  # of which a commanded loop knows nothing
    factors = np.abs(driven_factors(steps, drive, Ts)).ravel()
    worst = float(np.concatenate([factors, own[own < 1 - _ZERO]]).max())
    wanted = np.log(share) / np.log(worst) if 0 < worst < 1 else LONGEST
    return int(np.clip(2 * wanted + 4 * drive.lumped.delay + 50, 50, LONGEST))


def _answers(steps, drive, Ts):
    """What each of the modes (r, p), through each drive, makes of a step of the target (d·r, N + 1)."""
    N = until_settled(steps, drive, Ts) if len(steps) else 0
    return respond(steps.real, drive, Ts, N, target=1.0)[0].reshape(N + 1, -1).T


def overshoot(steps, drive, Ts) -> float:
    """By how much of a step the modes (r, p) move beyond the target, at most."""
    those = outermost(steps)
    those = those if np.imag(those).any() else those[-1:]
    found = _answers(those, drive, Ts).max(initial=0.0) - 1.0
    return max(float(found), 0.0)


def settling(steps, drive, Ts, share=0.02) -> float:
    """Time until the modes (r, p) stay within a share of a step [s]; inf where they don't."""
    last = 0
    for q in _answers(outermost(steps), drive, Ts):
        with np.errstate(invalid="ignore"):
            outside = np.flatnonzero(~(np.abs(q - 1.0) <= share))
        if outside[-1] == len(q) - 1:
            return np.inf
        last = max(last, int(outside[-1]) + 1)
    return last * Ts


def noise_gain(steps, drive, Ts) -> tuple:
    """Standard deviations of motion, and of the commanded velocity [1/s], per unit of white noise of what is measured:
    the root of the sum of the squares of what one disturbed measurement does. Of the worst of the modes (r, p)."""
    those = outermost(steps)
    if not len(those):
        return 0.0, 0.0
    N = until_settled(those, drive, Ts)
    q, asked = respond(those.real, drive, Ts, N, noise=1.0)
    return tuple(float(np.linalg.norm(v, axis=0).max()) for v in (q, asked / Ts))


def outermost(steps):
    """The modes (r, p) that decide: of real ones the slowest, which lags most, and the fastest, which swings most; of
    others each that differs by more than rounding."""
    if np.round(np.imag(steps), 9).any() or len(steps) < 2:
        return np.unique(np.round(steps, 9), axis=0)
    steps = np.real(steps)
    return steps[np.argsort(steps.sum(-1))[[-1, 0]]]


def _outermost_of_each(steps):
    """Of modes (k, r, p) that are real the slowest and the fastest, (k, 2, p)."""
    if np.imag(steps).any() or steps.shape[-2] < 3:
        return steps
    order = np.argsort(np.real(steps).sum(-1), -1)[..., [0, -1], None]
    return np.take_along_axis(steps, order, -2)


def noise_limit(most: float, drive: Drive, Ts: float) -> float:
    """Share of an error that a step may remove so that the noise gain is at most `most`: 2m²/(1 + m²) of a loop
    without drive, for then it is √(g/(2 − g))."""
    low, high = 0.0, min(2.0, driven_limits("EE", Ts=Ts, drive=drive).stable)
    for _ in range(24):
        share = 0.5 * (low + high)
        kept = noise_gain(np.array([[-share]]), drive, Ts)[0] <= most
        low, high = (share, high) if kept else (low, share)
    return low


# --- margins ------------------------------------------------------------------------------------------


def open_loop(steps, drive: Drive, Ts: float, omega):
    """L(e^{iω}) (..., k) of modes (..., p), 1 + L = 0 being its characteristic equation; ω in radians per sample."""
    model, zeta = sampled(looked_at_drive(drive), Ts), np.exp(1j * np.asarray(omega))
    d = sum(v[..., None] * zeta**-j for j, v in enumerate(np.moveaxis(steps, -1, 0)))
    motion = model.transfer(zeta)
    if not drive.steps_positions or drive.feedback == "commanded":
        return -d * motion / Ts
    if drive.feedback == "rebased":
        return -(1.0 + d) * motion
    return -d * motion / (1.0 - 1.0 / zeta)  # commands are the sums of steps


def delay_margin(steps, drive, Ts) -> float:
    """Additional samples of dead time that the modes (r, p) tolerate: the least phase margin over its frequency.

    inf where the loop's gain is nowhere 1, as with commanded feedback, which does not depend on dead time.
    """
    if drive.feedback == "commanded":
        return np.inf
    least = np.inf
    omega, those = np.geomspace(1e-6, np.pi, 20_001), outermost(steps)
    for one, size in zip(those, np.abs(open_loop(those, drive, Ts, omega)), strict=True):
        cross = np.flatnonzero((size[:-1] - 1) * (size[1:] - 1) <= 0)
        for i in cross:
            share = (np.log(size[i])) / (np.log(size[i]) - np.log(size[i + 1]) + EPS)
            at = omega[i] * (omega[i + 1] / omega[i]) ** np.clip(share, 0, 1)
            phase = np.angle(-open_loop(one, drive, Ts, np.array([at]))[0]) % (2 * np.pi)
            least = min(least, phase / at)
    return float(least)
