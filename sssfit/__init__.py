"""sssfit: statistical estimators and parameter fits for subsurface scattering.

Topics are sub-packages with one path to each name: `sssfit.profiles.burley.ppf`,
`sssfit.sampling.inverse_cdf.exact`, `sssfit.estimators.moving.emv`, `sssfit.fitting.inverse_cdf.fit_c`,
`sssfit.tables.load`. Lengths are in millimetres.
"""

import importlib
from importlib.metadata import version as _version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sssfit import estimators as estimators
    from sssfit import files as files
    from sssfit import fitting as fitting
    from sssfit import frames as frames
    from sssfit import profiles as profiles
    from sssfit import sampling as sampling
    from sssfit import scenarios as scenarios
    from sssfit import tables as tables

__version__ = _version("sssfit")

_TOPICS = ("estimators", "files", "fitting", "frames", "profiles", "sampling", "scenarios", "tables")


def __getattr__(name: str):
    # A topic is imported when it is first used: importing sssfit alone costs nothing, and the command
    # line is in charge, Ctrl-C included, before JAX loads.
    if name in _TOPICS:
        return importlib.import_module(f"sssfit.{name}")
    raise AttributeError(f"module 'sssfit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *_TOPICS]
