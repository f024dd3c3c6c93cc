"""How radii are drawn from a profile."""

from sssfit.sampling import inverse_cdf as inverse_cdf
