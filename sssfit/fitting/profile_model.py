"""What a radial profile with free parameters is, and what a parameter is."""

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from jax import Array
from jax.typing import ArrayLike

Kind = Literal["length", "area", "coefficient", "share"]
_UNITS: dict[Kind, str] = {"length": "mm", "area": "mm^2", "coefficient": "1/mm", "share": "1"}
# In powers of a length, for bounds.
_POWERS: dict[Kind, int] = {"length": 1, "area": 2, "coefficient": -1}


@dataclass(frozen=True)
class Parameter:
    """A parameter's name and what it is.

    Attributes:
        name: as it is reported.
        kind: "length", "area" or "coefficient", which are positive and fitted by their logarithms, or
            "share" (of energy, >= 0), in which a profile is linear and which is fitted as it is.

    Example:
        >>> Parameter("d", "length").unit
        'mm'
    """

    name: str
    kind: Kind

    @property
    def unit(self) -> str:
        """Its unit."""
        return _UNITS[self.kind]

    @property
    def stem(self) -> str:
        """Its name without a number at its end."""
        stem, _, number = self.name.rpartition("_")
        return stem if number.isdecimal() else self.name

    @property
    def is_share(self) -> bool:
        """Whether the profile is linear in it."""
        return self.kind == "share"

    def bounds(self, shortest: float, longest: float) -> tuple[float, float]:
        """Where it is looked for in data between two distances in mm: far beyond what they can tell."""
        if self.is_share:
            return 0.0, math.inf
        power = _POWERS[self.kind]
        ends = (1e-3 * shortest) ** power, (1e3 * longest) ** power
        return min(ends), max(ends)


class Model(Protocol):
    """A radial profile with free parameters. `p` are their values, shape (n,), and r is in mm."""

    @property
    def name(self) -> str:
        """As `named` takes it."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """In the order of the vector."""
        ...

    @property
    def is_cut_off(self) -> bool:
        """Whether the profile jumps to 0 at its reach."""
        ...

    def profile(self, p: Array, r: ArrayLike) -> Array:
        """Areal density R(r), 1/mm^2, of r's shape."""
        ...

    def within(self, p: Array, r: ArrayLike) -> Array:
        """Energy that leaves at distances of at most r: the integral of 2 pi r R."""
        ...

    def beyond(self, p: Array, r: ArrayLike) -> Array:
        """Energy that leaves at distances above r."""
        ...

    def energy(self, p: Array) -> Array:
        """All energy that leaves, shape ()."""
        ...

    def reach(self, p: Array) -> Array:
        """A distance in mm beyond which nothing that counts is left, shape ()."""
        ...

    def derived(self, p: Array) -> dict[str, Array]:
        """Other quantities that follow from the parameters, each of shape ()."""
        ...

    def candidates(self, shortest: float, longest: float) -> np.ndarray:
        """Where to begin: values of all that are no shares, in their order, shape (many, n - shares)."""
        ...


#: The units of what models derive.
DERIVED_UNITS = {"dmfp": "mm", "albedo": "1"}
