"""Poses in the user's forms, read and checked in one place for all interfaces.

A rotation may be as rough as three decimals; a known one is then made exact, in float64.
"""

from __future__ import annotations

import functools
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import ArrayLike
from cnclik.robot.rotations import products_of_quaternion, rotation_from_quaternion

ROUGH = 1e-3  # largest deviation of a rotation's row lengths from 1, and of cosines between rows from 0
_EXACT = 1e-12  # the same for one that is used unchanged
NORM = 1e-2  # largest deviation of a quaternion's norm from 1, as for 0.71 0.71 0 0
_LAST = np.array([0.0, 0.0, 0.0, 1.0])  # row of a transform
FORMS = "a 4×4 transform, [x, y, z, w, x, y, z], a Pose, or an object with translation and rotation"


class Posed(Protocol):
    """A `Pose`, or an object such as Pinocchio's SE3; its place is its `position` or `translation`."""

    @property
    def rotation(self) -> Any: ...


PoseLike = ArrayLike | Posed  # numbers may be only a position


def whole(name, value, *, finite=True):
    """Return (positions (..., 3), rotations (..., 3, 3)) of one or several whole poses; None for anything else.

    Args:
      value: of FORMS; transforms (4, 4) or (B, 4, 4), numbers (7,) or (B, 7).
      finite: whether numbers must be finite; otherwise a status reports them.
    Raises: ArgumentError for invalid transforms and quaternions.
    """
    place = next((p for p in ("translation", "position") if hasattr(value, p)), None)
    if place and hasattr(value, "rotation"):
        if callable(value.rotation):
            raise errors.fail(name, f"be {FORMS}", f"is {type(value).__name__}")
        where = errors.array(name, getattr(value, place), (3,), (None, 3), finite=finite)
        return _float(where), rotations(name, value.rotation, finite=finite)
    shape = shape_of(value)
    if shape[-2:] == (4, 4) and len(shape) < 4:
        found = errors.array(name, value, finite=finite)
        turn = _from_matrices(name, found[..., :3, :3])
        _check_last_row(name, found)
        return _float(found[..., :3, 3]), turn
    if shape[-1:] == (7,) and len(shape) < 3:
        found = errors.array(name, value, finite=finite)
        return _float(found[..., :3]), rotations(name, found[..., 3:], finite=finite)
    return None


def rotations(name, value, *, finite=True):
    """Return rotations (3, 3) or (B, 3, 3) of rotation matrices or of unit quaternions (4,) or (B, 4), w x y z.

    Args and raises: as `whole`.
    """
    value = errors.array(name, value, (3, 3), (None, 3, 3), (4,), (None, 4), finite=finite)
    return _from_matrices(name, value) if value.shape[-1] == 3 else _from_quaternions(name, value)


def quaternions(rotations) -> np.ndarray:
    """Return unit quaternions (..., 4), w x y z with w ≥ 0, of known rotations, from the largest row of qᵢqⱼ."""
    rows = np.array(products_of_quaternion(np.moveaxis(np.asarray(rotations, float), (-2, -1), (0, 1))))
    rows = np.moveaxis(rows, (0, 1), (-2, -1))
    largest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), -1)
    row = np.take_along_axis(rows, largest[..., None, None], -2)[..., 0, :]
    return row / np.linalg.norm(row, axis=-1, keepdims=True) * np.where(row[..., :1] < 0, -1.0, 1.0)


def library(*arrays):
    """Return NumPy if all is known, JAX's NumPy if something is traced."""
    return np if all(map(errors.concrete, jax.tree.leaves(arrays))) else jnp


def shape_of(value) -> tuple:
    """Return the shape of an array, traced or not, or of nested sequences; () if rows have different lengths."""
    if not isinstance(value, (list, tuple)):
        return tuple(getattr(value, "shape", ()))
    inner = set(map(shape_of, value))
    return (len(value), *inner.pop()) if len(inner) == 1 else ()


def _float(value):
    """Return a known value in float64: half precision would have an error of a thousandth."""
    return np.asarray(value, float) if errors.concrete(value) else value


def _from_quaternions(name, value):
    value, xp = _float(value), library(value)
    with np.errstate(over="ignore", invalid="ignore"):
        norm = xp.sqrt(xp.sum(value * value, axis=-1, keepdims=True))
        if xp is np:
            norms = norm.ravel()
            wrong = np.isfinite(value).all(axis=-1).ravel() & ~(np.abs(norms - 1) <= NORM)
            if wrong.any():
                k = int(np.argmax(wrong))
                must = f"hold {'unit quaternions' if len(wrong) > 1 else 'a unit quaternion'} w x y z"
                raise errors.fail(name, must, f"has one of norm {norms[k]:.6g}{_at(wrong, k)}")
        value = xp.where(xp.isfinite(norm), value / norm, xp.nan)
        rotations = xp.array(rotation_from_quaternion(value.T))
    return rotations if value.ndim == 1 else xp.moveaxis(rotations, -1, 0)


def _from_matrices(name, value):
    if not errors.concrete(value):
        return value
    value = _float(value)
    with np.errstate(over="ignore", invalid="ignore"):
        gap, right = _gaps(value)
        if np.all(gap <= _EXACT) and np.all(right):
            return value
        gap, right = np.atleast_1d(gap), np.atleast_1d(right)
        finite = np.isfinite(value).all(axis=(-1, -2)).ravel()  # a status reports others
        wrong = finite & ((gap > ROUGH) | ~right)
        exact = matrices = value.reshape(-1, 3, 3)
        if wrong.any():
            k = int(np.argmax(wrong))
            must = f"hold {'rotations' if len(wrong) > 1 else 'a rotation'}, with rows of length 1 at right angles"
            raise errors.fail(name, must, f"{_what_it_is(matrices[k])}{_at(wrong, k)}")
        for _ in range(3):  # to the nearest rotation: an error of ROUGH becomes its eighth power
            exact = exact @ (1.5 * np.eye(3) - 0.5 * exact.mT @ exact)
    return np.where((gap <= _EXACT)[:, None, None], matrices, exact).reshape(value.shape)


def _gaps(matrices) -> tuple:
    """Return how far the rows of matrices (..., 3, 3) are from orthonormal, and whether they are right-handed.

    Written out: for ten thousand matrices the library's product and determinant take twenty times as long; for one,
    Python's numbers are quicker than NumPy's.
    """
    alone = matrices.ndim == 2
    a, b, c, d, e, f, g, h, i = (
        matrices.reshape(9).tolist() if alone else np.ascontiguousarray(matrices.reshape(-1, 9).T)
    )
    lengths = a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0
    gaps = *map(abs, lengths), abs(a * d + b * e + c * f), abs(a * g + b * h + c * i), abs(d * g + e * h + f * i)
    right = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    return (max(gaps) if alone else functools.reduce(np.maximum, gaps)), right


def _what_it_is(r) -> str:
    """Say what is wrong with a matrix that is not a rotation."""
    scale = np.linalg.norm(r, axis=1).mean()
    if scale and np.abs(r @ r.T / scale**2 - np.eye(3)).max() < ROUGH:
        if np.linalg.det(r) < 0:
            return "holds a mirrored one, of determinant −1" if abs(scale - 1) < ROUGH else "holds a mirrored one"
        return f"holds one scaled by {scale:.6g}"
    return "holds another matrix"


def _check_last_row(name, transforms):
    """Raise ArgumentError unless transforms (..., 4, 4), if finite, end with 0 0 0 1."""
    if not errors.concrete(transforms):
        return
    transforms = np.asarray(transforms).reshape(-1, 4, 4)
    last = transforms[:, 3]
    if (last == _LAST).all():
        return
    with np.errstate(invalid="ignore"):
        wrong = np.isfinite(last).all(axis=1) & ~(np.abs(last - _LAST) <= 1e-9).all(axis=1)

    if wrong.any():
        k = int(np.argmax(wrong))
        turned = np.array_equal(transforms[k, :, 3], _LAST)
        remedy = ": the translation stands in the last row, so transpose it" if turned else ""
        raise errors.fail(
            name, "have the last row 0 0 0 1", f"has {' '.join(f'{v:g}' for v in last[k])}{_at(wrong, k)}{remedy}"
        )


def _at(wrong, k) -> str:
    return f" at index {k}" if len(wrong) > 1 else ""
