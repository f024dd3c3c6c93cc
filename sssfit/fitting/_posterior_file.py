"""Chains in an HDF5 file that emcee's own backend reads, too: whole at every moment, so that any can go on.

emcee's backend opens the file anew in each step, and being killed within one may leave half of it. Here the
chain stays in memory and is written every few seconds, beside the file and then renamed over it.
"""

import hashlib
import io
import json
import os
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sssfit.files.atomic import interrupt_deferred, write_bytes
from sssfit.files.errors import FileError
from sssfit.files.json_text import json_line
from sssfit.files.reading import read_bytes

_OPTIONS = "sssfit_options"
# A chain is written at most so often, in seconds, and for no more than this share of the time.
_SAVE_EVERY, _SAVE_SHARE = 5.0, 0.05
_ARRAYS = ("chain", "log_prob", "accepted")


class Chain(NamedTuple):
    """What was drawn of one part.

    Attributes:
        y: positions, shape (steps, walkers, n).
        log_density: shape (steps, walkers).
        accepted: how many proposals of each walker were, shape (walkers,).
        random_state: of NumPy's legacy generator after the last step; None before the first.
    """

    y: np.ndarray
    log_density: np.ndarray
    accepted: np.ndarray
    random_state: tuple[Any, ...] | None

    @property
    def steps(self) -> int:
        """How many there are."""
        return len(self.y)


def empty(walkers: int, number: int) -> Chain:
    """A chain without steps."""
    return Chain(np.zeros((0, walkers, number)), np.zeros((0, walkers)), np.zeros(walkers), None)


def group_name(label: str) -> str:
    """Where a part lies in the file: "mcmc", which emcee reads unless told otherwise, for a single one."""
    return f"mcmc_{label}" if label else "mcmc"


def digest(*arrays: np.ndarray) -> str:
    """What tells data apart."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.shape} {array.dtype}".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def check(backend: str | os.PathLike[str] | None, resume: bool) -> None:
    """That a file is only gone on with when that is asked for.

    Raises:
        ValueError: there is no file to resume.
        FileError: there is one, and it is not to be resumed.
    """
    if backend is None:
        if resume:
            raise ValueError("resume needs the file of a chain: give backend")
    elif Path(backend).exists() and not resume:
        remedy = "resume it, or choose another path"
        raise FileError(backend, "", "is there already and may hold a chain, which stays as it is", remedy)


def save(path: str | os.PathLike[str], chains: Mapping[str, Chain], options: Mapping[str, Any]) -> None:
    """Write all chains by their labels, in place of what is there.

    Raises:
        FileError: the file cannot be written.
    """
    h5py = _h5py()
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs[_OPTIONS] = json_line(dict(options))
        for label, chain in chains.items():
            group = file.create_group(group_name(label))
            steps, walkers, number = chain.y.shape
            about = {"version": version("emcee"), "nwalkers": walkers, "ndim": number}
            group.attrs.update(about | {"has_blobs": False, "iteration": steps})
            arrays = (chain.y, chain.log_density, chain.accepted)
            for name, array in zip(_ARRAYS, arrays, strict=True):
                group.create_dataset(name, data=array)
            for i, element in enumerate(chain.random_state or ()):
                group.attrs[f"random_state_{i}"] = element
    write_bytes(path, buffer.getvalue())


def load(path: str | os.PathLike[str], options: Mapping[str, Any]) -> dict[str, Chain]:
    """The chains of a file by the names of their groups.

    Raises:
        FileError: the file is no such file, or of another problem.
    """
    h5py = _h5py()
    content = io.BytesIO(read_bytes(path))
    try:
        with h5py.File(content, "r") as file:
            found = json.loads(str(file.attrs[_OPTIONS]))
            chains = {name: _chain(group) for name, group in file.items()}
    except (OSError, KeyError, ValueError) as error:
        remedy = "restore the file or choose another path"
        raise FileError(path, "", "holds no chain of this kind", remedy) from error
    wanted = json.loads(json_line(dict(options)))
    differing = sorted(key for key in wanted | found if wanted.get(key) != found.get(key))
    if differing:
        problem = f"holds the chain of another problem (differing: {', '.join(differing)})"
        raise FileError(path, "", problem, "choose another path, or the same data and options")
    return chains


def _chain(group) -> Chain:
    y, log_density, accepted = (group[name][...] for name in _ARRAYS)
    # The Mersenne twister's name, key, position and kept normal number.
    state = [group.attrs[f"random_state_{i}"] for i in range(5) if f"random_state_{i}" in group.attrs]
    return Chain(y, log_density, accepted, tuple(state) or None)


def _h5py():
    with interrupt_deferred():
        import h5py
    return h5py


class Keeper:
    """The chains so far, and the file that they are kept in, if any.

    Attributes:
        chains: by the labels of their parts.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None,
        options: Mapping[str, Any],
        walkers: int,
        numbers: Mapping[str, int],
    ):
        """Take up what a file holds of parts with so many parameters, or begin.

        Raises:
            FileError: the file holds something else.
        """
        self._path, self._options, self._due = path, options, 0.0
        found = load(path, options) if path is not None and Path(path).exists() else {}
        self.chains = {
            label: found.get(group_name(label), empty(walkers, number)) for label, number in numbers.items()
        }

    def is_due(self) -> bool:
        """Whether the file should be written anew."""
        return self._path is not None and time.monotonic() >= self._due

    def save(self) -> None:
        """Write the file, if there is to be one."""
        if self._path is None:
            return
        start = time.monotonic()
        save(self._path, self.chains, self._options)
        end = time.monotonic()
        self._due = end + max(_SAVE_EVERY, (end - start) / _SAVE_SHARE)
