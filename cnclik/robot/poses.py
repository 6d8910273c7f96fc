"""Poses in the user's forms. A rotation may be as rough as three decimals; a known one is then made exact."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike, xp_for
from cnclik.robot.rotations import rotation_from_quaternion

_ROUGH = 1e-3  # largest deviation of a rotation's row lengths from 1, and of cosines between rows from 0
_EXACT = 1e-12  # the same for one that is used unchanged
_NORM = 1e-2  # largest deviation of a quaternion's norm from 1, as for 0.71 0.71 0 0
FORMS = "a 4×4 transform, [x, y, z, w, x, y, z], a Pose, or an object with translation and rotation"

PoseLike = ArrayLike | Any  # one of FORMS, or numbers that are only a position


def whole(name, value, *, finite=True):
    """Return (positions (..., 3), rotations (..., 3, 3)) of one or several whole poses; None for anything else.

    Args: value: of FORMS; transforms (4, 4) or (B, 4, 4), numbers (7,) or (B, 7). finite: whether numbers must be.
    Raises: ArgumentError for invalid transforms and quaternions.
    """
    place = getattr(value, "translation", getattr(value, "position", None))
    if place is not None and hasattr(value, "rotation"):
        where = errors.array(name, place, (3,), (None, 3), finite=finite)
        return _float(where), rotations(name, value.rotation, finite=finite)
    shape = shape_of(value)
    if shape[-2:] == (4, 4) and len(shape) < 4:
        transforms = errors.array(name, value, finite=finite)
        turn, last = _from_matrices(name, transforms[..., :3, :3]), transforms[..., 3, :]
        if errors.concrete(last):
            wrong = np.isfinite(last).all(axis=-1) & (np.abs(last - np.eye(4)[3]) > 1e-9).any(axis=-1)
            texts = "has {:g} {:g} {:g} {:g} (a transposed one has the translation there)"
            _refuse(name, wrong, "have the last row 0 0 0 1", lambda k: texts.format(*last.reshape(-1, 4)[k]))
        return _float(transforms[..., :3, 3]), turn
    if shape[-1:] == (7,) and len(shape) < 3:
        numbers = errors.array(name, value, finite=finite)
        return _float(numbers[..., :3]), rotations(name, numbers[..., 3:], finite=finite)
    return None


def rotations(name, value, *, finite=True):
    """Return rotations (3, 3) or (B, 3, 3) of rotation matrices or of unit quaternions (4,) or (B, 4), w x y z.

    Args and raises: as `whole`.
    """
    value = errors.array(name, value, (3, 3), (None, 3, 3), (4,), (None, 4), finite=finite)
    return _from_matrices(name, value) if value.shape[-1] == 3 else _from_quaternions(name, value)


def quaternions(rotations) -> np.ndarray:
    """Return unit quaternions (..., 4), w x y z with w ≥ 0, of known rotations."""
    from scipy.spatial.transform import Rotation  # here, as most poses are not written

    rows = np.asarray(rotations, float)
    known = np.isfinite(rows).all((-2, -1), keepdims=True)
    turns = Rotation.from_matrix(np.where(known, rows, np.eye(3)).reshape(-1, 3, 3))
    found = turns.as_quat(canonical=True, scalar_first=True).reshape(*rows.shape[:-2], 4)
    return np.where(known[..., 0], found, np.nan)


def shape_of(value) -> tuple:
    """Return the shape of an array, traced or not, or of nested sequences; () if rows have different lengths."""
    if not isinstance(value, (list, tuple)):
        return np.shape(value)
    inner = set(map(shape_of, value))
    return (len(value), *inner.pop()) if len(inner) == 1 else ()


def _float(value):
    """Return a known value in float64: half precision would have an error of a thousandth."""
    return np.asarray(value, float) if errors.concrete(value) else value


def _from_quaternions(name, value):
    value, xp = _float(value), xp_for(value)
    with np.errstate(over="ignore", invalid="ignore"):
        norm = xp.sqrt(xp.sum(value * value, axis=-1, keepdims=True))
        if xp is np:
            must = f"hold {'unit quaternions' if value.size > 4 else 'a unit quaternion'} w x y z"
            wrong = np.isfinite(value).all(axis=-1) & ~(np.abs(norm[..., 0] - 1) <= _NORM)
            _refuse(name, wrong, must, lambda k: f"has one of norm {norm.ravel()[k]:.6g}")
        value = xp.where(xp.isfinite(norm), value / norm, xp.nan)
        turns = xp.array(rotation_from_quaternion(value.T))
    return turns if value.ndim == 1 else xp.moveaxis(turns, -1, 0)


def _from_matrices(name, value):
    if not errors.concrete(value):
        return value
    value = _float(value)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        gap = np.abs(value @ value.mT - np.eye(3)).max(axis=(-2, -1))
        mirrored = ~(np.linalg.det(value) > 0)
        wrong = np.isfinite(value).all(axis=(-2, -1)) & ((gap > _ROUGH) | mirrored)  # a status reports others
        must = f"hold {'rotations' if value.size > 9 else 'a rotation'}, with rows of length 1 at right angles"
        off = np.ravel(gap)
        _refuse(name, wrong, must, lambda k: "is mirrored" if off[k] <= _ROUGH else f"is off by {off[k]:.3g}")
        if (gap <= _EXACT).all():
            return value
        exact = value
        for _ in range(3):  # to the nearest rotation: an error of _ROUGH becomes its eighth power
            exact = exact @ (1.5 * np.eye(3) - 0.5 * exact.mT @ exact)
    return np.where((gap <= _EXACT)[..., None, None], value, exact)


def _refuse(name, wrong, must, found):
    """Raise ArgumentError if something of one or several is wrong. Args: found: of an index, what is there."""
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise errors.fail(name, must, found(k) + (f" at index {k}" if np.size(wrong) > 1 else ""))
