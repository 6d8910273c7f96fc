"""The linear theory's limit beside the data: only where R(z) is what the loop does."""

import copy
import tomllib

import numpy as np
import pytest

import cnclik as ck
from cnclik.stability.linear import stability_limit
from cnclik.sweeps import check, run_spec
from cnclik.sweeps.labels import linear_limit
from tests.specs import reaching

SPEC = tomllib.loads(reaching(["final_error"], method=["EE", "IE"], alpha=[1.0, 5.0], Ts=[0.01, 0.1]))


def limit(fixed=(), axes=(), drop=(), **more):
    """The coordinate of a variation of the spec: (dimensions, values), or {}."""
    written = copy.deepcopy(SPEC) | more
    written["fixed"] |= dict(fixed)
    written["axes"] |= dict(axes)
    for name in drop:
        written["axes"].pop(name)
    s = check.parse(written)
    found = linear_limit(s, s.grid())
    return found["limit"][:2] if found else {}


def test_it_is_over_the_axes_on_which_it_depends():
    dims, values = limit()
    assert dims == ("method",)
    np.testing.assert_allclose(values, [2, stability_limit(ck.IE, ck.picard(5))], rtol=1e-9)
    dims, values = limit(axes={"M": [1, 2, 5], "method": ["IE"]})
    assert dims == ("M",)
    np.testing.assert_allclose(values, [stability_limit(ck.IE, ck.picard(m)) for m in (1, 2, 5)], rtol=1e-9)
    assert limit(axes={"method": ["EE"]})[0] == ()
    assert limit(fixed={"method": "EE"}, drop=["method"]) == ((), 2.0)  # nothing is compiled in
    # Compiled in because N depends on it; the limit doesn't.
    assert limit(fixed={"N": "round(1/Ts)"})[0] == ("method",)


def test_an_axis_z_must_be_alpha_Ts():
    assert limit({"alpha": "z/Ts"}, {"z": [0.5, 1.5]}, ["alpha"])[0] == ("method",)
    assert limit({"alpha": "2*z/Ts"}, {"z": [0.5, 1.5]}, ["alpha"]) == {}


@pytest.mark.parametrize(
    ("fixed", "axes", "drop"),
    [
        ({"damping": 0.1}, {}, []),
        ({}, {"damping": [0.01, 0.1]}, []),
        ({"alpha": [5.0, 10.0]}, {}, ["alpha"]),
    ],
)
def test_other_laws_have_none(fixed, axes, drop):
    assert limit(fixed, axes, drop) == {}


def test_where_some_laws_have_one_the_others_are_not_a_number():
    laws = {"law": {"exact": {}, "damped": {"damping": 0.1}}}
    dims, values = limit(axes={"method": ["EE"]}, bundles=laws)
    assert dims == ("law",)
    np.testing.assert_array_equal(values, [2.0, np.nan])


def test_it_goes_with_the_data():
    data = run_spec(check.parse(SPEC | {"axes": SPEC["axes"] | {"method": ["EE"]}}))
    assert float(data.limit) == 2 and "limit" not in data.data_vars
