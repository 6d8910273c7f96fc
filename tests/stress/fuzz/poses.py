"""Poses at all doors: transforms, matrices, quaternions, rows of seven; scaled, mirrored, transposed, masked, odd."""

import numpy as np

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.reaching import targets
from tests.stress.fuzz.nasty import any_of, chance

TASKS = {"pose": ck.pose, "position": ck.position, "orientation": ck.orientation}
FORMS = ("transform", "transforms", "row", "rows", "matrix", "quaternion", "quaternions", "pair", "place", "places")


def _rotation(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1)), np.stack([w, x, y, z], -1)


def draw(rng):
    """(the task's name, the form, the value)."""
    form, count = any_of(rng, FORMS), int(any_of(rng, (0, 1, 2, 3, 4, 5)))
    several = (count,) if form.endswith("s") else ()
    turn, quaternion = _rotation(rng, *several)
    place = rng.normal(size=(*several, 3)) * any_of(rng, (1.0, 1.0, 1e-9, 1e6, 1e155, 1e307))
    made = np.zeros((*several, 4, 4))
    made[..., :3, :3], made[..., :3, 3], made[..., 3, 3] = turn, place, 1
    value = {"transform": made, "row": np.concatenate([place, quaternion], -1), "matrix": turn}
    value |= {"quaternion": quaternion, "place": place, "pair": None}
    value = (place, any_of(rng, (turn, quaternion))) if form == "pair" else value[form.removesuffix("s")]
    if chance(rng, 0.6):
        value = tuple(_odd(rng, v) for v in value) if isinstance(value, tuple) else _odd(rng, value)
    return any_of(rng, tuple(TASKS)), form, value


def _odd(rng, value):
    """A change that makes it none, or a hair's breadth that does not."""
    value = np.array(value)
    if not value.size:
        return value
    with np.errstate(all="ignore"):
        match int(rng.integers(12)):
            case 0:
                return value * any_of(rng, (1 + 1e-12, 1 + 1e-6, 1.004, 1.1, 2.0, -1.0, 185.0, 0.0))
            case 1 if value.ndim > 1:
                return np.swapaxes(value, -1, -2)
            case 2:
                value.flat[int(rng.integers(value.size))] = any_of(rng, (np.nan, np.inf, -np.inf, 1e308, 2.0))
                return value
            case 3:
                return value.astype(
                    any_of(rng, ("float16", "float32", "int8", "complex", "O", "U8", "bool", "longdouble"))
                )
            case 4:
                return np.ma.masked_array(value, rng.random(value.shape) < 0.2)
            case 5:
                return value.tolist()
            case 6:
                return value[None]
            case 7:
                return value.ravel()
            case 8:
                return value + 1e-9 * rng.normal(size=value.shape)
            case 9:
                return value + 3e-3 * rng.normal(size=value.shape)
            case 10:
                value[..., -1] *= -1
                return value
            case _:
                return [*value.tolist(), any_of(rng, (None, "a", 1, []))] if value.ndim else value


def attempt(made, folder) -> None:
    """As targets of `reach`, and as a reference that holds: what passes for a rotation is one."""
    name, form, value = made
    found, refused = {}, []
    task = TASKS[name]()
    for door, read in (("reach", lambda: targets.read(value, task)[0]), ("hold", lambda: _held(value, form))):
        try:
            found[door] = read()
        except ArgumentError as error:
            refused.append(error)
    if "reach" in found:
        rows = np.asarray(found["reach"], float)
        assert rows.ndim == 2 and rows.shape[1] == 12, rows.shape
        turns = rows[:, 3:].reshape(-1, 3, 3)
        known = np.isfinite(turns).all(axis=(1, 2))
        off = turns[known] @ np.swapaxes(turns[known], 1, 2) - np.eye(3)
        assert np.abs(off).max(initial=0) < 1e-9, f"no rotation: {turns[known]}"
        assert (np.linalg.det(turns[known]) > 0).all()
    if "hold" in found:
        turn = np.asarray(found["hold"], float)
        assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-9 and np.linalg.det(turn) > 0, f"no rotation: {turn}"
    if refused and not found:
        raise refused[0]


def _held(value, form):
    """The rotation that a loop would hold."""
    alone = form in ("matrix", "quaternion")
    made = ck.hold(*value) if isinstance(value, tuple) else ck.hold(None, value) if alone else ck.hold(value)
    return np.eye(3) if made.curve.rotation is None else np.asarray(made.curve.rotation, float)
