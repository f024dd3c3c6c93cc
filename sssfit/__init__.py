"""sssfit: statistical estimators and parameter fits for subsurface scattering.

Topics are sub-packages with one path to each name: `sssfit.profiles.burley.ppf`,
`sssfit.sampling.inverse_cdf.exact`, `sssfit.fitting.inverse_cdf.fit_c`, `sssfit.tables.load`.
Lengths are in millimetres.
"""

from importlib.metadata import version as _version

from sssfit import fitting as fitting
from sssfit import profiles as profiles
from sssfit import sampling as sampling
from sssfit import tables as tables

__version__ = _version("sssfit")
