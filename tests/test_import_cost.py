"""What importing loads: nothing heavy before it is used, and no JAX setting is touched."""

import json
import subprocess
import sys

import pytest

SOLVERS = ["optimistix", "jaxopt", "scipy.optimize", "equinox", "lineax"]
IMAGES = ["OpenEXR", "PIL"]
PLOTS = ["matplotlib", "corner"]
CHAINS = ["emcee", "h5py"]

CODE = """
import json, sys
import {module}
flags = None
if "jax" in sys.modules:
    import jax
    flags = {{name: getattr(jax.config, name) for name in (
        "jax_enable_x64", "jax_numpy_rank_promotion", "jax_numpy_dtype_promotion", "jax_debug_nans",
        "jax_default_matmul_precision", "jax_platforms", "jax_disable_jit", "jax_compilation_cache_dir",
    )}}
print(json.dumps([sorted(sys.modules), flags]))
"""


def loaded_by(module):
    """The modules in memory and JAX's settings after one import in a fresh process."""
    finished = subprocess.run(
        [sys.executable, "-W", "error", "-c", CODE.format(module=module)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert finished.stderr == ""
    modules, flags = json.loads(finished.stdout)
    return set(modules), flags


def test_the_package_alone_loads_nothing_heavy():
    modules, _ = loaded_by("sssfit")
    assert modules.isdisjoint(["jax", "numpy", "scipy", "rich", *SOLVERS, *IMAGES, *PLOTS])


@pytest.mark.parametrize("topic", ["profiles", "sampling", "fitting"])
def test_topics_load_jax_and_no_solver(topic):
    modules, flags = loaded_by(f"sssfit.{topic}")
    assert f"sssfit.{topic}" in modules and "jax" in modules
    assert modules.isdisjoint([*SOLVERS, *IMAGES, *PLOTS])
    assert flags == loaded_by("jax")[1]
    assert flags["jax_enable_x64"] is False


def test_posteriors_load_no_sampler():
    modules, _ = loaded_by("sssfit.fitting.posterior")
    assert modules.isdisjoint(["optimistix", "jaxopt", *IMAGES, *PLOTS, *CHAINS, "rich"])


def test_estimators_load_modules_and_no_solver():
    modules, flags = loaded_by("sssfit.estimators")
    assert "equinox" in modules
    assert modules.isdisjoint(["optimistix", "jaxopt", "scipy.optimize", "lineax", *IMAGES, *PLOTS])
    assert flags == loaded_by("jax")[1]


def test_tables_load_neither_solvers_nor_plots():
    modules, _ = loaded_by("sssfit.tables")
    assert modules.isdisjoint([*SOLVERS, *PLOTS])


def test_the_command_line_shows_its_help_without_jax():
    modules, _ = loaded_by("sssfit.cli.main")
    assert modules.isdisjoint(["jax", *SOLVERS, *IMAGES, *PLOTS])
