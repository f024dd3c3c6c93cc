"""Constants, memory, input and output of a control variate's step; public as `estimators.control_variate`."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import _recursion, sample_count


class Config(eqx.Module):
    """The constants of `step`; see there.

    Attributes:
        controller: that of the sample counts.
        alpha: weight of the newest frame in the covariance, in (0, 1].
        epsilon: added to the covariance and to the variance, >= 0, in their squared unit.
        bound_offset: a_0 of the bound [0, a_0 + f / g].
        constant: a coefficient for all pixels and frames, which needs no covariance kept; None estimates it.
    """

    controller: sample_count.Controller
    alpha: ArrayLike = 0.05
    epsilon: ArrayLike = 1e-6
    bound_offset: ArrayLike = 1.0
    constant: ArrayLike | None = None

    def __check_init__(self):
        """Refuse constants that are known to be out of their domain; traced ones pass."""
        _recursion.check_alpha(self.alpha)
        for name in ("epsilon", "bound_offset"):
            value = getattr(self, name)
            if isinstance(value, int | float | np.ndarray) and not np.all(np.asarray(value) >= 0):
                raise ValueError(f"{name} must be at least 0, got {value}")


#: Online coefficients with the 2021 paper's constants, except for its weight of the covariance, 1e-6: that
#: cannot follow a light that moves, lets epsilon decide under dim light, and is lost in half formats. 0.05 is
#: the weight of the dissertation's example in appendix B.3.
ONLINE = Config(sample_count.PAPER_2021)
#: The same with main part separation.
MAIN_PART = Config(sample_count.PAPER_2021, constant=1.0)
#: The same without a control variate.
NONE = Config(sample_count.PAPER_2021, constant=0.0)


class Moments(eqx.Module):
    """Moving moments of f and g.

    Attributes:
        value_mean, control_mean: averages of f and g.
        covariance: of f and g, the matrix's two equal entries.
        control_variance: of g.
        value_variance: of f, which the algorithm does not use; None when packed.
    """

    value_mean: Array
    control_mean: Array
    covariance: Array
    control_variance: Array
    value_variance: Array | None

    @property
    def is_lost(self) -> Array:
        """Where a NaN or an infinity has got in, which the covariance tells: as good as missing."""
        return jnp.isnan(self.covariance)

    @property
    def matrix(self) -> Array:
        """The covariance matrix of (f, g), (..., 2, 2).

        Raises:
            ValueError: the history is packed.
        """
        if self.value_variance is None:
            raise ValueError("a packed history keeps no full matrix; make it by init with packed=False")
        rows = [[self.value_variance, self.covariance], [self.covariance, self.control_variance]]
        return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


class History(eqx.Module):
    """What a pixel remembers: the papers' nine numbers, seven packed, three with a constant coefficient.

    Of the nine two are equal, the matrix's covariance, which is kept once.

    Attributes:
        count: the sample count's three numbers, of the residual.
        moments: those of f and g; None with a constant coefficient.
    """

    count: sample_count.History
    moments: Moments | None


class Observation(eqx.Module):
    """What a frame brings, maps of the history's shape or numbers.

    Attributes:
        value: f, the mean of the frame's samples of distant light.
        control: g, the control's value as sampled, or as known.
        control_integral: G, the control's known integral; for a control that is constant within a frame
            the same as g.
        count: samples drawn; None means as many as the history asked for.
        distant_share: share of distant light; see `sample_count.distant_share`.
        missing: where the pixel had no history before this frame.
        valid: where False nothing is learned and the history stays as it is, unless it was missing.
        next_distant_share: share of distant light in the next frame, which `Info.count` is for; None means
            as in this one.
    """

    value: ArrayLike
    control: ArrayLike = 0.0
    control_integral: ArrayLike = 0.0
    count: ArrayLike | None = None
    distant_share: ArrayLike = 1.0
    missing: ArrayLike = False
    valid: ArrayLike = True
    next_distant_share: ArrayLike | None = None


class Info(eqx.Module):
    """What a step found, not carried on.

    Attributes:
        coefficient: a, from the frames before this one.
        residual: f - a G.
        count: samples, int32, that each pixel draws in the next frame.
    """

    coefficient: Array
    residual: Array
    count: Array
