"""The radial profiles that are fitted to measured curves, each with its parameters and their units.

A model is a small frozen value. It names its parameters and computes, from the vector of their values, the
areal profile and the energy that leaves within and beyond a radius. What a line, an edge or a beam of light
shows of it (`responses`), fits and posteriors are built on these three.
"""

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from sssfit.fitting.gaussian_sum import LARGEST_COUNT
from sssfit.fitting.profile_model import Model, Parameter
from sssfit.profiles import burley, dipole, gaussian_sum

#: What `named` takes; K is how many Gaussians, 1 to 8.
MODELS = ("burley", "gaussians:K", "dipole", "jimenez")


@dataclass(frozen=True)
class Burley:
    """Burley's profile of an albedo and a shape d in mm.

    Attributes:
        cutoff: where the profile ends, in units of d; its energy is scaled up by what is cut off, so that
            the albedo stays what it says. Cycles cuts at 16.

    Example:
        >>> float(Burley().profile(jnp.array([0.5, 1.0]), 1.0)).__round__(6)
        0.021574
    """

    cutoff: float = math.inf
    name = "burley"
    parameters = (Parameter("albedo", "share"), Parameter("d", "length"))

    @property
    def is_cut_off(self) -> bool:
        """See `Model`."""
        return math.isfinite(self.cutoff)

    def profile(self, p, r):
        """See `Model`."""
        inside = jnp.asarray(r) <= self.cutoff * p[1]
        return jnp.where(inside, burley.profile(r, p[1], p[0]), 0) / self._kept()

    def within(self, p, r):
        """See `Model`."""
        inside = jnp.minimum(jnp.asarray(r), self.cutoff * p[1]) if math.isfinite(self.cutoff) else r
        return p[0] * burley.cdf(inside, p[1]) / self._kept()

    def beyond(self, p, r):
        """See `Model`."""
        left = burley.sf(r, p[1]) - self._cut_off()
        return p[0] * jnp.maximum(left, 0) / self._kept()

    def energy(self, p):
        """See `Model`."""
        return p[0]

    def reach(self, p):
        """See `Model`."""
        return p[1] * min(self.cutoff, 120.0)

    def derived(self, p):
        """The diffuse mean free path; NaN above an albedo of 1."""
        return {"dmfp": burley.dmfp_from_shape(p[1], p[0])}

    def candidates(self, shortest, longest):
        """See `Model`."""
        return np.geomspace(shortest / 10, longest, 48)[:, None]

    def _kept(self) -> float:
        return 1 - self._cut_off()

    def _cut_off(self) -> float:
        return (math.exp(-self.cutoff) + 3 * math.exp(-self.cutoff / 3)) / 4


@dataclass(frozen=True)
class GaussianSum:
    """A sum of isotropic Gaussians: variances in mm^2, and the energy of each.

    Attributes:
        number: of Gaussians, 1 to 8.

    Example:
        >>> GaussianSum(2).name
        'gaussians:2'
    """

    number: int

    is_cut_off = False

    @property
    def name(self):
        """See `Model`."""
        return f"gaussians:{self.number}"

    @property
    def parameters(self):
        """See `Model`."""
        variances = (Parameter(f"variance_{i}", "area") for i in range(1, self.number + 1))
        return *variances, *(Parameter(f"weight_{i}", "share") for i in range(1, self.number + 1))

    def profile(self, p, r):
        """See `Model`."""
        return gaussian_sum.profile(r, *self._split(p))

    def within(self, p, r):
        """See `Model`."""
        return self._sum(p, r, lambda square: -jnp.expm1(-square))

    def beyond(self, p, r):
        """See `Model`."""
        return self._sum(p, r, lambda square: jnp.exp(-square))

    def energy(self, p):
        """See `Model`."""
        return jnp.sum(self._split(p)[1])

    def reach(self, p):
        """See `Model`."""
        return 9 * jnp.sqrt(jnp.max(self._split(p)[0]))

    def derived(self, p):
        """The albedo: all energy."""
        return {"albedo": self.energy(p)}

    def candidates(self, shortest, longest):
        """Geometric ladders of variances between several ends."""
        if self.number == 1:
            return np.geomspace(shortest / 4, longest, 32)[:, None] ** 2
        ends = np.geomspace(shortest, longest, 9)
        ladders = [np.geomspace(a, b, self.number) for i, a in enumerate(ends) for b in ends[i + 1 :]]
        return np.square(np.array(ladders) / 1.5)

    def _split(self, p):
        return p[: self.number], p[self.number :]

    def _sum(self, p, r, share):
        variances, weights = self._split(p)
        square = jnp.square(jnp.asarray(r))[..., None] / (2 * variances)
        return jnp.sum(weights * share(square), axis=-1)


@dataclass(frozen=True)
class Jimenez:
    """The falloff profile of separable kernels, stretched by falloff + 0.001, and how much light scatters.

    What does not scatter leaves where it entered: edges and beams show it, R(r) does not.

    Example:
        >>> Jimenez().within(jnp.array([0.3, 0.6]), 0.0).item().__round__(6)
        0.4
    """

    name = "jimenez"
    is_cut_off = False
    parameters = (Parameter("falloff", "length"), Parameter("strength", "share"))

    def profile(self, p, r):
        """See `Model`."""
        return gaussian_sum.profile(r, *self._gaussians(p))

    def within(self, p, r):
        """See `Model`."""
        return 1 - self.beyond(p, r)

    def beyond(self, p, r):
        """See `Model`."""
        variances, weights = self._gaussians(p)
        return jnp.sum(weights * jnp.exp(-jnp.square(jnp.asarray(r))[..., None] / (2 * variances)), axis=-1)

    def energy(self, p):
        """All of it: what does not scatter leaves, too."""
        return jnp.ones_like(p[1])

    def reach(self, p):
        """See `Model`."""
        return 9 * jnp.sqrt(jnp.max(self._gaussians(p)[0]))

    def derived(self, p):
        """See `Model`."""
        return {}

    def candidates(self, shortest, longest):
        """See `Model`."""
        return np.geomspace(shortest / 10, longest, 48)[:, None]

    def _gaussians(self, p):
        variances, weights = gaussian_sum.SKIN_VARIANCES[1:], gaussian_sum.SKIN_WEIGHTS[1:, 0]
        stretch = p[0] + gaussian_sum.FALLOFF_OFFSET
        variances, shares = (jnp.asarray(a, p.dtype) for a in (variances, weights / weights.sum()))
        return jnp.square(stretch) * variances, p[1] * shares


@dataclass(frozen=True)
class Dipole:
    """The dipole's profile of a half space: reduced scattering and absorption, 1/mm.

    Attributes:
        eta: its refractive index, in `dipole.ETA_RANGE`; it is not fitted.

    Example:
        >>> [parameter.name for parameter in Dipole(1.5).parameters]
        ['sigma_s_reduced', 'sigma_a']
    """

    eta: float = 1.3
    name = "dipole"
    is_cut_off = False
    parameters = (Parameter("sigma_s_reduced", "coefficient"), Parameter("sigma_a", "coefficient"))

    def profile(self, p, r):
        """See `Model`."""
        return dipole.profile(r, p[0], p[1], self.eta)

    def within(self, p, r):
        """See `Model`."""
        return self.energy(p) - self.beyond(p, r)

    def beyond(self, p, r):
        """See `Model`."""
        return self.energy(p) * dipole.sf(r, p[0], p[1], self.eta)

    def energy(self, p):
        """See `Model`."""
        return dipole.diffuse_reflectance(p[0], p[1], self.eta)

    def reach(self, p):
        """See `Model`."""
        transport = dipole.effective_transport(p[0], p[1])
        return 40 / transport + 40 / (p[0] + p[1])

    def derived(self, p):
        """The albedo, and the diffuse mean free path 1 / sigma_tr."""
        return {"albedo": self.energy(p), "dmfp": 1 / dipole.effective_transport(p[0], p[1])}

    def candidates(self, shortest, longest):
        """See `Model`."""
        transport = np.geomspace(0.1 / longest, 10 / shortest, 32)
        reduced_albedo = 1 - np.geomspace(4e-4, 0.9, 16)
        transport, reduced_albedo = (a.ravel() for a in np.meshgrid(transport, reduced_albedo))
        extinction = transport / np.sqrt(3 * (1 - reduced_albedo))
        return np.stack([reduced_albedo * extinction, (1 - reduced_albedo) * extinction], axis=1)


def named(name: str, *, eta: float = 1.3, cutoff: float = math.inf) -> Model:
    """A model by its name.

    Args:
        name: one of `MODELS`, such as "gaussians:4".
        eta: refractive index of a dipole, in `dipole.ETA_RANGE`.
        cutoff: where Burley's profile ends, in units of d, > 0.

    Raises:
        ValueError: an unknown name, or an argument outside its domain.

    Example:
        >>> named("gaussians:4")
        GaussianSum(number=4)
    """
    if not dipole.ETA_RANGE[0] <= eta <= dipole.ETA_RANGE[1]:
        raise ValueError(f"eta must be from {dipole.ETA_RANGE[0]} to {dipole.ETA_RANGE[1]}, got {eta}")
    if not cutoff > 0:
        raise ValueError(f"cutoff must be above 0, got {cutoff}")
    kind, _, number = name.partition(":")
    if kind == "gaussians" and number in map(str, range(1, LARGEST_COUNT + 1)):
        return GaussianSum(int(number))
    models: dict[str, Model] = {"burley": Burley(cutoff), "dipole": Dipole(eta), "jimenez": Jimenez()}
    if name not in models:
        raise ValueError(f"model must be one of {', '.join(MODELS)} with K from 1 to 8, got {name!r}")
    return models[name]
