"""Columns and arrays as bytes that depend on nothing but their content."""

import csv
import io
import zipfile
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike


def csv_bytes(columns: Mapping[str, ArrayLike]) -> bytes:
    """A CSV file of columns of one length.

    Args:
        columns: 1-D by name. Floats get the fewest digits that give them back in float64.

    Returns:
        UTF-8, a header line and a line for each row.

    Raises:
        ValueError: the columns' lengths differ.

    Example:
        >>> csv_bytes({"frame": [0, 1], "count": [8.0, 41.5]})
        b'frame,count\\n0,8.0\\n1,41.5\\n'
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
    return stream.getvalue().encode()


def npz_bytes(arrays: Mapping[str, ArrayLike]) -> bytes:
    """An uncompressed NumPy archive that loads without pickle.

    Args:
        arrays: by name.

    Returns:
        What `numpy.load` reads. The bytes do not depend on the time of writing.

    Example:
        >>> with np.load(io.BytesIO(npz_bytes({"count": [8, 41]}))) as archive:
        ...     archive["count"]
        array([ 8, 41])
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            # Such a member has the earliest date of ZIP, not that of now; and says Unix everywhere.
            member = zipfile.ZipInfo(f"{name}.npy")
            member.create_system = 3
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return stream.getvalue()
