"""Parameters from curves. Solvers are imported when a fit runs."""

from sssfit.fitting import inverse_cdf as inverse_cdf
from sssfit.fitting import separable_to_burley as separable_to_burley
