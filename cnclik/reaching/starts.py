"""Starts: postures that fill the joint space, in bins of where they put the tip; a try starts from its target's bin.

A start near the target helps most: of a Panda's first tries from the bins of 131,072 postures 72 % arrive, from even
postures 20 %. Of several tips each joint starts where it has that tip near which it moves, see `targets.owners`.
"""

import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.record import memoized
from cnclik.robot.chain import Chain
from cnclik.robot.fixed import Offset, compose, dot, inverse, transpose
from cnclik.robot.model import modelled
from cnclik.robot.posture import evenly
from cnclik.robot.rotations import products_of_quaternion
from cnclik.task.task import WIDTH, aims, owners, told_apart

COUNT, PART = 1 << 17, 1 << 12  # postures; so many at once
PER_BIN, TURNS = 5, 3  # about so many of them in a bin; bins along a coordinate of a turn
BINNED = 16  # tries from the target's bin, at most; others start anywhere
STRETCHES = np.array([1.0, 4.0, 8.0, 4.0])  # of those: some have most joints, or all, at limits
ABOUT = 8  # tries about `near`; the last ones begin anywhere in the ranges of the joints
ISLANDS = 8  # of the tries of a target
SCATTERED = 0.2  # of the joints' ranges about a posture found
FAR = 1e4  # [rad, m] limits as large do not influence the starts: spread so far, few would arrive


class Starts(NamedTuple):
    """Postures, ordered for each joint by the bins of the tip that it moves."""

    postures: np.ndarray  # (COUNT, n) float32
    first: np.ndarray  # (bins,) int32: of each bin its first posture, aim by aim
    lines: np.ndarray  # (aims, 2, 3) where the bins of places begin [m], and how many there are in a metre


def spans(chain: Chain):
    """Return lower and upper ends (n,) of where starts are: the limits, of which at most one turn about the middle."""
    lower, upper = np.array(chain.lower, float), np.array(chain.upper, float)
    lower, upper, turn = np.where(lower <= -FAR, -np.inf, lower), np.where(upper >= FAR, np.inf, upper), 2 * math.pi
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - turn, -math.pi))
    high = np.where(np.isfinite(upper), upper, low + turn)
    middle = np.clip(0.0, np.minimum(low + math.pi, (low + high) / 2), np.maximum(high - math.pi, (low + high) / 2))
    wide = (high - low > turn) & np.array(chain.periodic)
    return np.where(wide, middle - math.pi, low), np.where(wide, middle + math.pi, high)


def turned(q, about, periodic, low, high, xp=np):
    """Return joint values (..., n), `periodic` joints by whole turns as near to `about` as the bounds allow."""
    about, turn = xp.clip(about, low, high), 2 * math.pi
    turns = xp.round((about - q) / turn)  # 0 of them leave a joint at its limit there, without rounding
    turns = turns - ((q + turn * turns > high) & (q + turn * (turns - 1) >= low))
    turns = turns + ((q + turn * turns < low) & (q + turn * (turns + 1) <= high))
    return xp.where(periodic, q + turn * turns, q)


def empty(chain, task) -> Starts:
    """Return starts without bins: those of a try depend on its number alone."""
    low, high = spans(chain)
    postures = (low + (high - low) * evenly(COUNT, chain.n)).astype(np.float32)
    bins = sum(math.prod(_shape(aim)) for aim in aims(task))
    return Starts(postures, np.zeros(bins, np.int32), np.zeros((len(aims(task)), 2, 3)))


def starts_of(chain, task) -> Starts:
    """Return the starts of a chain, made once for it and a task's aims."""
    return memoized(chain, f"_starts_{told_apart(task)}", lambda _: _binned(chain, task))


def _binned(chain, task) -> Starts:
    postures, _, lines = empty(chain, task)
    own, first, ordered, few = owners(task, chain), [], np.empty_like(postures), COUNT // 500
    for k, (aim, pose) in enumerate(zip(aims(task), _poses(chain, aims(task), postures), strict=True)):
        axes = list(aim.linear)
        ends = np.partition(pose[:, axes], [few, COUNT - few], axis=0)[[few, COUNT - few]]
        lines[k, :, : len(axes)] = ends[0], _shape(aim)[: len(axes)] / np.maximum(ends[1] - ends[0], 1e-12)
        bins = _bin(aim, pose, lines[k], np)
        order = np.argsort(bins, kind="stable")
        first.append(np.searchsorted(bins[order], np.arange(math.prod(_shape(aim)))))
        ordered[:, own == k] = postures[order][:, own == k]
    return Starts(ordered, np.concatenate(first).astype(np.int32), lines)


def _poses(chain, every, postures):
    """Return the poses (COUNT, 12) of each aim: number by number, so that zeros of the geometry cost nothing.

    The chain has no free base and no ball joint, which `reach` refuses.
    """
    model, tips = jax.tree.map(np.asarray, (modelled(chain), chain.tips))
    columns = [v[:, :3].mT.tolist() for v in model.transforms if v is not None]
    made = np.empty((len(every), WIDTH, COUNT))
    for k in range(0, COUNT, PART):
        q, at = postures[k : k + PART].astype(float), {-1: Offset()}
        values = q if model.mimic is None else q @ model.mimic[0].T + model.mimic[1]
        for i, (parent, *parts) in enumerate(zip(model.parents, *columns, strict=True)):
            terms = 1.0, np.sin(values[:, i]), np.cos(values[:, i]), values[:, i]
            *turn, place = ([dot(terms, v) for v in zip(*of, strict=True)] for of in zip(*parts, strict=True))
            at[i] = compose(at[parent], Offset(position=tuple(place), rotation=transpose(turn)))
        for aim, into in zip(every, made, strict=True):
            numbers = map(chain.tip_number, (aim.tip, aim.to or aim.tip))
            own, to = (compose(at[tips[n].joint], tips[n].offset) for n in numbers)
            pose = compose(inverse(to), own) if aim.to else own
            for row, value in zip(into, itertools.chain(pose.position, *pose.rotation), strict=True):
                row[k : k + PART] = value
    return made.mT


def _shape(aim) -> list:
    """Return the number of bins along each coordinate of an aim: as many for each length, and TURNS of a turn's three.

    In all there is about one for PER_BIN postures, and half as many again, as a third of them is beyond reach.
    """
    turns = [4] + 3 * [TURNS] if len(aim.angular) == 3 else []
    most, lengths = 3 * COUNT / PER_BIN / math.prod(turns), len(aim.linear)
    return [max(1, round(most ** (1 / max(lengths, 1))))] * lengths + turns


def _bin(aim, pose, lines, xp=jnp):
    """Return the number of the bin (...) of poses (..., 12) of an aim.

    A turn has the ratios of its quaternion's components to the largest one as coordinates, and which one that is.
    """
    number, shape = xp.zeros(pose.shape[:-1], np.int32), _shape(aim)

    def put(number, place, count):
        return number * count + xp.clip(place, 0, count - 1).astype(np.int32)

    for i, axis in enumerate(aim.linear):
        number = put(number, (pose[..., axis] - lines[0, i]) * lines[1, i], shape[i])
    if len(aim.angular) < 3:
        return number
    products = products_of_quaternion([[pose[..., 3 + 3 * i + j] for j in range(3)] for i in range(3)])
    (most, *rest), chart = products[0], 0 * number
    for k in (1, 2, 3):  # the row of the largest component
        row = list(products[k])
        larger = row[k] > most
        most, chart = xp.where(larger, row.pop(k), most), xp.where(larger, k, chart)
        rest = [xp.where(larger, new, old) for new, old in zip(row, rest, strict=True)]
    number, most = number * 4 + chart, (TURNS / 2) / most
    for v in rest:
        number = put(number, v * most + TURNS / 2, TURNS)
    return number


def start(chain, task, starts: Starts, target, given, away, low, high, k):
    """Return the posture (n,) that try `k` (int32) of a target (t,) begins at.

    Where `given` (n,) is not NaN, it is there, and `away` of the joints' ranges farther off. Else the first BINNED
    begin in the target's bin. A joint beyond its bounds has its place in the range of the starts between them, so that
    not their corners alone are tried. Some starts are stretched about the middle: from joints at limits an answer with
    several joints there is found.
    """
    (least, most), own, base, where = spans(chain), owners(task, chain), 0, []
    number, there = k.astype(np.uint32), ~jnp.isnan(given[0])
    anywhere = number * np.uint32(2654435761) >> 15  # even (Knuth)
    for a, aim in enumerate(aims(task)):
        first = starts.first[base + _bin(aim, target[WIDTH * a : WIDTH * (a + 1)], starts.lines[a])]
        binned = jnp.minimum(first.astype(np.uint32) + number % BINNED, COUNT - 1)
        where.append(jnp.where((k < BINNED) & ~there, binned, anywhere))
        base += math.prod(_shape(aim))
    drawn = jnp.stack([starts.postures[where[own[j]], j] for j in range(chain.n)]).astype(target.dtype)
    middle, width = (least + most) / 2, np.maximum(most - least, 1e-9)
    stretch = jnp.where((k >= BINNED) & (k % 4 == 3), jnp.asarray(STRETCHES, target.dtype)[(number // 4) % 4], 1.0)
    bounded = jnp.isfinite(high - low)
    beyond = ((drawn < low) | (drawn > high) | (stretch > 1)) & bounded
    between = low + jnp.where(bounded, high - low, 0.0) * (0.5 + stretch * (drawn - middle) * (1 / width))
    q = jnp.where(there, given + away * (drawn - middle), jnp.where(beyond, between, drawn))
    return jnp.clip(q, low, high)


def island_of(k):
    """Return the number of the island of a try: each keeps its best posture, about which its own later tries begin."""
    return (k // ISLANDS + k) % ISLANDS


def beginnings(k, near, xp=np) -> tuple:
    """Return where the first tries k (W,) begin: `given` (..., W, n) and `away` (W,) of `start`.

    The first ABOUT begin about `near` (..., n), if any, each one farther off than the one before.
    """
    given = xp.nan if near is None else xp.where((k < ABOUT)[:, None], near[..., None, :], xp.nan)
    return given, k / ABOUT


def origins(k, downhill, near, places, costs, xp=np) -> tuple:
    """Return where tries k (W,) begin: their numbers (W,), `given` (..., W, n) and `away` (W,) of `start`.

    After the first BINNED every second one begins about the best posture of its island so far, of `places`
    (..., ISLANDS, n): they find ten to a thousand times as many answers with joints at limits as tries from anywhere.
    Downhill, to the nearest pose, the first begin at the best postures, the others anywhere, every second stretched.
    """
    island, (given, away) = island_of(k), beginnings(k, near, xp)
    by = xp.isfinite(costs[..., island]) & xp.where(downhill, k < ISLANDS, (k >= BINNED) & (k % 2 == 0))
    given = xp.where(by[..., None], places[..., island, :], xp.where(downhill, xp.nan, given))
    away = xp.where(downhill, 0.0 * k, xp.where(k < ABOUT, away, SCATTERED))
    return xp.where(downhill, BINNED + k // 2 * 4 + k % 2 * 3, k), given, away
