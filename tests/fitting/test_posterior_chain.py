"""Chains in files: gone on with, read by emcee, and refused where they are another problem's."""

from typing import Any

import numpy as np
import pytest

from sssfit.files.errors import FileError
from sssfit.fitting import posterior
from sssfit.fitting.posterior import sample

R = np.geomspace(0.1, 15.0, 24)


def burley(r, albedo, d):
    """Christensen and Burley's profile."""
    return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def measured_curve(relative, seed=0, albedo=0.7, d=1.5):
    """Values with noise of this part of the truth, and its size."""
    sigma = relative * burley(R, albedo, d)
    return burley(R, albedo, d) + sigma * np.random.default_rng(seed).normal(size=len(R)), sigma


@pytest.fixture
def stopping(monkeypatch):
    """Ctrl-C after so many steps."""

    def stop_after(steps):
        left = [steps]
        went_on = posterior._went_on

        def counted(walk):
            if left[0] == 0:
                raise KeyboardInterrupt
            left[0] -= 1
            return went_on(walk)

        monkeypatch.setattr(posterior, "_went_on", counted)

    with monkeypatch.context():
        yield stop_after


@pytest.mark.parametrize("moves", [None, [("de", 0.8), ("de_snooker", 0.2)]])
def test_a_chain_goes_on_as_if_never_interrupted(tmp_path, stopping, monkeypatch, moves):
    values, sigma = measured_curve(0.1)
    file = tmp_path / "chain.h5"
    whole = sample(R, values, sigma=sigma, steps=90, moves=moves)
    stopping(37)
    with pytest.raises(KeyboardInterrupt):
        sample(R, values, sigma=sigma, steps=90, moves=moves, backend=file)
    monkeypatch.undo()
    further = sample(R, values, sigma=sigma, steps=60, moves=moves, backend=file, resume=True)
    assert further.chain.tobytes() == whole.chain[:60].tobytes()
    found = sample(R, values, sigma=sigma, steps=90, moves=moves, backend=file, resume=True)
    assert found.chain.tobytes() == whole.chain.tobytes()
    assert found.log_density.tobytes() == whole.log_density.tobytes()
    assert found.acceptance_fraction == whole.acceptance_fraction
    before = file.read_bytes()
    assert sample(R, values, sigma=sigma, steps=5, moves=moves, backend=file, resume=True).steps == 90
    assert file.read_bytes() == before


def test_channels_go_on_where_they_were(tmp_path, stopping, monkeypatch):
    values, sigma = measured_curve(0.1)
    both, sigmas = np.stack([values, values / 2], axis=1), np.stack([sigma, sigma / 2], axis=1)
    whole = sample(R, both, sigma=sigmas, steps=20)
    assert whole.names == ("albedo_1", "d_1", "albedo_2", "d_2")
    assert whole.derived == ("dmfp_1", "transmittance_5mm_1", "dmfp_2", "transmittance_5mm_2")
    stopping(31)
    with pytest.raises(KeyboardInterrupt):
        sample(R, both, sigma=sigmas, steps=20, backend=tmp_path / "chain.h5")
    monkeypatch.undo()
    found = sample(R, both, sigma=sigmas, steps=20, backend=tmp_path / "chain.h5", resume=True)
    assert found.chain.tobytes() == whole.chain.tobytes()


def test_emcee_reads_the_file(tmp_path):
    import emcee

    values, sigma = measured_curve(0.1)
    found = sample(R, values, sigma=sigma, steps=20, backend=tmp_path / "chain.h5")
    theirs = emcee.backends.HDFBackend(tmp_path / "chain.h5", read_only=True)
    np.testing.assert_array_equal(theirs.get_chain(), found.chain)
    np.testing.assert_array_equal(theirs.get_log_prob(), found.log_density)
    assert [np.ndim(part) for part in theirs.random_state or []] == [0, 1, 0, 0, 0]


def test_other_files_are_refused_and_stay(tmp_path):
    values, sigma = measured_curve(0.1)
    file = tmp_path / "chain.h5"
    sample(R, values, sigma=sigma, steps=5, backend=file)
    before = file.read_bytes()
    with pytest.raises(FileError, match="is there already .* resume it, or choose another path"):
        sample(R, values, sigma=sigma, steps=5, backend=file)
    for change, differing in (
        ({"walkers": 16}, "walkers"),
        ({"seed": 1, "walkers": 12}, "seed, walkers"),
        ({"prior": {"d": (1.0, 2.0)}}, "parameters"),
        ({"sigma": 2 * sigma}, "data"),
        ({"sigma": sigma * (1 + 1e-15)}, "data"),
        ({"moves": [("walk", 1.0)]}, "moves"),
    ):
        options: dict[str, Any] = {"sigma": sigma, "steps": 9, "backend": file, "resume": True} | change
        with pytest.raises(FileError, match=rf"another problem \(differing: {differing}\)"):
            sample(R, values, **options)
    assert file.read_bytes() == before
    file.write_bytes(before[:1000])
    with pytest.raises(FileError, match="holds no chain of this kind"):
        sample(R, values, sigma=sigma, steps=9, backend=file, resume=True)
    with pytest.raises(FileError, match="cannot be written"):
        sample(R, values, sigma=sigma, steps=9, backend=tmp_path / "none" / "chain.h5")
    with pytest.raises(ValueError, match="resume needs the file of a chain: give backend"):
        sample(R, values, sigma=sigma, steps=9, resume=True)
