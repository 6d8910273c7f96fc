"""Poses in the user's forms, read and checked in one place for all interfaces.

A rotation may be as rough as three decimals; a known one is then made exact, in float64.
"""

from __future__ import annotations

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
            several = "unit quaternions" if value.size > 4 else "a unit quaternion"
            wrong = np.isfinite(value).all(axis=-1) & ~(np.abs(norm[..., 0] - 1) <= NORM)
            _refuse(name, wrong, f"hold {several} w x y z", lambda k: f"has one of norm {norm.ravel()[k]:.6g}")
        value = xp.where(xp.isfinite(norm), value / norm, xp.nan)
        rotations = xp.array(rotation_from_quaternion(value.T))
    return rotations if value.ndim == 1 else xp.moveaxis(rotations, -1, 0)


def _from_matrices(name, value):
    if not errors.concrete(value):
        return value
    value = _float(value)
    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.abs(np.einsum("...ij,...kj->...ik", value, value) - np.eye(3)).max(axis=(-2, -1))
        mirrored = ~(np.einsum("...i,...i", np.cross(value[..., 0, :], value[..., 1, :]), value[..., 2, :]) > 0)
        if np.all(gap <= _EXACT) and not mirrored.any():
            return value
        several = "rotations" if value.size > 9 else "a rotation"
        wrong = np.isfinite(value).all(axis=(-2, -1)) & ((gap > ROUGH) | mirrored)  # a status reports others
        must = f"hold {several}, with rows of length 1 at right angles"
        off = gap.ravel()
        _refuse(name, wrong, must, lambda k: "is mirrored" if off[k] <= ROUGH else f"is off by {off[k]:.3g}")
        exact = value
        for _ in range(3):  # to the nearest rotation: an error of ROUGH becomes its eighth power
            exact = exact @ (1.5 * np.eye(3) - 0.5 * exact.mT @ exact)
    return np.where((gap <= _EXACT)[..., None, None], value, exact)


def _check_last_row(name, transforms):
    """Raise ArgumentError unless transforms (..., 4, 4), if finite, end with 0 0 0 1."""
    if errors.concrete(transforms):
        last = np.asarray(transforms)[..., 3, :]
        wrong = np.isfinite(last).all(axis=-1) & (np.abs(last - _LAST) > 1e-9).any(axis=-1)
        found = "has {} (a transposed one has the translation there)"
        row = last.reshape(-1, 4)
        _refuse(name, wrong, "have the last row 0 0 0 1", lambda k: found.format(" ".join(f"{v:g}" for v in row[k])))


def _refuse(name, wrong, must, found):
    """Raise ArgumentError if something of one or several is wrong. Args: found: of an index, what is there."""
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise errors.fail(name, must, found(k) + (f" at index {k}" if np.size(wrong) > 1 else ""))
