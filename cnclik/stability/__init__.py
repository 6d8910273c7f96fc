"""Which gain is safe at which sampling time.

`gains` answers for a drive, at any posture of any robot; `advise` for a law's own gains. Below them are R(z)
(`amplification`, `stability_limit`, `plane`), the loop's own step at rest (`spectral_radius`), whole loops over gains
and sampling times (`stability_map`), and what a run did in a sentence (`verdict`). What advises computes in float64.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "advice": ["advise"],
        "ending": ["verdict"],
        "gain": ["gain_table", "gains"],
        "linear": ["amplification", "stability_limit"],
        "maps": ["plane", "stability_map"],
        "spectrum": ["spectral_radius"],
    },
)
