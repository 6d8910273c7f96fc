"""Region of attraction: how large the initial error may be, certified and simulated.

The certificate is sufficient, not necessary: within it every loop of explicit Euler with exact J# converges. Most loops
outside it still do, which the simulation shows. Exponential Euler is explicit Euler with 1 − e^{−z} in place of z, so
that the better half of the certificate, up to z = 1, covers it at every gain.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.method import EE, named
from cnclik.integrate.stage import picard
from cnclik.law.inverse import Pseudoinverse
from cnclik.law.law import check_loop
from cnclik.law.paths import hold_at
from cnclik.measure.outcome import Ending, outcome
from cnclik.precision import in_float64, of_numbers
from cnclik.record import replace
from cnclik.robot.chain import REVOLUTE, with_one_tip
from cnclik.robot.model import as_joint_values, jacobian, one_off
from cnclik.stability.linear import checked, share_per_step
from cnclik.stability.maps import endings_about


@of_numbers
def curvature_bound(chain) -> float:
    """L_H: a Lipschitz bound of the position Jacobian over all q, ‖J(q) − J(p)‖ ≤ L_H ‖q − p‖ [m].

    Turning joints i, j both bend the part of the arm beyond them by at most its length, so
    |uᵀ ∂²x/∂q² v| ≤ |u|ᵀ Lᵀ diag(l) L |v| with L lower-triangular ones and lₖ the distance from joint k to the next:
    L_H is that matrix's largest eigenvalue. For planar unit links 2.618 (n = 2) and 12.344 (n = 5).

    Raises: ArgumentError for chains with prismatic joints, whose distances have no bound here.
    """
    with_one_tip(chain)
    if any(j.kind != REVOLUTE for j in chain.joints):
        raise errors.fail("chain", "have revolute joints only", "has a prismatic one")
    offsets = [*(j.origin.position for j in chain.joints[1:]), chain.tip.position]
    lengths = [math.sqrt(sum(float(v) ** 2 for v in offset)) for offset in offsets]
    reach = np.zeros((len(lengths), chain.n))  # row k: which coordinates turn link k, and how much
    for k, joint in enumerate(chain.joints):
        reach[k:, joint.coordinate] += abs(float(joint.multiplier))
    return float(np.linalg.eigvalsh(reach.T @ (np.array(lengths)[:, None] * reach))[-1])


def attraction_radius(z, sigma, curvature):
    """Largest ‖e₀‖ from which explicit Euler is guaranteed to reduce the error in every step [m].

    With σ_min(J) ≥ sigma along the whole motion, a step leaves |1 − z| ‖e‖ and at most L_H z² ‖e‖²/(2σ²), so z ≤ 1:
    ‖e₀‖ < 2σ²/(z L_H); 1 ≤ z < 2: ‖e₀‖ < 2(2 − z)σ²/(z² L_H). Sufficient, not necessary.

    Args:
      z: alpha·Ts, 0 < z; 1 − e^{−alpha·Ts} for exponential Euler.
      sigma: lower bound of the least singular value of J.
      curvature: L_H, see `curvature_bound`.
    """
    z = np.asarray(z, float)
    room = np.maximum(1 - np.abs(1 - z), 0)
    return 2 * room * np.asarray(sigma, float) ** 2 / (z**2 * curvature)


@in_float64
def certified_radius(law, q0, *, Ts, method=EE) -> float:
    """Largest ‖x_d − x(q0)‖ for which explicit or exponential Euler from q0 is certain to converge [m].

    Nothing is assumed; in float64.

    `attraction_radius` needs σ_min along the whole way. That way is bounded too: with s the least σ_min met, steps
    are at most z‖e‖/s long and errors shrink by ρ = |1 − z| + L_H z²‖e₀‖/(2s²), so the way is at most
    z‖e₀‖/(s(1 − ρ)), and s ≥ σ_min(q0) − L_H·way (Weyl). The best s is taken. Sufficient, not necessary.

    Args:
      law: a position task with exact J#, a scalar alpha and no null-space velocity.
      q0: (n,) joint values [rad].
      Ts: sampling time [s].
      method: EE, or EXP-EE with z = 1 − e^{−alpha·Ts}.
    Raises: ArgumentError for laws and methods it does not cover.
    """
    method = errors.one_of("method", str(method), ("EE", "EXP-EE"))
    check_loop(law)
    q0 = as_joint_values(law.chain, q0, "q0")
    extras = (law.task.weights, law.limits, law.null_velocity)
    plain = not law.task.orientation and all(extra is None for extra in extras)
    if not (plain and isinstance(law.inverse, Pseudoinverse) and np.ndim(law.alpha) == 0):
        must = "be a position task with pseudoinverse(), scalar alpha, no weights, limits or null velocity"
        raise errors.fail("law", must, "is not")
    z = share_per_step(named(method), float(law.alpha) * float(errors.number("Ts", Ts, positive=True)))
    if not 0 < z < 2:
        return 0.0
    bound = curvature_bound(law.chain)
    rows = np.asarray(jacobian(law.chain, q0))[list(law.task.linear)]
    sigma = float(np.linalg.svd(rows)[1][-1])
    if sigma <= 0:
        return 0.0
    s = np.linspace(0, sigma, 2002)[1:-1]
    # With x = ‖e₀‖, room = 1 − |1 − z| − L z² x/(2s²) must be positive and L z x ≤ (σ − s) s·room: linear in x.
    room = 1 - abs(1 - z)
    return float(np.max((sigma - s) * s * room / (bound * z + (sigma - s) * bound * z**2 / (2 * s))))


@in_float64
def sampled_attraction(law, q0, *, radii, Ts, method=EE, stage=picard(5), directions=64, N=300, tolerance=1e-3, seed=0):
    """Simulated counterpart of the certificate: targets at each distance in many directions, and how the loops ended.

    In float64.

    Args:
      law, q0, Ts, method, stage: the loop; targets lie around the tip's position at q0, orientations are kept.
      radii: (r,) initial errors ‖e₀‖ to try [m].
      directions: number of directions: evenly spaced in a plane, random on the sphere.
      N, tolerance: number of steps and what counts as converged, see `outcome`.
      seed: of the random directions.
    Returns: an xarray.Dataset over (radius, direction): `ending`, and `converged`, the fraction over (radius).
    """
    import xarray as xr

    method, stage = checked(method, stage)
    check_loop(law)
    q0, seed = as_joint_values(law.chain, q0, "q0"), errors.seed(seed)
    radii = np.asarray(errors.array("radii", radii, (None,)), float)
    if not radii.size or radii.min() <= 0:
        raise errors.fail("radii", "hold positive numbers", f"is {radii.tolist()}")
    Ts = jnp.asarray(errors.number("Ts", Ts, positive=True), float)
    errors.number("tolerance", tolerance, positive=True)
    directions = errors.integer("directions", directions, at_least=1)
    N = errors.integer("N", N, at_least=4, at_most=errors.MOST)
    units = _directions(len(law.task.position), directions, seed)
    moves = jnp.asarray((radii[:, None, None] * units).reshape(-1, units.shape[-1]))
    ended = _targets(law, q0, moves, Ts, stage, N=N, method=method, tolerance=tolerance)
    ending = np.asarray(ended.ending).reshape(len(radii), len(units))
    return xr.Dataset(
        {
            "ending": (("radius", "direction"), ending, endings_about()),
            "steps": (("radius", "direction"), np.asarray(ended.steps).reshape(ending.shape), {"units": "1"}),
            "converged": ("radius", (ending == Ending.CONVERGED).mean(1), {"units": "1"}),
        },
        coords={"radius": ("radius", radii, {"units": "m", "long_name": "initial error ‖e₀‖"})},
        attrs={"method": method.name, "stage": str(stage), "Ts": float(Ts), "N": N, "tolerance": tolerance},
    )


@one_off(static_argnames=("N", "method", "tolerance"))
def _targets(law, q0, moves, Ts, stage, *, N, method, tolerance):
    def one(move):
        held = hold_at(law.chain, law.task, q0)
        target = replace(held, curve=replace(held.curve, position=held.curve.position + move))
        return outcome(law, target, q0, Ts, N, method, stage, tolerance=tolerance)

    return jax.vmap(one)(moves)


def _directions(d, count, seed):
    if d == 0:
        raise errors.fail("law", "control a position", "controls an orientation only")
    if d == 1:
        return np.array([[1.0], [-1.0]])
    if d == 2:
        angle = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], -1)
    drawn = np.random.default_rng(int(seed)).normal(size=(count, d))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
