"""How a uniform number becomes a radius."""

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.profiles import burley
from sssfit.sampling import inverse_cdf
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_QUICK_RADII, _RADII = 2**18, 2**21


def _prepare(setting: Setting) -> Task:
    number = _QUICK_RADII if setting.is_quick else _RADII
    variates = (np.arange(number) + 0.5) / number
    with jax.enable_x64(True):
        exact = np.asarray(burley.ppf(jnp.asarray(variates), 1.0))
    given = jax.device_put(variates.astype(np.float32))
    choices = tuple(_choice(name, method, given, exact) for name, method in inverse_cdf.METHODS.items())
    return Task(number, choices, f"{number} variates at equal steps, float32")


def _choice(name: str, method: inverse_cdf.Method, given, exact: np.ndarray) -> Choice:
    draw = jax.jit(lambda xi: method.radius(xi, 1.0))

    def error() -> Error:
        # The mixture does not rise with the variate: what counts is what it draws in all.
        drawn = np.sort(np.asarray(draw(given), np.float64))
        return Error(float(np.sqrt(np.mean(np.square(drawn - exact)))))

    return Choice(
        name=name,
        knobs={"importance": name},
        run=lambda: jax.block_until_ready(draw(given)),
        error=error,
        bytes_moved=8,
        is_default=name == "log_poly12",
    )


GROUP = Group(
    name="inverse_cdfs",
    title="From a uniform number to a radius of Burley's profile",
    unit="radius",
    error="root mean square error of the radius, in d",
    reference="burley.ppf in float64",
    prepare=_prepare,
    stands_for=tuple(
        f"sampling.inverse_cdf.{name}"
        for name in (
            *("exact", "closed_form", "xie", "mixture", "newton", "halley", "table"),
            *("log_linear", "log_poly4", "log_poly8", "log_poly12"),
        )
    ),
)
