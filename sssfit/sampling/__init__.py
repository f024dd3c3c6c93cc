"""How radii, directions and levels of detail are drawn."""

from sssfit.sampling import disk as disk
from sssfit.sampling import hashes as hashes
from sssfit.sampling import inverse_cdf as inverse_cdf
from sssfit.sampling import prefilter as prefilter
from sssfit.sampling import sequences as sequences
