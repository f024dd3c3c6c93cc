"""Every public function of the profiles under JAX's transformations and strictest settings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.profiles import burley, dipole, gaussian_sum, separable

# Hundreds of small compilations.
pytestmark = pytest.mark.slow

QUANTITY = np.array([0.11, 0.52, 0.93])
LENGTH = np.array([0.7, 1.3, 2.9])
OFFSETS = np.array([-4.0, -1.0, 0.0, 1.0, 4.0])

# Functions of arguments that broadcast, with arguments inside their domain.
ELEMENTWISE = {
    **{
        name: (getattr(burley, name), (QUANTITY, LENGTH))
        for name in ("profile", "pdf", "cdf", "sf", "ppf", "isf", "transmittance")
    },
    "profile with albedo": (burley.profile, (QUANTITY, LENGTH, QUANTITY)),
    "mean": (burley.mean, (LENGTH,)),
    "variance": (burley.variance, (LENGTH,)),
    "scaling searchlight": (lambda albedo: burley.scaling(albedo, "searchlight"), (QUANTITY,)),
    "scaling diffuse": (lambda albedo: burley.scaling(albedo, "diffuse"), (QUANTITY,)),
    "scaling dmfp": (lambda albedo: burley.scaling(albedo, "dmfp"), (QUANTITY,)),
    **{
        name: (getattr(burley, name), (LENGTH, QUANTITY))
        for name in ("shape_from_mfp", "mfp_from_shape", "shape_from_dmfp", "dmfp_from_shape")
    },
    "dmfp_from_coefficients": (burley.dmfp_from_coefficients, (LENGTH, QUANTITY, QUANTITY)),
    "fresnel_diffuse_reflectance": (dipole.fresnel_diffuse_reflectance, (LENGTH,)),
    "diffuse_reflectance": (dipole.diffuse_reflectance, (LENGTH, QUANTITY, LENGTH)),
    "effective_transport": (dipole.effective_transport, (LENGTH, QUANTITY)),
    "dipole.profile": (dipole.profile, (QUANTITY, LENGTH, QUANTITY, LENGTH)),
    "dipole.sf": (dipole.sf, (QUANTITY, LENGTH, QUANTITY, LENGTH)),
    **{
        name: (getattr(separable, name), (QUANTITY, LENGTH))
        for name in ("line_spread", "line_sf", "line_excess")
    },
    "falloff_profile": (gaussian_sum.falloff_profile, (LENGTH, QUANTITY)),
}
# Functions with an axis of their own.
OTHERS = {
    "gaussian_sum.profile": (
        gaussian_sum.profile,
        (LENGTH, gaussian_sum.SKIN_VARIANCES, gaussian_sum.SKIN_WEIGHTS[:, 0]),
    ),
    "burley_kernel": (separable.burley_kernel, (OFFSETS, LENGTH)),
    "falloff_kernel": (separable.falloff_kernel, (OFFSETS, QUANTITY, QUANTITY)),
}
EVERY = {**ELEMENTWISE, **OTHERS}

# Each way of compiling float32 is within 1e-6 of the truth here.
ROUNDING = 2e-6


def cast(arguments, dtype):
    return tuple(jnp.asarray(a, dtype) for a in arguments)


def test_no_public_function_is_left_out():
    public = set()
    for module in (burley, dipole, gaussian_sum, separable):
        for name, value in vars(module).items():
            own = getattr(value, "__module__", "") == module.__name__
            if own and callable(value) and not name.startswith("_"):
                public.add(value)
    # The one stands there as lambdas, the other runs on the host.
    others = {burley.scaling, separable.kernel_offsets}
    assert public - {function for function, _ in EVERY.values()} == others


@pytest.mark.parametrize("name", EVERY)
def test_jit_agrees_with_eager(name):
    function, arguments = EVERY[name]
    arguments = cast(arguments, jnp.float32)
    eager, compiled = function(*arguments), jax.jit(function)(*arguments)
    assert np.all(np.isfinite(eager)) and np.any(np.asarray(eager) != 0)
    np.testing.assert_allclose(compiled, eager, rtol=ROUNDING)


@pytest.mark.parametrize("name", EVERY)
def test_the_dtype_is_that_of_the_arguments(name):
    function, arguments = EVERY[name]
    for flag, known in ((False, jnp.float32), (True, jnp.float64)):
        with jax.enable_x64(flag):
            assert jax.eval_shape(function, *cast(arguments, jnp.float32)).dtype == jnp.float32
            assert jax.eval_shape(function, *cast(arguments, known)).dtype == known
            assert jax.eval_shape(function, *(a.astype(int) for a in arguments)).dtype == known
            # NumPy's own float64.
            assert jax.eval_shape(function, *arguments).dtype == known


@pytest.mark.parametrize("name", ELEMENTWISE)
def test_vmap_agrees_with_a_loop(name):
    function, arguments = ELEMENTWISE[name]
    arguments = cast(arguments, jnp.float32)
    compiled = jax.jit(function)
    loop = [compiled(*(a[i] for a in arguments)) for i in range(len(LENGTH))]
    mapped = jax.jit(jax.vmap(function))(*arguments)
    assert mapped.dtype == jnp.float32
    np.testing.assert_allclose(mapped, loop, rtol=ROUNDING)


@pytest.mark.parametrize("name", ["burley_kernel", "falloff_kernel"])
def test_kernels_of_several_channels_are_those_of_one(name):
    function, (offsets, *arguments) = OTHERS[name]
    together = jax.jit(function)(offsets, *arguments)
    for channel in range(len(LENGTH)):
        alone = jax.jit(function)(offsets, *(a[channel] for a in arguments))
        np.testing.assert_allclose(together[:, channel], alone, rtol=ROUNDING)


@pytest.mark.parametrize("half", [jnp.float16, jnp.bfloat16])
@pytest.mark.parametrize("name", EVERY)
def test_half_precision_in_and_out(name, half):
    function, arguments = EVERY[name]
    halved = cast(arguments, half)
    found = jax.jit(function)(*halved)
    assert found.dtype == half
    single = np.asarray(jax.jit(function)(*cast(halved, jnp.float32)))
    np.testing.assert_allclose(found.astype(jnp.float32), single, rtol=float(jnp.finfo(half).eps), atol=6e-8)


@pytest.mark.parametrize("name", EVERY)
def test_strict_promotion_of_ranks_and_dtypes(name):
    function, arguments = EVERY[name]
    arguments = cast(arguments, jnp.float32)
    every = tuple(range(len(arguments)))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        # Promotion is refused while tracing, so shapes are all that has to be computed.
        plain = jax.eval_shape(function, *arguments)
        gradient = jax.grad(lambda *a: jnp.sum(function(*a)), every)
        assert [g.shape for g in jax.eval_shape(gradient, *arguments)] == [a.shape for a in arguments]
        forward, _ = jax.eval_shape(lambda a: jax.jvp(function, a, a), arguments)
        assert forward == plain
        if name in ELEMENTWISE:
            assert jax.eval_shape(jax.vmap(function), *arguments) == plain
            assert jax.eval_shape(function, *(0.5 for _ in arguments)).shape == ()


@pytest.mark.parametrize("name", EVERY)
def test_gradients_are_difference_quotients(x64, name):
    function, arguments = EVERY[name]
    arguments = cast(arguments, jnp.float64)

    @jax.jit
    def total(*arguments):
        values = function(*arguments).ravel()
        return jnp.sum(values * jnp.arange(1.0, 1 + values.size))

    gradients = jax.jit(jax.grad(total, tuple(range(len(arguments)))))(*arguments)
    for index, gradient in enumerate(gradients):
        for place in range(gradient.size):
            if name in ("burley_kernel", "falloff_kernel") and index == 0:
                continue  # the cell around the tap at 0 is a case of its own
            h = 1e-6 * float(arguments[index][place])
            moved = [list(arguments) for _ in range(2)]
            for sign, changed in zip((1, -1), moved, strict=True):
                changed[index] = changed[index].at[place].add(sign * h)
            quotient = float(total(*moved[0]) - total(*moved[1])) / (2 * h)
            # Rounding of the two totals over 2 h, and h^2 times a third derivative.
            assert float(gradient[place]) == pytest.approx(quotient, rel=1e-7, abs=1e-7)
