"""Tables to write and read in the format tests."""

import numpy as np
import pytest

from sssfit.files.errors import FileError
from sssfit.tables import Axis, Table, load
from sssfit.tables.formats import encode_table


@pytest.fixture(scope="session")
def make_table():
    """Make a table of given dimensions; random values when none are given."""

    def make(dimensions=1, channels=3, values=None, name="skin", uniform=True):
        spacing = np.linspace(0.0, 5.0, 7) if uniform else np.array([0.0, 0.1, 0.3, 1.0, 2.0, 5, 9])
        axes = (Axis("thickness", "mm", spacing), Axis("sigma_t", "1/mm", np.array([0.5, 1, 1.5])))
        axes = axes[:dimensions]
        shape = (*(len(axis.values) for axis in axes), channels)
        if values is None:
            values = np.random.default_rng(7).normal(size=shape)
        return Table(
            name=name,
            description="Light that gets through, */ for tests of µm /* size.",
            axes=axes,
            channels=("R", "G", "B", "A")[:channels],
            values=np.asarray(values).reshape(shape),
            unit="1/mm^2",
            parameters={"albedo": [0.9, 0.5], "profile": "burley", "reach": float("inf")},
        )

    return make


@pytest.fixture(scope="session")
def write_table():
    """Write a table in a format and return the path to load."""

    def write(table, format_name, directory):
        files = encode_table(table, format_name)
        for suffix, data in files.items():
            (directory / f"{table.name}{suffix}").write_bytes(data)
        return directory / f"{table.name}{next(iter(files))}"

    return write


@pytest.fixture(scope="session")
def refusal_of():
    """Load a file that must be refused, and return the message."""

    def refused(path):
        with pytest.raises(FileError) as caught:
            load(path)
        return str(caught.value)

    return refused
