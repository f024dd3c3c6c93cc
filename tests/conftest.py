"""What the tests share: the two precisions, Burley's profile by other means than ours, rendered frames."""

import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# The same examples in every run; the `dtype` fixture below does not change between examples.
settings.register_profile(
    "sssfit",
    max_examples=50,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("sssfit")


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    """The precision of a test, with JAX's 64-bit mode on for float64 alone."""
    with jax.enable_x64(request.param == "float64"):
        yield jnp.dtype(request.param)


@pytest.fixture
def x64():
    """JAX's 64-bit mode, for a test that compares with references of 15 digits."""
    with jax.enable_x64(True):
        yield


class Reference:
    """Burley's profile for d = 1 in extended precision; the quantiles by Newton's method on the cdf itself.

    The package instead solves a cubic in exp(-x / 3) by Halley's method.
    """

    #: Relative accuracy: two roundings in each of the terms.
    accuracy = 4 * float(np.finfo(np.longdouble).eps)
    _pi = np.longdouble("3.14159265358979323846264338327950288")

    def pdf(self, x):
        x = np.asarray(x, np.longdouble)
        return (np.exp(-x) + np.exp(-x / 3)) / 4

    def pdf_slope(self, x):
        x = np.asarray(x, np.longdouble)
        return -(np.exp(-x) + np.exp(-x / 3) / 3) / 4

    def cdf(self, x):
        x = np.asarray(x, np.longdouble)
        return -(np.expm1(-x) + 3 * np.expm1(-x / 3)) / 4

    def sf(self, x):
        x = np.asarray(x, np.longdouble)
        return (np.exp(-x) + 3 * np.exp(-x / 3)) / 4

    def profile(self, x):
        return self.pdf(x) / (2 * self._pi * np.asarray(x, np.longdouble))

    def ppf(self, q):
        """Where the cdf is q, for q inside (0, 1) and exact in q as given."""
        q = np.atleast_1d(np.asarray(q, np.longdouble))
        return self._root(q, 1 - q)

    def isf(self, q):
        """Where the survival function is q, for q inside (0, 1) and exact in q as given."""
        q = np.atleast_1d(np.asarray(q, np.longdouble))
        return self._root(1 - q, q)

    def _root(self, q, complement):
        near = q < 0.5
        x = np.empty_like(q)
        # Both starts lie left of the root, and the concave cdf and the convex ln sf approach it from there.
        x[near], x[~near] = 2 * q[near], np.maximum(-3 * np.log(complement[~near]) - 0.9, 0)
        for _ in range(8):
            x[near] += (q[near] - self.cdf(x[near])) / self.pdf(x[near])
            tail = self.sf(x[~near])
            x[~near] += (np.log(tail) - np.log(complement[~near])) * tail / self.pdf(x[~near])
        return x


@pytest.fixture(scope="session")
def reference():
    return Reference()


@pytest.fixture(scope="session")
def relative_error():
    """Largest |found / expected - 1|, formed in extended precision."""

    def largest(found, expected):
        expected = np.asarray(expected, np.longdouble)
        error = np.abs((np.asarray(found).astype(np.longdouble) - expected) / expected)
        assert error.size > 0 and not np.isnan(error).any()
        return float(error.max())

    return largest


@pytest.fixture
def fine_reference(dtype):
    """Skip where the machine's long double is no finer than the numbers to be judged."""
    if np.finfo(np.longdouble).eps > np.finfo(dtype).eps / 256:
        pytest.skip("long double is no finer than float64 on this machine")


@pytest.fixture(scope="session")
def rendered():
    """The folder of the rendered scenes, beside the repository or where SSSFIT_FRAMES says; no part of it."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "frames"
    folder = Path(os.environ.get("SSSFIT_FRAMES", beside))
    if not (folder / "s1_beam" / "camera.json").exists():
        pytest.skip(f"the rendered frames are not here (in {folder}, or where SSSFIT_FRAMES says)")
    return folder
