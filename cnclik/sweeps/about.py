"""About: what the data of a spec say of themselves, in memory and in a store alike."""

import json

from cnclik.measure.dataset import provenance
from cnclik.sweeps import labels
from cnclik.sweeps.grid import Grid
from cnclik.sweeps.limits import linear_limit
from cnclik.sweeps.spec import Spec, to_json


def coordinates_of(spec: Spec, of: Grid) -> dict:
    """Every coordinate of a spec's data, {name: (dimensions, values, attributes)}: its axes, and the linear limit."""
    return labels.coordinates(of, spec.all_units()) | linear_limit(spec, of)


def attributes(spec: Spec, of: Grid, outputs, **more) -> dict:
    """Attributes of a spec's data: what was asked, and in `config` all that the numbers depend on."""
    config = fingerprint(spec) | {
        "lanes": of.lanes,
        "variables": [o.name for o in outputs],
        "axes": [[a.name, len(a), a.inner] for a in of.axes],
    }
    return {
        "commit": provenance(float)["commit"],
        "question": spec.question,
        "expectation": spec.expectation,
        "spec": to_json(spec),
        "config": json.dumps(config | more, ensure_ascii=False),
    }


def fingerprint(spec: Spec) -> dict:
    """What a block's numbers depend on: as JSON gives it back."""
    return json.loads(json.dumps({"data": spec.data(), "environment": labels.environment()}))
