"""What light does: radial diffusion profiles, and the materials that have them."""

from sssfit.profiles import burley as burley
from sssfit.profiles import dipole as dipole
from sssfit.profiles import gaussian_sum as gaussian_sum
from sssfit.profiles import materials as materials
from sssfit.profiles import separable as separable
